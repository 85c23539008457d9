"""Numba kernels of frozen geometry: fill the sparse matrix of a view and multiply it with colours."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.ray_entry import skin_part
from engine.render.cpu.splats import DEPTH, DEPTH_EXTENT, TILE, WEIGHT
from engine.render.cpu.tiles import AREA, TILES_PER_TASK, TileRays, fill_rays, fragments, rows_of
from engine.render.cpu.weights import BEFORE, BEHIND, depth_weight, falloff, outside_shares
from engine.scene.constants import CUTOFF_Q, MIN_WEIGHT

__all__ = [
    "ATOMS",
    "ROWS",
    "apply",
    "apply_transposed",
    "blend_bands",
    "count_splats",
    "fill_faces",
    "fill_shares",
    "fill_splats",
    "mark_columns",
    "renumber",
    "spread_bands",
    "truncate",
    "weigh_faces",
]

ROWS = 4096
"""Rows of the matrix per task."""

ATOMS = 4096
"""Atoms in a task."""


@njit(cache=True, error_model="numpy", nogil=True)
def fill_shares(y, sums, left, shares):
    """Fills row y of shares (H, W, 3): how much of a pixel a unit of weight shows in the layer, before it and behind
    it, from sums (H, W, SUMS) and what cut faces leave of the pixel, left (H, W)."""
    for x in range(sums.shape[1]):
        layer, before, behind = outside_shares(sums[y, x])
        shares[y, x, 0] = left[y, x] * layer / max(sums[y, x, 0], MIN_WEIGHT)
        shares[y, x, 1] = left[y, x] * before / max(sums[y, x, BEFORE], MIN_WEIGHT)
        shares[y, x, 2] = left[y, x] * behind / sums[y, x, BEHIND + 5] if behind > 0.0 else 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def count_splats(task, tiled, front, shares, count):
    """Adds to count (H, W) the number of fragments that each pixel shows, by its shares (H, W, 3)."""
    atoms, weights, cursor = np.empty(0, np.int32), np.empty(0, np.float32), np.empty((0, 0), np.int64)
    _walk(task, tiled, front, shares, count, cursor, atoms, weights)


@njit(cache=True, error_model="numpy", nogil=True)
def fill_splats(task, tiled, front, shares, cursor, atoms, weights):
    """Writes the fragments that `count_splats` counts, weights times shares, at cursor (H, W), which advances."""
    _walk(task, tiled, front, shares, np.empty((0, 0), np.int64), cursor, atoms, weights)


@njit(cache=True, error_model="numpy", nogil=True)
def _walk(task, tiled, front, shares, count, cursor, atoms, weights):
    """The second pass of `engine.render.cpu.tiles.accumulate` over some tiles, fragment by fragment: counts them, or
    writes them if there is a cursor. Asked of its size, so that one kernel does both."""
    height, width = front.shape
    fill = len(cursor) > 0
    records, spans = tiled.records, tiled.spans
    kind = records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((4, AREA), kind)
    h, z = lane[2], lane[3]
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(lane.reshape(-1), base, slope)
    infinite, cutoff, layer = kind(np.inf), kind(0.5 * CUTOFF_Q), kind(tiled.layer)
    for tile in range(task * TILES_PER_TASK, min((task + 1) * TILES_PER_TASK, len(tiled.tile_starts) - 1)):
        left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
        last = -infinite
        for y in range(top, min(top + TILE, height)):
            for x in range(left, min(left + TILE, width)):
                if shares[y, x, 2] > 0.0:
                    last = infinite
                elif shares[y, x, 0] > 0.0 or shares[y, x, 1] > 0.0:
                    last = max(last, front[y, x] + layer)
        if last == -infinite:
            continue
        fill_rays(tiled, tile, rays)
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            if records[i, DEPTH] - records[i, DEPTH_EXTENT] > last:
                continue
            start, end = rows_of(records, i, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
            for k in range(start, end):
                x, y = left + k % TILE, top + k // TILE
                if not (h[k] <= cutoff and z[k] < infinite and x < width and y < height):
                    continue
                nearest = front[y, x]
                if z[k] > nearest + layer:
                    share = shares[y, x, 2]
                    share *= depth_weight(z[k], nearest, layer) if share > 0.0 else 0.0
                elif z[k] < nearest - layer and nearest < infinite:
                    share = shares[y, x, 1]
                else:
                    share = shares[y, x, 0]
                if share > 0.0:
                    if fill:
                        atoms[cursor[y, x]] = i
                        weights[cursor[y, x]] = falloff(h[k]) * records[i, WEIGHT] * share
                        cursor[y, x] += 1
                    else:
                        count[y, x] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def fill_faces(task, pixels, offsets, columns, entries, share, cursor, atoms, weights):
    """Writes the terms of the kernel field, offsets (K + 1,), for face pixels (K,), times share (K,)."""
    for k in range(task * ROWS, min((task + 1) * ROWS, len(pixels))):
        place = cursor[pixels[k]]
        if share[k] > 0.0:
            for e in range(offsets[k], offsets[k + 1]):
                atoms[place] = columns[e]
                weights[place] = entries[e] * share[k]
                place += 1
            cursor[pixels[k]] = place


@njit(cache=True, nogil=True)
def mark_columns(task, offsets, atoms, occurs):
    """Sets occurs (C,) for the columns with an entry; several tasks may set the same one, to the same value."""
    for e in range(offsets[task * ROWS], offsets[min((task + 1) * ROWS, len(offsets) - 1)]):
        occurs[atoms[e]] = True


@njit(cache=True, nogil=True)
def renumber(task, offsets, atoms, numbers):
    """Replaces the columns of some rows by numbers (C,)."""
    for e in range(offsets[task * ROWS], offsets[min((task + 1) * ROWS, len(offsets) - 1)]):
        atoms[e] = numbers[atoms[e]]


@njit(cache=True, nogil=True)
def weigh_faces(task, offsets, atoms, surface_count, weights, density, mass):
    """Fills density (P,), the sum of each row's weights, then scales the weights of the skin (`skin_part`) and fills
    mass (P,), the sum of the scaled weights."""
    for row in range(task * ROWS, min((task + 1) * ROWS, len(offsets) - 1)):
        skin, interior = np.float32(0), np.float32(0)
        for e in range(offsets[row], offsets[row + 1]):
            if atoms[e] < surface_count:
                skin += weights[e]
            else:
                interior += weights[e]
        part = skin_part(interior)
        for e in range(offsets[row], offsets[row + 1]):
            if atoms[e] < surface_count:
                weights[e] *= part
        density[row] = skin + interior
        mass[row] = interior + part * skin


@njit(cache=True, error_model="numpy", nogil=True)
def truncate(task, offsets, atoms, weights, keep, new_offsets, new_atoms, new_weights):
    """The `keep` largest entries of each row in their old order, scaled to preserve the row's sum."""
    largest = np.empty(keep, np.int64)  # indices of the largest so far, largest first
    for row in range(task * ROWS, min((task + 1) * ROWS, len(offsets) - 1)):
        begin, end, place = offsets[row], offsets[row + 1], new_offsets[row]
        if end - begin <= keep:
            for e in range(begin, end):
                new_atoms[place + e - begin] = atoms[e]
                new_weights[place + e - begin] = weights[e]
            continue
        count, total = 0, 0.0
        for e in range(begin, end):
            total += weights[e]
            if count == keep and weights[e] <= weights[largest[keep - 1]]:
                continue
            k = count if count < keep else keep - 1
            while k > 0 and weights[largest[k - 1]] < weights[e]:
                largest[k] = largest[k - 1]
                k -= 1
            largest[k] = e
            count = min(count + 1, keep)
        kept = 0.0
        for k in range(keep):
            e = largest[k]
            kept += weights[e]
            at = k
            while at > 0 and largest[at - 1] > e:
                largest[at] = largest[at - 1]
                at -= 1
            largest[at] = e
        scale = total / kept if kept > MIN_WEIGHT * total else 0.0
        for k in range(keep):
            new_atoms[place + k] = atoms[largest[k]]
            new_weights[place + k] = weights[largest[k]] * scale


