"""The pixel loops of the opaque image's outside: a front depth, then sums over a thin layer behind it, tile by tile.

Arrays may be float32, for pictures, or float64, for checking derivatives; the inner loops hold no literal, which would
widen them, and run over whole rows of a tile without a branch, so that a row is one vector.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.core import types
from numba.extending import overload
from numpy.typing import NDArray

from engine.render.classic.tiles import place_pairs
from engine.render.cpu.splats import GRADIENT, TILE
from engine.render.projection import CameraRecord
from engine.scene.constants import CORE_Q, CUTOFF_Q, MIN_WEIGHT
from engine.threads import for_each

__all__ = [
    "AREA",
    "CHUNKS",
    "FUSED",
    "TILES_PER_TASK",
    "Frame",
    "accumulate",
    "accumulate_backward",
    "falloff",
    "fragments",
    "resolve",
    "resolve_backward",
    "rows_of",
    "tile_lists",
    "tile_points",
]

AREA = TILE * TILE

TILES_PER_TASK = 32

CHUNKS = 16
"""Tasks into which the splats are cut. Fixed, so that the lists do not depend on the cores."""

FAR = 1e30
"""A depth limit behind everything where no front is known, yet before the infinite depth of what is clipped."""


FUSED = {"contract"}
"""A product and a sum may be one step, rounded once: as exact, a tenth faster, and always the same on one machine."""


class Frame(NamedTuple):
    """Projected splats and their lists. A named tuple, which numba can read."""

    cam: CameraRecord
    planes: NDArray[np.float64]
    """(P, 4). Planes of all pieces, camera space."""
    records: NDArray[np.floating]
    """(N, RECORD)."""
    spans: NDArray[np.int32]
    """(N, 6)."""
    first: NDArray[np.int64]
    """(tiles + 1,). Where the list of each tile begins."""
    listed: NDArray[np.int32]
    """(pairs,). Splats of the tiles, ascending."""
    columns: int
    """Tiles in a row of the picture."""
    layer: float
    """Depth of the layer behind the front, world units."""


def falloff(h: float) -> float:
    """exp(-h) for h in [0, CUTOFF_Q / 2]."""
    return math.exp(-h)


@overload(falloff, jit_options={"fastmath": FUSED})
def _falloff(h):
    if h != types.float32:
        return lambda h: math.exp(-h)

    one = np.float32(1)
    eighth, a, b, c, d = (np.float32(v) for v in (1 / 8, 1 / 2, 1 / 6, 1 / 24, 1 / 120))
    e = np.float32(1 / 720)

    def polynomial(h):
        # exp(-h / 8) by its series, then squared three times: no table and no branch, so a row of pixels is one vector.
        x = -h * eighth
        y = one + x * (one + x * (a + x * (b + x * (c + x * (d + x * e)))))
        y *= y
        y *= y
        return y * y

    return polynomial


@njit(cache=True, error_model="numpy", nogil=True)
def count_tiles(chunk, chunk_size, spans, columns, counts):
    """Adds to counts (chunks, tiles) the splats of one chunk that each tile lists."""
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(spans))):
        for y in range(spans[i, 2], spans[i, 3]):
            for x in range(spans[i, 0], spans[i, 1]):
                counts[chunk, y * columns + x] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def fill_tiles(chunk, chunk_size, spans, columns, places, listed):
    """Writes the splats of one chunk into the lists at places (chunks, tiles), which move on."""
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(spans))):
        for y in range(spans[i, 2], spans[i, 3]):
            for x in range(spans[i, 0], spans[i, 1]):
                tile = y * columns + x
                listed[places[chunk, tile]] = i
                places[chunk, tile] += 1


def tile_lists(
    spans: NDArray[np.int32],  # [N, 6] as opaque_splats.project fills them
    columns: int,
    lines: int,
    room: Callable[[str, tuple[int, ...], type], NDArray[Any]] = lambda name, shape, kind: np.empty(shape, kind),
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """first (tiles + 1,) and listed (pairs,): the splats of each of columns x lines tiles, in their order.

    `room` gives the arrays by name, for callers that use theirs again.
    """
    size = -(-len(spans) // CHUNKS)
    places, first = room("places", (CHUNKS, columns * lines), np.int64), room("first", (columns * lines + 1,), np.int64)
    places[:] = 0
    for_each(count_tiles, CHUNKS, size, spans, columns, places)
    place_pairs(places, first)
    listed = room("listed", (int(first[-1]),), np.int32)
    for_each(fill_tiles, CHUNKS, size, spans, columns, places, listed)
    return first, listed


@njit(cache=True, error_model="numpy")
def tile_points(frame, tile, px, py, base, slope):
    """Fills pixel centres px, py (AREA,) and, for each plane, its distance base + z slope along each pixel's ray."""
    cam, planes = frame.cam, frame.planes
    left, top = tile % frame.columns * TILE, tile // frame.columns * TILE
    for k in range(AREA):
        u, v = left + k % TILE + 0.5, top + k // TILE + 0.5
        px[k], py[k] = u, v
        x, y = (u - cam.cx) / cam.fx, (v - cam.cy) / cam.fy
        for p in range(len(planes)):
            across = planes[p, 0] * x + planes[p, 1] * y
            if cam.orthographic != 0.0:
                base[p, k], slope[p, k] = across + planes[p, 3], planes[p, 2]
            else:
                base[p, k], slope[p, k] = planes[p, 3], across + planes[p, 2]


