"""Numba kernels of frozen geometry: filling the sparse matrix of a view, and its products with colours."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from engine.formula import CUTOFF_Q, EPSILON_PITCHES, MIN_WEIGHT
from engine.splat_kernels import AREA, FAR, TILE, falloff, fragments, rows_of, tile_points

__all__ = ["BANDS", "apply", "apply_transposed", "count_splats", "fill_faces", "fill_splats", "layer_limit", "truncate"]

BANDS = 8
"""Parts of a picture whose gradients are summed apart and then together; fixed, so that threads do not matter."""


def layer_limit(front: np.ndarray, pitch: float) -> np.ndarray:
    """(H, W). Depth behind which a fragment has no part in its pixel, from the front depth (H, W)."""
    return np.where(np.isfinite(front), front + front.dtype.type(EPSILON_PITCHES * pitch), front.dtype.type(FAR))


@njit(cache=True, parallel=True, error_model="numpy")
def count_splats(cam, planes, records, spans, first, splats, columns, limit, share, count):  # type: ignore[no-untyped-def]
    """Adds to count (H, W) the fragments of every pixel whose share (H, W) of the picture is not zero."""
    empty_atoms, empty_weights = np.empty(0, np.int32), np.empty(0, np.float32)
    empty_cursor = np.empty((0, 0), np.int64)
    for tile in prange(len(first) - 1):
        _walk(
            cam, planes, records, spans, first, splats, columns, limit, share, tile,
            count, False, empty_cursor, empty_atoms, empty_weights,
        )  # fmt: skip


@njit(cache=True, parallel=True, error_model="numpy")
def fill_splats(  # type: ignore[no-untyped-def]
    cam, planes, records, spans, first, splats, columns, limit, share, cursor, atoms, weights
):
    """Writes the fragments that `count_splats` counts at cursor (H, W), which moves on; weights times share."""
    empty_count = np.empty((0, 0), np.int64)
    for tile in prange(len(first) - 1):
        _walk(
            cam, planes, records, spans, first, splats, columns, limit, share, tile,
            empty_count, True, cursor, atoms, weights,
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _walk(  # type: ignore[no-untyped-def]
    cam, planes, records, spans, first, splats, columns, limit, share, tile, count, fill, cursor, atoms, weights
):
    """The second pass over a tile, as in `splat_kernels.accumulate`, fragment by fragment."""
    height, width = limit.shape
    left, top = tile % columns * TILE, tile // columns * TILE
    lane = np.empty((4, AREA), records.dtype)
    base, slope = np.empty((len(planes), AREA), records.dtype), np.empty((len(planes), AREA), records.dtype)
    px, py, h, z = lane[0], lane[1], lane[2], lane[3]
    tile_points(cam, planes, left, top, px, py, base, slope)
    cutoff, near = records.dtype.type(0.5 * CUTOFF_Q), records.dtype.type(cam[21])
    last = -np.inf
    for y in range(top, min(top + TILE, height)):
        for x in range(left, min(left + TILE, width)):
            if share[y, x] > 0.0:
                last = max(last, limit[y, x])
    for pair in range(first[tile], first[tile + 1]):
        i = splats[pair]
        r = records[i]
        if r[5] - r[9] > last:
            continue
        start, end = rows_of(r, math.sqrt(CUTOFF_Q), left, top)
        if start == end:
            continue
        fragments(r, spans[i], near, px, py, base, slope, start, end, h, z)
        for k in range(start, end):
            x, y = left + k % TILE, top + k // TILE
            if x < width and y < height and h[k] <= cutoff and z[k] <= limit[y, x] and share[y, x] > 0.0:
                if fill:
                    atoms[cursor[y, x]] = i
                    weights[cursor[y, x]] = falloff(h[k]) * r[10] * share[y, x]
                    cursor[y, x] += 1
                else:
                    count[y, x] += 1


@njit(cache=True, parallel=True, error_model="numpy")
def fill_faces(pixels, offsets, columns, entries, share, cursor, atoms, weights):  # type: ignore[no-untyped-def]
    """Writes the terms of the kernel field, offsets (K + 1,), for face pixels (K,), times share (K,)."""
    for k in prange(len(pixels)):
        place = cursor[pixels[k]]
        if share[k] > 0.0:
            for e in range(offsets[k], offsets[k + 1]):
                atoms[place] = columns[e]
                weights[place] = entries[e] * share[k]
                place += 1
            cursor[pixels[k]] = place


@njit(cache=True, parallel=True, error_model="numpy")
def truncate(offsets, atoms, weights, keep, new_offsets, new_atoms, new_weights):  # type: ignore[no-untyped-def]
    """The `keep` largest entries of each row in their old order, scaled so that the row's sum stays."""
    for row in prange(len(offsets) - 1):
        begin, end, place = offsets[row], offsets[row + 1], new_offsets[row]
        if end - begin <= keep:
            for e in range(begin, end):
                new_atoms[place + e - begin] = atoms[e]
                new_weights[place + e - begin] = weights[e]
            continue
        largest = np.empty(keep, np.int64)  # places of the largest so far, largest first
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
        largest.sort()
        kept = 0.0
        for k in range(keep):
            kept += weights[largest[k]]
        scale = total / kept if kept > MIN_WEIGHT * total else 0.0
        for k in range(keep):
            new_atoms[place + k] = atoms[largest[k]]
            new_weights[place + k] = weights[largest[k]] * scale


@njit(cache=True, parallel=True)
def apply(offsets, atoms, weights, colours, picture):  # type: ignore[no-untyped-def]
    """picture (P, 3) = W colours (V, 3)."""
    for row in prange(len(offsets) - 1):
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for e in range(offsets[row], offsets[row + 1]):
            w, i = weights[e], atoms[e]
            red += w * colours[i, 0]
            green += w * colours[i, 1]
            blue += w * colours[i, 2]
        picture[row, 0], picture[row, 1], picture[row, 2] = red, green, blue


@njit(cache=True, parallel=True)
def apply_transposed(offsets, atoms, weights, picture, colours):  # type: ignore[no-untyped-def]
    """colours (V, 3) = W^T picture (P, 3): each band of rows into its own sums, then these in their order."""
    rows = len(offsets) - 1
    part = np.zeros((BANDS, len(colours), 3), np.float32)
    for band in prange(BANDS):
        for row in range(rows * band // BANDS, rows * (band + 1) // BANDS):
            red, green, blue = picture[row, 0], picture[row, 1], picture[row, 2]
            for e in range(offsets[row], offsets[row + 1]):
                w, i = weights[e], atoms[e]
                part[band, i, 0] += w * red
                part[band, i, 1] += w * green
                part[band, i, 2] += w * blue
    for i in prange(len(colours)):
        for c in range(3):
            total = part[0, i, c]
            for band in range(1, BANDS):
                total += part[band, i, c]
            colours[i, c] = total
