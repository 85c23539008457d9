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
    """The rays of one tile's pixels, and a splat's fragments on them. A named tuple, which numba can read."""

    pixels: NDArray[np.floating]
    """(4 AREA,). x and y of the pixels' centres, then h = q / 2 and the depth z of a splat's fragments in them: one
    array, so that the compiler sees that they do not overlap. The first rows of what a kernel works in."""
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
    px, py, base, slope = rays.pixels[:AREA], rays.pixels[AREA:], rays.base, rays.slope
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
def rows_of(records, i, extent, left, top):
    """Pixels of a tile, as a range of whole rows, that splat i's ellipse of `extent` standard deviations can touch."""
    reach = extent * records[i, SIGMA_X]
    u = records[i, U] + records[i, U_FRACTION] - left
    if u + reach < 0.0 or u - reach > TILE:
        return 0, 0
    reach = extent * records[i, SIGMA_Y]
    v = records[i, V] + records[i, V_FRACTION] - top
    # Rows by their centres, with a margin for rounding.
    low, high = max(v - reach - 0.501, 0.0), min(v + reach - 0.499, TILE - 1.0)
    if not (low <= high and high >= 0.0):
        return 0, 0
    return TILE * int(low), TILE * (int(high) + 1)


@njit(cache=True, error_model="numpy", fastmath=FUSED)
def fragments(records, i, first_plane, end_plane, near, rays, start, end):
    """Fills h and z of splat i's fragments in pixels start..end; z is infinite where one of the planes removes it.

    The record is no array of its own, which all threads would count as in use in one place. A call with an array more
    takes as long as the pixels of a small splat.
    """
    pixels, base, slope = rays.pixels, rays.base, rays.slope
    zero, infinite = pixels.dtype.type(0), pixels.dtype.type(np.inf)
    u0, u1, v0, v1 = records[i, U], records[i, U_FRACTION], records[i, V], records[i, V_FRACTION]
    a, b, c, middle = records[i, WHITEN_X], records[i, WHITEN_Y], records[i, SHEAR], records[i, DEPTH]
    kx, ky, reach = records[i, DEPTH_X], records[i, DEPTH_Y], records[i, DEPTH_LIMIT]
    for k in range(np.uintp(start), np.uintp(end)):
        dx, dy = (pixels[k] - u0) - u1, (pixels[np.uintp(AREA) + k] - v0) - v1
        m, n = a * dx, b * (dy + c * dx)
        pixels[np.uintp(2 * AREA) + k] = m * m + n * n
        depth = middle + min(max(kx * dx + ky * dy, -reach), reach)
        pixels[np.uintp(3 * AREA) + k] = depth if depth > near else infinite
    z = pixels[3 * AREA :]
    for p in range(first_plane, end_plane):
        for k in range(np.uintp(start), np.uintp(end)):
            z[k] = infinite if base[p, k] + z[k] * slope[p, k] > zero else z[k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def accumulate(task, tiled, colours, front, sums):
    """Runs all passes over some tiles. Fills front (H, W), the depth of the nearest core, and sums (H, W, SUMS).

    The layer is what lies no more than its depth before or behind the front; without a front, everything. Sums behind
    it are taken only where they matter: not where the layer is empty or covers the whole pixel.
    """
    height, width = front.shape
    records, spans = tiled.records, tiled.spans
    kind = records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((7 + SUMS, AREA), kind)  # one array, as TileRays.pixels is
    h, z, nearest, begin, limit, total = lane[2], lane[3], lane[4], lane[5], lane[6], lane[7:]
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(lane.reshape(-1)[: 4 * AREA], base, slope)
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
            start, end = rows_of(records, i, math.sqrt(CORE_Q), left, top)
            if start == end:
                continue
            fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
            for k in range(np.uintp(start), np.uintp(end)):
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        last = -infinite
        for k in range(AREA):
            begin[k] = nearest[k] - layer if nearest[k] < infinite else -infinite
            limit[k] = nearest[k] + layer if nearest[k] < infinite else kind(FAR)
            last = max(last, limit[k])
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            if records[i, DEPTH] - records[i, DEPTH_EXTENT] > last:
                continue
            start, end = rows_of(records, i, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
            weight, edge = records[i, WEIGHT], records[i, SHARPNESS]
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
        add_behind(tiled, colours, tile, rays, nearest, limit, total)
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
def add_behind(tiled, colours, tile, rays, nearest, limit, total):
    """Adds to total (SUMS, AREA) the sums of a tile's fragments behind limit (AREA,), which is infinite for pixels that
    need none; their front is at `nearest` (AREA,).

    rays as `fill_rays` fills them.
    """
    h, z = rays.pixels[2 * AREA : 3 * AREA], rays.pixels[3 * AREA :]
    left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
    records, spans = tiled.records, tiled.spans
    kind = records.dtype.type
    infinite, zero, cutoff, layer = kind(np.inf), kind(0.0), kind(0.5 * CUTOFF_Q), kind(tiled.layer)
    near = kind(tiled.cam.near)
    least, first, last = _open_rows(limit)
    if least == infinite:
        return
    for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
        i = tiled.splat_ids[pair]
        if records[i, DEPTH] + records[i, DEPTH_EXTENT] <= least:
            continue
        start, end = rows_of(records, i, math.sqrt(CUTOFF_Q), left, top)
        start, end = max(start, first), min(end, last)
        if start >= end:
            continue
        fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
        shown = False
        for k in range(np.uintp(start), np.uintp(end)):
            g = falloff(min(h[k], cutoff))
            matters = (h[k] <= cutoff) & (z[k] > limit[k]) & (z[k] < infinite)
            h[k] = g if matters else zero
            shown |= matters
        if not shown:
            continue
        weight, edge = records[i, WEIGHT], records[i, SHARPNESS]
        for k in range(np.uintp(start), np.uintp(end)):
            if h[k] > zero:
                w = h[k] * weight
                total[BEHIND, k] += w
                total[BEHIND + 1, k] += h[k] * edge
                w *= kind(depth_weight(z[k], nearest[k], layer))
                for c in range(3):
                    total[BEHIND + 2 + c, k] += w * colours[i, c]
                total[BEHIND + 5, k] += w


@njit(cache=True, error_model="numpy", fastmath=FUSED | {"reassoc"})
def _sum_pixels(g, px, py, d_sums, given, records, i, colours, start, end, rows, at):
    """Fills row `at` of rows (R, GRADIENT) with the gradients of splat i's fragments in pixels start..end, from
    g = exp(-q / 2) and those of weight, weight times sharpness and RGB, which begin in row `given` of d_sums.

    Sums may be taken in any order, so that they are vectors; without stores nothing has to be checked for overlap.
    """
    u0, u1, v0, v1 = records[i, U], records[i, U_FRACTION], records[i, V], records[i, V_FRACTION]
    weight, edge = records[i, WEIGHT], records[i, SHARPNESS]
    red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
    d0, d1, d2, d3, d4 = d_sums[given], d_sums[given + 1], d_sums[given + 2], d_sums[given + 3], d_sums[given + 4]
    zero = g.dtype.type(0)
    x, y, xx, xy, yy, w, s, c0, c1, c2 = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for k in range(np.uintp(start), np.uintp(end)):
        dx, dy = (px[k] - u0) - u1, (py[k] - v0) - v1
        e1, e2, e3, e4 = g[k] * d1[k], g[k] * d2[k], g[k] * d3[k], g[k] * d4[k]
        d_weight = g[k] * d0[k] + red * e2 + green * e3 + blue * e4
        p = weight * d_weight + edge * e1
        p_x, p_y = p * dx, p * dy
        x -= p_x
        y -= p_y
        xx -= p_x * dx
        xy -= p_x * dy
        yy -= p_y * dy
        w += d_weight
        s += e1
        c0 += e2
        c1 += e3
        c2 += e4
    rows[at, 0], rows[at, 1], rows[at, 2], rows[at, 3], rows[at, 4] = x, y, xx, xy, yy
    rows[at, 5], rows[at, 6], rows[at, 7], rows[at, 8], rows[at, 9] = w, s, weight * c0, weight * c1, weight * c2


@njit(cache=True, error_model="numpy", nogil=True)
def accumulate_backward(task, tiled, colours, front, d_sums, first_rows, rows):
    """Writes the gradient row of every pair of some tiles, given d_sums (H, W, SUMS) of `accumulate`.

    A splat's pairs have adjacent rows from first_rows (N + 1,), tile after tile: they are summed in a fixed order.
    """
    height, width = front.shape
    records, spans = tiled.records, tiled.spans
    kind = records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((9 + SUMS + 5, AREA), kind)
    px, py, h, z, nearest, begin, limit = lane[0], lane[1], lane[2], lane[3], lane[4], lane[5], lane[6]
    least, most = lane[7], lane[8]  # depths between which a fragment has a gradient
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(lane.reshape(-1)[: 4 * AREA], base, slope)
    d_tile = lane[9:]  # the last five: as one splat's fragments see them
    d_tile[:] = 0
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
            if records[i, DEPTH] - records[i, DEPTH_EXTENT] > last:
                continue
            start, end = rows_of(records, i, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
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
            given = 0
            if elsewhere:
                given = SUMS
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
            at = first_rows[i] + (line - spans[i, 2]) * (spans[i, 1] - spans[i, 0]) + column - spans[i, 0]
            _sum_pixels(h, px, py, d_tile, given, records, i, colours, start, end, rows, at)
