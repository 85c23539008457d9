"""Holes in a skin: atoms culled as backfacing are visible after all where nothing lies in front of them.

Culling atoms that face away from the eye (engine.render.culling.backface) is right if the skin in front of them is
closed. Skins of captures have pinholes: pixels without a core, or with one from far behind. Each culled atom is tested
against the depth of the tiles that it touches, and pixels where one passes are recomputed from all atoms. Where the
skin in front covers a pixel only in part, culled atoms count as part of what lies behind it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.splats import SHARPNESS, TILE, WEIGHT
from engine.render.cpu.tiles import AREA, FAR, TileRays, add_behind, fill_rays, fragments
from engine.render.cpu.weights import BEFORE, BEHIND, SUMS, coverage, depth_weight
from engine.scene.constants import CORE_Q, CUTOFF_Q, FACE_OPAQUE, MIN_WEIGHT

__all__ = ["fill_holes", "seen_through", "tile_depths"]


@njit(cache=True, error_model="numpy", nogil=True)
def is_partly_covered(sums):
    """Whether what lies behind the layer shows in a pixel with these sums (SUMS,)."""
    return sums[0] > MIN_WEIGHT and coverage(sums[0], sums[1]) < 1.0 and coverage(sums[BEFORE], sums[BEFORE + 1]) < 1.0


@njit(cache=True, error_model="numpy", nogil=True)
def tile_depths(line, front, sums, faces, face, depths, left_open, right_open, ends, limits):
    """Fills a line of tiles of ends (H, W), the depth behind which nothing shows its colour, and of limits (lines,
    columns), the largest end in each tile; infinite for a tile with a partly covered pixel.

    A run of pixels without a front that ends at a side of the rectangle with nothing beyond (`left_open`,
    `right_open`) is outside the object and does not count. A run between two parts of the object does count, which
    costs time but changes nothing.
    """
    width, infinite = front.shape[1], np.float32(np.inf)
    limits[line, :] = -infinite
    for y in range(line * TILE, min((line + 1) * TILE, len(front))):
        start, end = 0, width
        while left_open and start < width and front[y, start] == infinite and not (faces and face[y, start, 3] > 0):
            ends[y, start] = -infinite
            start += 1
        while right_open and end > start and front[y, end - 1] == infinite and not (faces and face[y, end - 1, 3] > 0):
            end -= 1
            ends[y, end] = -infinite
        opaque = np.float32(FACE_OPAQUE)
        for x in range(np.uintp(start), np.uintp(end)):
            ends[y, x] = front[y, x]
        if faces:
            for x in range(np.uintp(start), np.uintp(end)):
                ends[y, x] = min(ends[y, x], depths[y, x] if face[y, x, 3] >= opaque else infinite)
        for column in range(start // TILE, -(-end // TILE)):
            most = limits[line, column]
            for x in range(np.uintp(column * TILE), np.uintp(min((column + 1) * TILE, width))):
                most = max(most, ends[y, x])
                if most < infinite and ends[y, x] == front[y, x] and is_partly_covered(sums[y, x]):
                    most = infinite
            limits[line, column] = most


@njit(cache=True, error_model="numpy", nogil=True)
def seen_through(chunk, chunk_size, rows, geometry, enlarge, cam, limits, layer, seen):
    """Marks in `seen` (N,) the atoms of a chunk that begin in front of the limit of a tile they touch, or within the
    layer behind it."""
    lines, columns = limits.shape
    ortho = cam.orthographic != 0.0
    tilt = 1.0
    if not ortho:  # a splat's affine extent is 3 sigma f / z sqrt(1 + slope^2), the slope clamped
        across, down = max(-cam.x_low, cam.x_high), max(-cam.y_low, cam.y_high)
        tilt = math.sqrt(1.0 + across * across + down * down)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(rows))):
        seen[i] = False
        g = geometry[rows[i]]
        z = cam.rotation[6] * g[0] + cam.rotation[7] * g[1] + cam.rotation[8] * g[2] + cam.translation[2]
        if not z > cam.near:
            continue
        x = cam.rotation[0] * g[0] + cam.rotation[1] * g[1] + cam.rotation[2] * g[2] + cam.translation[0]
        y = cam.rotation[3] * g[0] + cam.rotation[4] * g[1] + cam.rotation[5] * g[2] + cam.translation[1]
        over = 1.0 if ortho else z
        u, v = cam.fx * x / over + cam.cx, cam.fy * y / over + cam.cy
        size = 3.0 * enlarge * max(g[3], g[4], g[5])
        reach = size * max(cam.fx, cam.fy) / over * tilt + 3.0
        x0, x1 = max(math.floor((u - reach) / TILE), 0.0), min(math.floor((u + reach) / TILE) + 1.0, columns)
        y0, y1 = max(math.floor((v - reach) / TILE), 0.0), min(math.floor((v + reach) / TILE) + 1.0, lines)
        if x0 < x1 and y0 < y1:
            seen[i] = deepest(limits, int(x0), int(x1), int(y0), int(y1)) >= z - size - layer


@njit(cache=True, error_model="numpy", nogil=True)
def deepest(limits, x0, x1, y0, y1):
    """Largest limit of some tiles."""
    most = limits[y0, x0]
    for y in range(y0, y1):
        for x in range(x0, x1):
            most = max(most, limits[y, x])
    return most


@njit(cache=True, error_model="numpy", nogil=True)
def fill_holes(line, tiled, colours, hidden, hidden_colours, ends, front, sums):
    """Recomputes front (H, W) and sums (H, W, SUMS) of a line of tiles where hidden atoms are visible, and adds those
    that lie behind partly covered pixels.

    tiled and hidden: TiledSplats of what was drawn and of what was culled, with the same planes.
    """
    height, width = front.shape
    kind = tiled.records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((7, AREA), kind)
    h, z, limit, nearest, shown = lane[2], lane[3], lane[4], lane[5], lane[6]
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(lane.reshape(-1)[: 4 * AREA], base, slope)
    visible = np.empty(AREA, np.bool_)
    behind = np.empty((SUMS, AREA), kind)
    layer, infinite = kind(tiled.layer), kind(np.inf)
    core, cutoff = kind(0.5 * CORE_Q), kind(0.5 * CUTOFF_Q)
    for column in range(tiled.columns):
        tile = line * tiled.columns + column
        if hidden.tile_starts[tile] == hidden.tile_starts[tile + 1]:
            continue
        fill_rays(tiled, tile, rays)
        for k in range(AREA):
            x, y = column * TILE + k % TILE, line * TILE + k // TILE
            nearest[k] = front[y, x] if x < width and y < height else -infinite
            limit[k] = ends[y, x] + layer if x < width and y < height else -infinite
            visible[k] = False
        for pair in range(hidden.tile_starts[tile], hidden.tile_starts[tile + 1]):
            i = hidden.splat_ids[pair]
            fragments(hidden.records, i, hidden.spans[i, 4], hidden.spans[i, 5], near, rays, 0, AREA)
            for k in range(AREA):
                visible[k] |= (h[k] <= cutoff) & (z[k] < infinite) & (z[k] <= limit[k])
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        behind[:] = kind(0.0)
        for k in range(AREA):
            x, y = column * TILE + k % TILE, line * TILE + k // TILE
            limit[k] = infinite
            if x < width and y < height and not visible[k] and front[y, x] < infinite and ends[y, x] == front[y, x]:
                limit[k] = front[y, x] + layer if is_partly_covered(sums[y, x]) else infinite
                shown[k] = front[y, x]
        add_behind(hidden, hidden_colours, tile, rays, shown, limit, behind)
        for k in range(AREA):
            x, y = column * TILE + k % TILE, line * TILE + k // TILE
            if behind[BEHIND, k] > kind(0.0):
                for c in range(BEHIND, SUMS):
                    sums[y, x, c] += behind[c, k]
            if not visible[k]:
                continue
            begin = nearest[k] - layer if nearest[k] < infinite else -infinite
            last = nearest[k] + layer if nearest[k] < infinite else kind(FAR)
            total = np.zeros(SUMS, kind)
            for pass_ in range(2):
                drawn, rgb = (hidden, hidden_colours) if pass_ else (tiled, colours)
                for pair in range(drawn.tile_starts[tile], drawn.tile_starts[tile + 1]):
                    i = drawn.splat_ids[pair]
                    fragments(drawn.records, i, drawn.spans[i, 4], drawn.spans[i, 5], near, rays, k, k + 1)
                    if h[k] <= cutoff and z[k] < infinite:
                        g = math.exp(-h[k])
                        w = g * drawn.records[i, WEIGHT]
                        first = BEFORE if z[k] < begin else 0 if z[k] <= last else BEHIND
                        total[first] += w
                        total[first + 1] += g * drawn.records[i, SHARPNESS]
                        if first == BEHIND:
                            w *= depth_weight(z[k], nearest[k], layer)
                            total[BEHIND + 5] += w
                        for c in range(3):
                            total[first + 2 + c] += w * rgb[i, c]
            front[y, x] = nearest[k]
            for c in range(SUMS):  # for a whole row numba would also compile an error message, for seconds
                sums[y, x, c] = total[c]
