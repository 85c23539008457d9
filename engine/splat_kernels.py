"""Numba kernels of the outside of the opaque image: surface splatting within a thin layer behind the front.

Splats are projected into records, listed by tile, and every tile makes its two passes alone: first the front depth of
its pixels, then the sums of weights and weighted colours within reach of it. Arrays may be float32, for pictures, or
float64, for checking derivatives; the inner loops hold no literal, which would widen them.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numba.core import types
from numba.extending import overload

from engine.formula import CORE_Q, CUTOFF_Q, EDGE_SLOPE, LOW_PASS, MIN_WEIGHT
from engine.projection import camera_point, conic, half_axes, jacobian, project_point, screen_axes, screen_covariance

__all__ = ["RECORD", "TILE", "accumulate", "list_tiles", "project", "resolve"]

TILE = 8
"""Edge of a tile in pixels: one row is one vector of floats; 16 pixels would waste half of a small splat's tile."""

AREA = TILE * TILE

RECORD = 16
"""Numbers in a record: 64 bytes as float32, a cache line."""

# Places in a record: centre, half the conic (h = A dx^2 + B dx dy + C dy^2 = q / 2), depth and its slope in the
# picture, limit and extent of the depth's change, weight, weight times sharpness, standard deviations in x and y.
_U, _V, _A, _B, _C, _Z, _KX, _KY, _REACH, _DEEP, _WEIGHT, _EDGE, _SX, _SY = range(14)

_NEAR, _ORTHO, _FX, _FY, _CX, _CY = 21, 20, 12, 13, 14, 15  # places in a packed camera

CHUNKS = 8
"""Parts of the list of splats that are put into tiles at once; fixed, so that the lists do not depend on threads."""

FAR = 1e30
"""A depth limit behind everything where no front is known, yet before the infinite depth of what is clipped."""


def falloff(h: float) -> float:
    """exp(-h) for h in [0, CUTOFF_Q / 2]."""
    return math.exp(-h)


@overload(falloff)
def _falloff(h):  # type: ignore[no-untyped-def]
    if h != types.float32:
        return lambda h: math.exp(-h)

    one = np.float32(1)
    eighth, a, b, c, d = (np.float32(v) for v in (1 / 8, 1 / 2, 1 / 6, 1 / 24, 1 / 120))
    e = np.float32(1 / 720)

    def polynomial(h):  # type: ignore[no-untyped-def]
        # exp(-h / 8) by its series, then squared three times: no table and no branch, so a row of pixels is one vector.
        x = -h * eighth
        y = one + x * (one + x * (a + x * (b + x * (c + x * (d + x * e)))))
        y *= y
        y *= y
        return y * y

    return polynomial


@njit(cache=True, error_model="numpy")
def plane_range(cam, plane, u0, u1, v0, v1, z0, z1):  # type: ignore[no-untyped-def]
    """Least and greatest signed distance from a camera-space plane (4,) of points seen at [u0, u1] x [v0, v1], depth
    [z0, z1]: the distance is affine in each of the three alone, so its ends are at the corners."""
    low, high = np.inf, -np.inf
    for k in range(8):
        u = u1 if k & 1 else u0
        v = v1 if k & 2 else v0
        z = z1 if k & 4 else z0
        x, y = (u - cam[_CX]) / cam[_FX], (v - cam[_CY]) / cam[_FY]
        if cam[_ORTHO] == 0.0:
            x, y = x * z, y * z
        distance = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
        low, high = min(low, distance), max(high, distance)
    return low, high