@njit(cache=True, error_model="numpy")
def rows_of(r, extent, left, top):
    """Pixels of a tile, as a range of whole rows, that an ellipse of `extent` standard deviations can touch."""
    reach = extent * r[14]
    u = r[0] + r[1] - left
    if u + reach < 0.0 or u - reach > TILE:
        return 0, 0
    reach = extent * r[15]
    v = r[2] + r[3] - top
    low, high = max(v - reach - 0.501, 0.0), min(v + reach - 0.499, TILE - 1.0)  # of row centres, with some air
    if not (low <= high and high >= 0.0):
        return 0, 0
    return TILE * int(low), TILE * (int(high) + 1)


@njit(cache=True, error_model="numpy", fastmath=FUSED)
def fragments(r, span, near, px, py, base, slope, start, end, h, z):
    """Fills h = q / 2 and depth z of a splat's fragments in pixels start..end; z is infinite where it is clipped."""
    zero, infinite = z.dtype.type(0), z.dtype.type(np.inf)
    u0, u1, v0, v1, a, b, c = r[0], r[1], r[2], r[3], r[4], r[5], r[6]
    middle, kx, ky, reach = r[7], r[8], r[9], r[10]
    for k in range(np.uintp(start), np.uintp(end)):
        dx, dy = (px[k] - u0) - u1, (py[k] - v0) - v1
        m, n = a * dx, b * (dy + c * dx)
        h[k] = m * m + n * n
        depth = middle + min(max(kx * dx + ky * dy, -reach), reach)
        z[k] = depth if depth > near else infinite
    for p in range(span[4], span[5]):
        for k in range(np.uintp(start), np.uintp(end)):
            z[k] = infinite if base[p, k] + z[k] * slope[p, k] > zero else z[k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def accumulate(task, frame, colours, front, sums):
    """Both passes over some tiles: fills front (H, W), the depth of the nearest core, and sums (H, W, 5): weight,
    weight times sharpness, weight times RGB of the fragments no more than the layer's depth behind it."""
    height, width = front.shape
    kind = frame.records.dtype.type
    lane = np.empty((6, AREA), kind)
    px, py, h, z, nearest, limit = lane[0], lane[1], lane[2], lane[3], lane[4], lane[5]
    base, slope = np.empty((len(frame.planes), AREA), kind), np.empty((len(frame.planes), AREA), kind)
    total = np.empty((5, AREA), kind)
    s0, s1, s2, s3, s4 = total[0], total[1], total[2], total[3], total[4]
    infinite, near, zero, layer = kind(np.inf), kind(frame.cam.near), kind(0.0), kind(frame.layer)
    core, cutoff = kind(0.5 * CORE_Q), kind(0.5 * CUTOFF_Q)
    for tile in range(task * TILES_PER_TASK, min((task + 1) * TILES_PER_TASK, len(frame.first) - 1)):
        left, top = tile % frame.columns * TILE, tile // frame.columns * TILE
        nearest[:] = infinite
        total[:] = zero
        if frame.first[tile] < frame.first[tile + 1]:
            tile_points(frame, tile, px, py, base, slope)
        for pair in range(frame.first[tile], frame.first[tile + 1]):
            i = frame.listed[pair]
            r = frame.records[i]
            start, end = rows_of(r, math.sqrt(CORE_Q), left, top)
            if start == end:
                continue
            fragments(r, frame.spans[i], near, px, py, base, slope, start, end, h, z)
            for k in range(np.uintp(start), np.uintp(end)):
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        last = -infinite
        for k in range(AREA):
            limit[k] = nearest[k] + layer if nearest[k] < infinite else kind(FAR)
            last = max(last, limit[k])
        for pair in range(frame.first[tile], frame.first[tile + 1]):
            i = frame.listed[pair]
            r = frame.records[i]
            if r[7] - r[11] > last:
                continue
            start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(r, frame.spans[i], near, px, py, base, slope, start, end, h, z)
            weight, edge = r[12], r[13]
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


@njit(cache=True, error_model="numpy")
def _add_row(part, g, px, py, r, red, green, blue, at):
    """Adds what one row of a tile hands back to the lanes of the GRADIENT sums in `part`."""
    given = np.uintp(GRADIENT * TILE) + at
    u0, u1, v0, v1, weight, edge = r[0], r[1], r[2], r[3], r[12], r[13]
    for k in range(np.uintp(TILE)):
        d0, d1 = part[given + k], part[given + np.uintp(AREA) + k]
        d2, d3 = part[given + np.uintp(2 * AREA) + k], part[given + np.uintp(3 * AREA) + k]
        d4 = part[given + np.uintp(4 * AREA) + k]
        d_weight = d0 + red * d2 + green * d3 + blue * d4
        p = -g[at + k] * (weight * d_weight + edge * d1)
        dx, dy = (px[at + k] - u0) - u1, (py[at + k] - v0) - v1
        w = g[at + k] * weight
        part[k] += p * dx
        part[np.uintp(TILE) + k] += p * dy
        part[np.uintp(2 * TILE) + k] += p * dx * dx
        part[np.uintp(3 * TILE) + k] += p * dx * dy
        part[np.uintp(4 * TILE) + k] += p * dy * dy
        part[np.uintp(5 * TILE) + k] += g[at + k] * d_weight
        part[np.uintp(6 * TILE) + k] += g[at + k] * d1
        part[np.uintp(7 * TILE) + k] += w * d2
        part[np.uintp(8 * TILE) + k] += w * d3
        part[np.uintp(9 * TILE) + k] += w * d4


@njit(cache=True, error_model="numpy", nogil=True)
def accumulate_backward(task, frame, colours, front, d_sums, first_rows, rows):
    """Writes the gradient row of every pair of some tiles, given d_sums (H, W, 5) of `accumulate`.

    A splat's pairs have neighbouring rows from first_rows (N + 1,), tile after tile, so their sum has one order.
    """
    height, width = front.shape
    kind = frame.records.dtype.type
    lane = np.empty((5, AREA), kind)
    px, py, h, z, limit = lane[0], lane[1], lane[2], lane[3], lane[4]
    base, slope = np.empty((len(frame.planes), AREA), kind), np.empty((len(frame.planes), AREA), kind)
    # One flat array, for one base pointer: with twenty the compiler would have to suspect that they overlap.
    part = np.empty(GRADIENT * TILE + 5 * AREA, kind)
    near, zero, layer, cutoff = kind(frame.cam.near), kind(0.0), kind(frame.layer), kind(0.5 * CUTOFF_Q)
    for tile in range(task * TILES_PER_TASK, min((task + 1) * TILES_PER_TASK, len(frame.first) - 1)):
        column, line = tile % frame.columns, tile // frame.columns
        left, top = column * TILE, line * TILE
        if frame.first[tile] == frame.first[tile + 1]:
            continue
        tile_points(frame, tile, px, py, base, slope)
        last = -kind(np.inf)
        for k in range(AREA):
            x, y = left + k % TILE, top + k // TILE
            limit[k] = -kind(np.inf)
            if x < width and y < height:
                limit[k] = front[y, x] + layer if front[y, x] < kind(np.inf) else kind(FAR)
                last = max(last, limit[k])
            for c in range(5):
                part[GRADIENT * TILE + c * AREA + k] = d_sums[y, x, c] if x < width and y < height else zero
        for pair in range(frame.first[tile], frame.first[tile + 1]):
            i = frame.listed[pair]
            r = frame.records[i]
            if r[7] - r[11] > last:
                continue
            start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(r, frame.spans[i], near, px, py, base, slope, start, end, h, z)
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            # From here on h holds exp(-q / 2).
            for k in range(np.uintp(start), np.uintp(end)):
                g = falloff(min(h[k], cutoff))
                h[k] = g if (h[k] <= cutoff) & (z[k] <= limit[k]) else zero
            part[: GRADIENT * TILE] = zero
            for line_k in range(start // TILE, end // TILE):
                _add_row(part, h, px, py, r, red, green, blue, np.uintp(line_k * TILE))
            span = frame.spans[i]
            at = first_rows[i] + (line - span[2]) * (span[1] - span[0]) + column - span[0]
            for c in range(GRADIENT):
                total = zero
                for k in range(c * TILE, (c + 1) * TILE):
                    total += part[k]
                rows[at, c] = total


@njit(cache=True, error_model="numpy", nogil=True)
def resolve(y, sums, rgb, alpha):
    """Fills row y of rgb (H, W, 3), weighted by alpha, and alpha (H, W) from the sums of `accumulate`."""
    for x in range(sums.shape[1]):
        weight = sums[y, x, 0]
        cover = 0.0
        if weight > MIN_WEIGHT:
            cover = min(max(0.5 + (weight - 0.5) * (sums[y, x, 1] / weight), 0.0), 1.0)
        alpha[y, x] = cover
        for c in range(3):
            rgb[y, x, c] = sums[y, x, 2 + c] / weight * cover if cover > 0.0 else 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def resolve_backward(y, sums, d_rgb, d_alpha, d_sums):
    """Fills row y of d_sums (H, W, 5): `resolve` backwards. A covering that is held at 0 or 1 passes nothing on."""
    for x in range(sums.shape[1]):
        d_sums[y, x, :] = 0
        weight, edge = float(sums[y, x, 0]), float(sums[y, x, 1])
        if not weight > MIN_WEIGHT:
            continue
        raw = 0.5 + (weight - 0.5) * (edge / weight)
        cover = min(max(raw, 0.0), 1.0)
        along = 0.0
        for c in range(3):
            along += d_rgb[y, x, c] * sums[y, x, 2 + c] / weight
            d_sums[y, x, 2 + c] = d_rgb[y, x, c] * cover / weight
        d_sums[y, x, 0] = -along * cover / weight
        if 0.0 < raw < 1.0:
            total = d_alpha[y, x] + along
            d_sums[y, x, 0] += total * 0.5 * edge / (weight * weight)
            d_sums[y, x, 1] = total * (1.0 - 0.5 / weight)
