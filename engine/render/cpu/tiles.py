"""The pixel loops of the opaque image's outside: a front depth, then sums over a thin layer there and what lies before
it, tile by tile.

Where the layer covers a pixel only in part, the splats behind it are summed as well (engine.render.cpu.weights).

Arrays are float32 for pictures or float64 for checking derivatives. The inner loops hold no literals, which would widen
float32, and run over whole rows of a tile without branches, so that each row compiles to vector instructions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.classic.tiles import place_pairs
from engine.render.cpu.splats import (
    DEPTH,
    DEPTH_EXTENT,
    DEPTH_LIMIT,
    DEPTH_X,
    DEPTH_Y,
    GRADIENT,
    SHARPNESS,
    SHEAR,
    SIGMA_X,
    SIGMA_Y,
    TILE,
    U_FRACTION,
    V_FRACTION,
    WEIGHT,
    WHITEN_X,
    WHITEN_Y,
    U,
    V,
)
from engine.render.cpu.weights import BEFORE, BEHIND, FUSED, SUMS, coverage, depth_weight, falloff
from engine.render.projection import CameraRecord
from engine.scene.constants import CORE_Q, CUTOFF_Q, MIN_WEIGHT
from engine.threads import for_each

__all__ = [
    "AREA",
    "CHUNKS",
    "FAR",
    "TILES_PER_TASK",
    "TileRays",
    "TiledSplats",
    "accumulate",
    "accumulate_backward",
    "add_behind",
    "fill_rays",
    "fragments",
    "rows_of",
    "tile_lists",
]

AREA = TILE * TILE
"""Pixels of a tile."""

TILES_PER_TASK = 32
"""Many tasks, so that the cores finish together, but each long compared with a call."""

CHUNKS = 16
"""Tasks that the splats are split into. Fixed, so that the lists do not depend on the number of cores."""

FAR = 1e30
"""Depth limit of a pixel without a front: behind everything, yet before the infinite depth of clipped fragments."""


class TiledSplats(NamedTuple):
    """Projected splats and the list of them for each tile. A named tuple, which numba can read."""

    cam: CameraRecord
    planes: NDArray[np.float64]
    """(P, 4). Planes of all pieces, camera space."""
    records: NDArray[np.floating]
    """(N, RECORD). As `engine.render.cpu.splats` describes."""
    spans: NDArray[np.int32]
    """(N, 6). First and end tile in x and in y; first and end of the planes that may cut the splat."""
    tile_starts: NDArray[np.int64]
    """(tiles + 1,). Where the list of each tile begins in `splat_ids`."""
    splat_ids: NDArray[np.int32]
    """(pairs,). The splats of each tile, ascending."""
    columns: int
    """Tiles in a row of the picture."""
    layer: float
    """Depth of the layer on either side of the front, world units."""


class TileRays(NamedTuple):
    """The rays of one tile's pixels. A named tuple, which numba can read."""

    px: NDArray[np.floating]
    """(AREA,). Pixel centres."""
    py: NDArray[np.floating]
    base: NDArray[np.floating]
    """(P, AREA). Each ray's distance to each plane is base + z slope, at depth z."""
    slope: NDArray[np.floating]


@njit(cache=True, error_model="numpy", nogil=True)
def count_tiles(chunk, chunk_size, spans, columns, counts):
    """Adds one chunk of splats to counts (chunks, tiles): how many of them each tile lists."""
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(spans))):
        for y in range(spans[i, 2], spans[i, 3]):
            for x in range(spans[i, 0], spans[i, 1]):
                counts[chunk, y * columns + x] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def fill_tiles(chunk, chunk_size, spans, columns, places, splat_ids):
    """Writes the splats of one chunk into the tiles' lists and advances places (chunks, tiles)."""
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(spans))):
        for y in range(spans[i, 2], spans[i, 3]):
            for x in range(spans[i, 0], spans[i, 1]):
                tile = y * columns + x
                splat_ids[places[chunk, tile]] = i
                places[chunk, tile] += 1