@njit(cache=True, parallel=True, error_model="numpy")
def project(cam, planes, lot, means, scales, quats, records, spans):  # type: ignore[no-untyped-def]
    """Fills records (N, RECORD) and spans (N, 6): first and end tile in x and y; first and end of the planes to test.

    Planes (P, 4) in camera space; lot (2,) says which of them bound these splats. A splat that cannot be seen gets an
    empty span of tiles, one that no plane cuts an empty span of planes.
    """
    width, height = cam[22], cam[23]
    for i in prange(len(means)):
        spans[i, :] = 0
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        if not z > cam[_NEAR]:
            continue
        u, v = project_point(cam, x, y, z)
        axes = half_axes(
            cam, quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3], scales[i, 0], scales[i, 1], scales[i, 2]
        )
        flat = screen_axes(jacobian(cam, x, y, z), axes)
        xx, xy, yy, det, det0 = screen_covariance(flat, LOW_PASS)
        if not (det > 0.0 and det < np.inf):
            continue
        sx, sy = math.sqrt(xx), math.sqrt(yy)
        extent = math.sqrt(CUTOFF_Q)
        x0 = max(math.ceil(u - extent * sx - 0.5), 0.0)
        x1 = min(math.floor(u + extent * sx + 0.5), width)
        y0 = max(math.ceil(v - extent * sy - 0.5), 0.0)
        y1 = min(math.floor(v + extent * sy + 0.5), height)
        if not (x0 < x1 and y0 < y1):
            continue
        a, b, c = conic(xx, xy, yy, det)
        depth_x = flat[0] * axes[6] + flat[1] * axes[7] + flat[2] * axes[8]
        depth_y = flat[3] * axes[6] + flat[4] * axes[7] + flat[5] * axes[8]
        reach = extent * math.sqrt(axes[6] ** 2 + axes[7] ** 2 + axes[8] ** 2)
        kx, ky = a * depth_x + b * depth_y, b * depth_x + c * depth_y
        # Over the ellipse q <= CUTOFF_Q the affine depth changes by no more than this.
        deep = min(extent * math.sqrt(max(kx * depth_x + ky * depth_y, 0.0)), reach)
        cut = 0
        for p in range(lot[0], lot[1]):
            low, high = plane_range(cam, planes[p], x0 + 0.5, x1 - 0.5, y0 + 0.5, y1 - 0.5, z - deep, z + deep)
            if low > 0.0:
                cut = 2
                break
            if high > 0.0:
                cut = 1
        if cut == 2:
            continue
        middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        narrow = det / (middle + math.sqrt(half * half + xy * xy))
        weight = math.sqrt(det0 / det)
        r = records[i]
        r[_U], r[_V], r[_A], r[_B], r[_C] = u, v, 0.5 * a, b, 0.5 * c
        r[_Z], r[_KX], r[_KY], r[_REACH], r[_DEEP] = z, kx, ky, reach, deep
        r[_WEIGHT], r[_EDGE] = weight, weight * max(1.0, math.sqrt(narrow) / EDGE_SLOPE)
        r[_SX], r[_SY] = sx, sy
        spans[i, 0], spans[i, 1] = int(x0) // TILE, (int(x1) - 1) // TILE + 1
        spans[i, 2], spans[i, 3] = int(y0) // TILE, (int(y1) - 1) // TILE + 1
        if cut == 1:
            spans[i, 4], spans[i, 5] = lot[0], lot[1]


