"""What is seen through the holes of a skin: hidden atoms that reach before what was drawn count after all.

Atoms that look away from the eye are left out (engine.render.culling.backface), which is right where the skin before
them is whole. Skins of captures have pinholes, pixels without a core or with one from far behind. Each hidden atom is
held against the depth of the tiles that it touches; where one passes, the pixels are made anew of everything.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.splats import TILE
from engine.render.cpu.tiles import AREA, FAR, fragments, tile_points
from engine.scene.constants import CORE_Q, CUTOFF_Q, FACE_OPAQUE

__all__ = ["fill_holes", "seen_through", "tile_depths"]


@njit(cache=True, error_model="numpy", nogil=True)
def tile_depths(line, front, faces, face, depths, left_open, right_open, ends, limits):
    """Fills a line of tiles of ends (H, W), the depth behind which nothing shows, and limits (lines, columns), its
    largest value in each tile.

    A run of pixels without a front that ends at a side of the rectangle with nothing beyond (`left_open`, `right_open`)
    is outside of the object and does not count. One between two parts of it does, which costs time and changes nothing.
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
            limits[line, column] = most


@njit(cache=True, error_model="numpy", nogil=True)
def seen_through(chunk, chunk_size, rows, geometry, enlarge, cam, limits, layer, seen):
    """Marks in `seen` (N,) which of a chunk of atoms begin before the limit of a tile that they touch, or within the
    layer behind it."""
    lines, columns = limits.shape
    ortho = cam.orthographic != 0.0
    tilt = 1.0
    if not ortho:  # a splat's affine extent is 3 sigma f / z sqrt(1 + slope^2), the slope held
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
def fill_holes(line, frame, colours, behind, behind_colours, ends, front, sums):
    """Makes front (H, W) and sums (H, W, 5) of a line of tiles anew where hidden atoms show.

    frame and behind: engine.render.cpu.tiles.Frame of what was drawn and of what was hidden, with the same planes.
    """
    height, width = front.shape
    kind = frame.records.dtype.type
    lane = np.empty((4, AREA), kind)
    px, py, h, z = lane[0], lane[1], lane[2], lane[3]
    base, slope = np.empty((len(frame.planes), AREA), kind), np.empty((len(frame.planes), AREA), kind)
    limit, nearest, shows = np.empty(AREA, kind), np.empty(AREA, kind), np.empty(AREA, np.bool_)
    near, layer, infinite = kind(frame.cam.near), kind(frame.layer), kind(np.inf)
    core, cutoff = kind(0.5 * CORE_Q), kind(0.5 * CUTOFF_Q)
    for column in range(frame.columns):
        tile = line * frame.columns + column
        if behind.first[tile] == behind.first[tile + 1]:
            continue
        tile_points(frame, tile, px, py, base, slope)
        for k in range(AREA):
            x, y = column * TILE + k % TILE, line * TILE + k // TILE
            nearest[k] = front[y, x] if x < width and y < height else -infinite
            limit[k] = ends[y, x] + layer if x < width and y < height else -infinite
            shows[k] = False
        for pair in range(behind.first[tile], behind.first[tile + 1]):
            i = behind.listed[pair]
            fragments(behind.records[i], behind.spans[i], near, px, py, base, slope, 0, AREA, h, z)
            for k in range(AREA):
                shows[k] |= (h[k] <= cutoff) & (z[k] < infinite) & (z[k] <= limit[k])
                nearest[k] = min(nearest[k], z[k] if h[k] <= core else infinite)
        for k in range(AREA):
            x, y = column * TILE + k % TILE, line * TILE + k // TILE
            if not shows[k]:
                continue
            last = nearest[k] + layer if nearest[k] < infinite else kind(FAR)
            total = np.zeros(5, kind)
            for one in range(2):
                drawn, rgb = (behind, behind_colours) if one else (frame, colours)
                for pair in range(drawn.first[tile], drawn.first[tile + 1]):
                    i = drawn.listed[pair]
                    r = drawn.records[i]
                    fragments(r, drawn.spans[i], near, px, py, base, slope, k, k + 1, h, z)
                    if h[k] <= cutoff and z[k] <= last:
                        g = math.exp(-h[k])
                        total[0] += g * r[12]
                        total[1] += g * r[13]
                        for c in range(3):
                            total[2 + c] += g * r[12] * rgb[i, c]
            front[y, x] = nearest[k]
            sums[y, x] = total