@njit(cache=True, nogil=True)
def apply(task, offsets, atoms, weights, colours, picture):
    """Fills some rows of picture (P, 3) = W colours (V, 3)."""
    for row in range(task * ROWS, min((task + 1) * ROWS, len(offsets) - 1)):
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for e in range(offsets[row], offsets[row + 1]):
            w, i = weights[e], atoms[e]
            red += w * colours[i, 0]
            green += w * colours[i, 1]
            blue += w * colours[i, 2]
        picture[row, 0], picture[row, 1], picture[row, 2] = red, green, blue


@njit(cache=True, nogil=True)
def apply_transposed(band, offsets, atoms, weights, picture, parts):
    """Fills one of parts (bands, V, 3), whose sum is W^T picture (P, 3), with the share of a band of rows."""
    bands, rows = len(parts), len(offsets) - 1
    part = parts[band]
    part[:] = np.float32(0)
    for row in range(rows * band // bands, rows * (band + 1) // bands):
        red, green, blue = picture[row, 0], picture[row, 1], picture[row, 2]
        for e in range(offsets[row], offsets[row + 1]):
            w, i = weights[e], atoms[e]
            part[i, 0] += w * red
            part[i, 1] += w * green
            part[i, 2] += w * blue


@njit(cache=True, error_model="numpy", nogil=True)
def blend_bands(task, used, basis, coefficients, colours):
    """Fills some of the first U rows of colours: the sum over the bands of basis (U, K) times coefficients (S, K, 3) of
    the atoms `used`."""
    for n in range(task * ATOMS, min((task + 1) * ATOMS, len(basis))):
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for k in range(basis.shape[1]):
            red += basis[n, k] * coefficients[used[n], k, 0]
            green += basis[n, k] * coefficients[used[n], k, 1]
            blue += basis[n, k] * coefficients[used[n], k, 2]
        colours[n, 0], colours[n, 1], colours[n, 2] = red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def spread_bands(task, used, basis, colours, coefficients):
    """The transpose of `blend_bands`: adds basis times colours to the coefficients. No atom is used twice."""
    for n in range(task * ATOMS, min((task + 1) * ATOMS, len(basis))):
        for k in range(basis.shape[1]):
            for c in range(3):
                coefficients[used[n], k, c] += basis[n, k] * colours[n, c]