def tile_lists(
    spans: NDArray[np.int32],  # [N, 6] as splats.project fills them
    columns: int,
    lines: int,
    buffer: Callable[[str, tuple[int, ...], type], NDArray[Any]] = lambda name, shape, kind: np.empty(shape, kind),
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """tile_starts (tiles + 1,) and splat_ids (pairs,) of columns x lines tiles, as in TiledSplats.

    `buffer` provides the arrays by name, for callers that reuse theirs.
    """
    size = -(-len(spans) // CHUNKS)
    places = buffer("places", (CHUNKS, columns * lines), np.int64)
    tile_starts = buffer("tile_starts", (columns * lines + 1,), np.int64)
    places[:] = 0
    for_each(count_tiles, CHUNKS, size, spans, columns, places)
    place_pairs(places, tile_starts)
    splat_ids = buffer("splat_ids", (int(tile_starts[-1]),), np.int32)
    for_each(fill_tiles, CHUNKS, size, spans, columns, places, splat_ids)
    return tile_starts, splat_ids


@njit(cache=True, error_model="numpy")
def fill_rays(tiled, tile, rays):
    """Fills the rays of a tile.

    The pixel loops allocate these arrays and repeat the prelude: with shared functions they take twice as long.
    """
    cam, planes = tiled.cam, tiled.planes
    px, py, base, slope = rays.px, rays.py, rays.base, rays.slope
    left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
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
    reach = extent * r[SIGMA_X]
    u = r[U] + r[U_FRACTION] - left
    if u + reach < 0.0 or u - reach > TILE:
        return 0, 0
    reach = extent * r[SIGMA_Y]
    v = r[V] + r[V_FRACTION] - top
    # Rows by their centres, with a margin for rounding.
    low, high = max(v - reach - 0.501, 0.0), min(v + reach - 0.499, TILE - 1.0)
    if not (low <= high and high >= 0.0):
        return 0, 0
    return TILE * int(low), TILE * (int(high) + 1)


@njit(cache=True, error_model="numpy", fastmath=FUSED)
def fragments(r, span, near, rays, start, end, h, z):
    """Fills h = q / 2 and depth z of a splat's fragments in pixels start..end; z is infinite if clipped."""
    px, py, base, slope = rays.px, rays.py, rays.base, rays.slope
    zero, infinite = z.dtype.type(0), z.dtype.type(np.inf)
    u0, u1, v0, v1, a, b, c = r[U], r[U_FRACTION], r[V], r[V_FRACTION], r[WHITEN_X], r[WHITEN_Y], r[SHEAR]
    middle, kx, ky, reach = r[DEPTH], r[DEPTH_X], r[DEPTH_Y], r[DEPTH_LIMIT]
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
def accumulate(task, tiled, colours, front, sums):
    """Runs all passes over some tiles. Fills front (H, W), the depth of the nearest core, and sums (H, W, SUMS).

    The layer is what lies no more than its depth before or behind the front; without a front, everything. Sums behind
    it are taken only where they matter: not where the layer is empty or covers the whole pixel.
    """
    height, width = front.shape
    kind = tiled.records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((7, AREA), kind)
    px, py, h, z, nearest, begin, limit = lane[0], lane[1], lane[2], lane[3], lane[4], lane[5], lane[6]
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(px, py, base, slope)
    total = np.empty((SUMS, AREA), kind)
    s0, s1, s2, s3, s4 = total[0], total[1], total[2], total[3], total[4]
    b0, b1, b2, b3, b4 = total[BEFORE], total[BEFORE + 1], total[BEFORE + 2], total[BEFORE + 3], total[BEFORE + 4]
    infinite, zero, layer = kind(np.inf), kind(0.0), kind(tiled.layer)
    core, cutoff = kind(0.5 * CORE_Q), kind(0.5 * CUTOFF_Q)
    for tile in range(task * TILES_PER_TASK, min((task + 1) * TILES_PER_TASK, len(tiled.tile_starts) - 1)):
        left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
        nearest[:] = infinite
        total[:] = zero
        if tiled.tile_starts[tile] < tiled.tile_starts[tile + 1]:
            fill_rays(tiled, tile, rays)
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            r = tiled.records[i]
            start, end = rows_of(r, math.sqrt(CORE_Q), left, top)
            if start == end:
                continue
            fragments(r, tiled.spans[i], near, rays, start, end, h, z)
            for k in range(np.uintp(start), np.uintp(end)):
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        last = -infinite
        for k in range(AREA):
            begin[k] = nearest[k] - layer if nearest[k] < infinite else -infinite
            limit[k] = nearest[k] + layer if nearest[k] < infinite else kind(FAR)
            last = max(last, limit[k])
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            r = tiled.records[i]
            if r[DEPTH] - r[DEPTH_EXTENT] > last:
                continue
            start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(r, tiled.spans[i], near, rays, start, end, h, z)
            weight, edge = r[WEIGHT], r[SHARPNESS]
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            shown, early = False, False
            for k in range(np.uintp(start), np.uintp(end)):
                g = falloff(min(h[k], cutoff))
                matters = (h[k] <= cutoff) & (z[k] <= limit[k])
                h[k] = g if matters else zero
                shown |= matters
                early |= matters & (z[k] < begin[k])
            if early:
                for k in range(np.uintp(start), np.uintp(end)):
                    first = h[k] if z[k] < begin[k] else zero
                    h[k] -= first
                    w = first * weight
                    b0[k] += w
                    b1[k] += first * edge
                    b2[k] += w * red
                    b3[k] += w * green
                    b4[k] += w * blue
            if shown:
                for k in range(np.uintp(start), np.uintp(end)):
                    w = h[k] * weight
                    s0[k] += w
                    s1[k] += h[k] * edge
                    s2[k] += w * red
                    s3[k] += w * green
                    s4[k] += w * blue
        for k in range(AREA):
            partly = s0[k] > MIN_WEIGHT and coverage(s0[k], s1[k]) < 1.0
            limit[k] = limit[k] if nearest[k] < infinite and partly else infinite
        add_behind(tiled, colours, tile, rays, h, z, nearest, limit, total)
        for k in range(AREA):
            x, y = left + k % TILE, top + k // TILE
            if x < width and y < height:
                front[y, x] = nearest[k]
                for c in range(SUMS):
                    sums[y, x, c] = total[c, k]


@njit(cache=True, error_model="numpy")
def _open_rows(limit):
    """Least limit (AREA,) of a tile, and the range of pixels, whole rows, that holds all finite ones."""
    least, first, last = limit.dtype.type(np.inf), AREA, 0
    for k in range(AREA):
        if limit[k] < np.inf:
            least, first, last = min(least, limit[k]), min(first, k), k
    return least, first // TILE * TILE, last // TILE * TILE + TILE


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def add_behind(tiled, colours, tile, rays, h, z, nearest, limit, total):
    """Adds to total (SUMS, AREA) the sums of a tile's fragments behind limit (AREA,), which is infinite for pixels that
    need none; their front is at `nearest` (AREA,).

    rays as `fill_rays` fills them; h and z (AREA,) are scratch.
    """
    left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
    kind = tiled.records.dtype.type
    infinite, zero, cutoff, layer = kind(np.inf), kind(0.0), kind(0.5 * CUTOFF_Q), kind(tiled.layer)
    near = kind(tiled.cam.near)
    least, first, last = _open_rows(limit)
    if least == infinite:
        return
    for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
        i = tiled.splat_ids[pair]
        r = tiled.records[i]
        if r[DEPTH] + r[DEPTH_EXTENT] <= least:
            continue
        start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
        start, end = max(start, first), min(end, last)
        if start >= end:
            continue
        fragments(r, tiled.spans[i], near, rays, start, end, h, z)
        shown = False
        for k in range(np.uintp(start), np.uintp(end)):
            g = falloff(min(h[k], cutoff))
            matters = (h[k] <= cutoff) & (z[k] > limit[k]) & (z[k] < infinite)
            h[k] = g if matters else zero
            shown |= matters
        if not shown:
            continue
        weight, edge = r[WEIGHT], r[SHARPNESS]
        for k in range(np.uintp(start), np.uintp(end)):
            if h[k] > zero:
                w = h[k] * weight
                total[BEHIND, k] += w
                total[BEHIND + 1, k] += h[k] * edge
                w *= kind(depth_weight(z[k], nearest[k], layer))
                for c in range(3):
                    total[BEHIND + 2 + c, k] += w * colours[i, c]
                total[BEHIND + 5, k] += w


@njit(cache=True, error_model="numpy")
def _add_row(part, g, px, py, r, red, green, blue, given, at):
    """Adds the gradients of one row of a tile to the lanes of the GRADIENT sums in `part`, which holds the gradients of
    weight, weight times sharpness and weight times RGB from `given` on, AREA each."""
    u0, u1, v0, v1, weight, edge = r[U], r[U_FRACTION], r[V], r[V_FRACTION], r[WEIGHT], r[SHARPNESS]
    given += at
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
def accumulate_backward(task, tiled, colours, front, d_sums, first_rows, rows):
    """Writes the gradient row of every pair of some tiles, given d_sums (H, W, SUMS) of `accumulate`.

    A splat's pairs have adjacent rows from first_rows (N + 1,), tile after tile: they are summed in a fixed order.
    """
    height, width = front.shape
    kind = tiled.records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((9, AREA), kind)
    px, py, h, z, nearest, begin, limit = lane[0], lane[1], lane[2], lane[3], lane[4], lane[5], lane[6]
    least, most = lane[7], lane[8]  # depths between which a fragment has a gradient
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(px, py, base, slope)
    # One flat array: with twenty base pointers the compiler would have to assume that they overlap.
    part = np.zeros(GRADIENT * TILE + (SUMS + 5) * AREA, kind)
    d_tile = part[GRADIENT * TILE :].reshape(SUMS + 5, AREA)  # the last five: as one splat's fragments see them
    zero, infinite = kind(0.0), kind(np.inf)
    layer, cutoff = kind(tiled.layer), kind(0.5 * CUTOFF_Q)
    for tile in range(task * TILES_PER_TASK, min((task + 1) * TILES_PER_TASK, len(tiled.tile_starts) - 1)):
        column, line = tile % tiled.columns, tile // tiled.columns
        left, top = column * TILE, line * TILE
        if tiled.tile_starts[tile] == tiled.tile_starts[tile + 1]:
            continue
        fill_rays(tiled, tile, rays)
        last = -infinite
        for k in range(AREA):
            x, y = left + k % TILE, top + k // TILE
            nearest[k], begin[k], limit[k], least[k], most[k] = infinite, -infinite, infinite, infinite, -infinite
            if not (x < width and y < height):
                continue
            for c in range(SUMS):
                d_tile[c, k] = d_sums[y, x, c]
            if front[y, x] < infinite:
                nearest[k], begin[k], limit[k] = front[y, x], front[y, x] - layer, front[y, x] + layer
            least[k] = -infinite if np.any(d_sums[y, x, BEFORE:BEHIND] != zero) else begin[k]
            most[k] = kind(FAR) if np.any(d_sums[y, x, BEHIND:] != zero) else min(limit[k], kind(FAR))
            last = max(last, most[k])
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            r = tiled.records[i]
            if r[DEPTH] - r[DEPTH_EXTENT] > last:
                continue
            start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(r, tiled.spans[i], near, rays, start, end, h, z)
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            # From here on h holds exp(-q / 2).
            shown, elsewhere = False, False
            for k in range(np.uintp(start), np.uintp(end)):
                g = falloff(min(h[k], cutoff))
                matters = (h[k] <= cutoff) & (z[k] >= least[k]) & (z[k] <= most[k])
                h[k] = g if matters else zero
                shown |= matters
                elsewhere |= matters & ((z[k] < begin[k]) | (z[k] > limit[k]))
            if not shown:
                continue
            given = GRADIENT * TILE
            if elsewhere:
                given += SUMS * AREA
                for k in range(start, end):
                    if h[k] == zero:
                        continue
                    first, far = 0, kind(1.0)
                    if z[k] < begin[k]:
                        first = BEFORE
                    elif z[k] > limit[k]:
                        first, far = BEHIND, kind(depth_weight(z[k], nearest[k], layer))
                    for c in range(5):
                        d_tile[SUMS + c, k] = d_tile[first + c, k] * (far if c > 1 else kind(1.0))
                    if first == BEHIND:
                        d_tile[SUMS, k] += far * d_tile[BEHIND + 5, k]
            part[: GRADIENT * TILE] = zero
            for line_k in range(start // TILE, end // TILE):
                _add_row(part, h, px, py, r, red, green, blue, np.uintp(given), np.uintp(line_k * TILE))
            span = tiled.spans[i]
            at = first_rows[i] + (line - span[2]) * (span[1] - span[0]) + column - span[0]
            for c in range(GRADIENT):
                total = zero
                for k in range(c * TILE, (c + 1) * TILE):
                    total += part[k]
                rows[at, c] = total