@njit(cache=True, parallel=True)
def list_tiles(spans, columns, rows):  # type: ignore[no-untyped-def]
    """first (tiles + 1,) and splats (pairs,): the splats of every tile in ascending order."""
    n = len(spans)
    counts = np.zeros((CHUNKS, columns * rows), np.int64)
    for chunk in prange(CHUNKS):
        for i in range(n * chunk // CHUNKS, n * (chunk + 1) // CHUNKS):
            for y in range(spans[i, 2], spans[i, 3]):
                for x in range(spans[i, 0], spans[i, 1]):
                    counts[chunk, y * columns + x] += 1
    first = np.empty(columns * rows + 1, np.int64)
    total = 0
    for tile in range(columns * rows):
        first[tile] = total
        for chunk in range(CHUNKS):
            count = counts[chunk, tile]
            counts[chunk, tile] = total
            total += count
    first[columns * rows] = total
    splats = np.empty(total, np.int32)
    for chunk in prange(CHUNKS):
        for i in range(n * chunk // CHUNKS, n * (chunk + 1) // CHUNKS):
            for y in range(spans[i, 2], spans[i, 3]):
                for x in range(spans[i, 0], spans[i, 1]):
                    tile = y * columns + x
                    splats[counts[chunk, tile]] = i
                    counts[chunk, tile] += 1
    return first, splats


@njit(cache=True, error_model="numpy")
def tile_points(cam, planes, left, top, px, py, base, slope):  # type: ignore[no-untyped-def]
    """Fills pixel centres px, py (AREA,) and, for each plane, its distance base + z slope along each pixel's ray."""
    for k in range(AREA):
        u, v = left + k % TILE + 0.5, top + k // TILE + 0.5
        px[k], py[k] = u, v
        x, y = (u - cam[_CX]) / cam[_FX], (v - cam[_CY]) / cam[_FY]
        for p in range(len(planes)):
            across = planes[p, 0] * x + planes[p, 1] * y
            if cam[_ORTHO] != 0.0:
                base[p, k], slope[p, k] = across + planes[p, 3], planes[p, 2]
            else:
                base[p, k], slope[p, k] = planes[p, 3], across + planes[p, 2]


@njit(cache=True, error_model="numpy")
def rows_of(r, extent, left, top):  # type: ignore[no-untyped-def]
    """Pixels of a tile, as a range of whole rows, that an ellipse of `extent` standard deviations can touch."""
    x = extent * r[_SX]
    if r[_U] + x < left or r[_U] - x > left + TILE:
        return 0, 0
    y = extent * r[_SY]
    low = max(r[_V] - y - top, 0.0)
    high = min(r[_V] + y - top, float(TILE))
    if not low < high:
        return 0, 0
    return TILE * int(low), TILE * min(int(high) + 1, TILE)


@njit(cache=True, error_model="numpy")
def fragments(r, span, near, px, py, base, slope, start, end, h, z):  # type: ignore[no-untyped-def]
    """Fills h = q / 2 and depth z of a splat's fragments in pixels start..end; z is infinite where it is clipped."""
    zero, infinite = z.dtype.type(0), z.dtype.type(np.inf)
    u, v, a, b, c = r[_U], r[_V], r[_A], r[_B], r[_C]
    middle, kx, ky, reach = r[_Z], r[_KX], r[_KY], r[_REACH]
    for k in range(np.uintp(start), np.uintp(end)):
        dx, dy = px[k] - u, py[k] - v
        h[k] = (a * dx + b * dy) * dx + c * dy * dy
        depth = middle + min(max(kx * dx + ky * dy, -reach), reach)
        z[k] = depth if depth > near else infinite
    for p in range(span[4], span[5]):
        for k in range(np.uintp(start), np.uintp(end)):
            z[k] = infinite if base[p, k] + z[k] * slope[p, k] > zero else z[k]


@njit(cache=True, parallel=True, error_model="numpy")
def accumulate(cam, planes, records, spans, colours, first, splats, columns, layer, front, sums):  # type: ignore[no-untyped-def]
    """Both passes: fills front (H, W), the depth of the first core, and sums (H, W, 5): weight, weight times
    sharpness, weight times RGB of the fragments no more than `layer` behind it."""
    height, width = front.shape
    kind = records.dtype.type
    for tile in prange(len(first) - 1):
        left, top = tile % columns * TILE, tile // columns * TILE
        lane = np.empty((7, AREA), records.dtype)
        base, slope = np.empty((len(planes), AREA), records.dtype), np.empty((len(planes), AREA), records.dtype)
        px, py, h, z, nearest, limit = lane[0], lane[1], lane[2], lane[3], lane[4], lane[5]
        total = np.zeros((5, AREA), records.dtype)
        s0, s1, s2, s3, s4 = total[0], total[1], total[2], total[3], total[4]
        tile_points(cam, planes, left, top, px, py, base, slope)
        infinite, near = kind(np.inf), kind(cam[_NEAR])
        core, cutoff, zero = kind(0.5 * CORE_Q), kind(0.5 * CUTOFF_Q), kind(0.0)
        nearest[:] = infinite
        for pair in range(first[tile], first[tile + 1]):
            i = splats[pair]
            start, end = rows_of(records[i], math.sqrt(CORE_Q), left, top)
            if start == end:
                continue
            fragments(records[i], spans[i], near, px, py, base, slope, start, end, h, z)
            for k in range(np.uintp(start), np.uintp(end)):
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        last = zero - infinite
        for k in range(AREA):
            limit[k] = nearest[k] + kind(layer) if nearest[k] < infinite else kind(FAR)
            last = max(last, limit[k])
        for pair in range(first[tile], first[tile + 1]):
            i = splats[pair]
            r = records[i]
            if r[_Z] - r[_DEEP] > last:
                continue
            start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(r, spans[i], near, px, py, base, slope, start, end, h, z)
            weight, edge = r[_WEIGHT], r[_EDGE]
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            for k in range(np.uintp(start), np.uintp(end)):
                g = falloff(min(h[k], cutoff))
                g = g if (h[k] <= cutoff) & (z[k] <= limit[k]) else zero
                w = g * weight
                s0[k] += w
                s1[k] += g * edge
                s2[k] += w * red
                s3[k] += w * green
                s4[k] += w * blue
        for k in range(AREA):
            x, y = left + k % TILE, top + k // TILE
            if x < width and y < height:
                front[y, x] = nearest[k]
                for c in range(5):
                    sums[y, x, c] = total[c, k]


@njit(cache=True, parallel=True, error_model="numpy")
def resolve(sums, rgb, alpha):  # type: ignore[no-untyped-def]
    """Fills rgb (H, W, 3), weighted by alpha, and alpha (H, W) from the sums of `accumulate`."""
    for y in prange(sums.shape[0]):
        for x in range(sums.shape[1]):
            weight = sums[y, x, 0]
            cover = 0.0
            if weight > MIN_WEIGHT:
                cover = min(max(0.5 + (weight - 0.5) * (sums[y, x, 1] / weight), 0.0), 1.0)
            alpha[y, x] = cover
            for c in range(3):
                rgb[y, x, c] = sums[y, x, 2 + c] / weight * cover if cover > 0.0 else 0.0
