"""The exact Euclidean distance transform of a grid, in parallel (Felzenszwalb and Huttenlocher 2012), the cells within
a distance, which take a quarter of the work, and the distances alone in a picture (Meijster et al. 2000).

Written by hand because SciPy's runs on one core; benchmarks/by_hand.py measures both, figures in
docs/charts/by_hand.json. In a picture SciPy takes three to nine times as long on one core: it finds the nearest pixels
first, and then its distances from arrays of their places.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import for_each, for_spans

__all__ = ["depth_in", "nearest", "within"]

FAR = np.float32(1e12)
"""Squared distance where no cell is true: above any in a grid, yet float32 still resolves its sums."""

BEYOND = np.int16(16_000)
"""Squared distance of cells out of reach. Plus the square of the reach, which is at most 126 cells, it still fits an
int16."""

LINES = 64
"""Lines that one task goes through: a few thousand cells."""

LANES = 1024
"""Cells of neighbouring lines that one task goes through together: a few kilobytes, which stay in the nearest cache."""


def within(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """(X, Y, Z). Cells whose centre is within the radius, 0 to 126 cells, of that of a true cell. Bit-equal to where
    `nearest` is at most the radius."""
    assert mask.ndim == 3 and 0 <= radius <= 126, (mask.shape, radius)
    limit = int(radius**2) + 1
    while np.sqrt(np.float32(limit)) > np.float32(radius):  # as `nearest` rounds the distance
        limit -= 1
    x, y, z = mask.shape
    reach = int(limit**0.5)
    squared, nearer = np.empty(mask.shape, np.int16), np.empty(mask.shape, np.int16)
    lines = np.ascontiguousarray(mask).reshape(x * y, z)
    for_spans(_along_lines, x * y, lines, reach, squared.reshape(x * y, z), span=LINES)
    flat = nearer.reshape(1, x, y * z), squared.reshape(1, x, y * z)
    for_each(_across_lines, x * -(-z // LANES), squared, reach, nearer)
    for_each(_across_lines, -(-y * z // LANES), flat[0], reach, flat[1])
    return squared <= limit


@njit(cache=True, nogil=True)
def _along_lines(
    start: int,
    stop: int,
    mask: NDArray[np.bool_],  # [L, N]
    reach: int,
    squared: NDArray[np.int16],  # [L, N], filled
) -> None:
    """Fills in the squared distance to the nearest true cell of the same line, or BEYOND."""
    n = mask.shape[1]
    for line in range(start, stop):
        away = reach + 1
        for q in range(n):
            away = 0 if mask[line, q] else min(away + 1, reach + 1)
            squared[line, q] = away
        away = reach + 1
        for q in range(n - 1, -1, -1):
            away = min(away + 1, int(squared[line, q]))
            squared[line, q] = away * away if away <= reach else BEYOND


@njit(cache=True, nogil=True)
def _across_lines(
    task: int,
    squared: NDArray[np.int16],  # [A, N, B]
    reach: int,
    nearer: NDArray[np.int16],  # [A, N, B], filled
) -> None:
    """Fills in the least sum of a cell's squared distance and that to it along the middle axis, up to the reach; at
    most BEYOND."""
    _, n, width = squared.shape
    blocks = (width + LANES - 1) // LANES
    slab, first = task // blocks, task % blocks * LANES
    end = min(first + LANES, width)
    for q in range(n):
        nearest_so_far = nearer[slab, q, first:end]
        for lane in range(end - first):
            nearest_so_far[lane] = BEYOND
        for p in range(max(q - reach, 0), min(q + reach + 1, n)):
            there, step = squared[slab, p, first:end], np.int16((p - q) * (p - q))
            for lane in range(end - first):
                nearest_so_far[lane] = min(nearest_so_far[lane], np.int16(there[lane] + step))


def nearest(mask: NDArray[np.bool_]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """(X, Y, Z) twice. Distance in cells to the centre of the nearest true cell, and that cell's flat index.

    If no cell is true, every distance is infinite and every index -1.
    """
    assert mask.ndim == 3 and mask.size < 2**31, mask.shape
    squared = np.where(mask, np.float32(0), FAR)
    index = np.where(mask, np.arange(mask.size, dtype=np.int32).reshape(mask.shape), np.int32(-1))
    for axis in range(3):
        # Each pass works on lines of the last axis, which are contiguous in memory.
        lines = np.ascontiguousarray(np.moveaxis(squared, axis, 2))
        owners = np.ascontiguousarray(np.moveaxis(index, axis, 2))
        flat = lines.reshape(-1, lines.shape[2]), owners.reshape(-1, lines.shape[2])
        for_spans(_envelopes, len(flat[0]), *flat, span=LINES)
        squared, index = np.moveaxis(lines, 2, axis), np.moveaxis(owners, 2, axis)
    distance = np.sqrt(np.ascontiguousarray(squared))
    distance[distance > np.float32(1e5)] = np.inf
    return distance, np.ascontiguousarray(index)


@njit(cache=True, nogil=True)
def _envelopes(
    start: int,
    stop: int,
    lines: NDArray[np.float32],  # [L, N] squared distances, replaced
    owners: NDArray[np.int32],  # [L, N] flat indices, replaced
) -> None:
    """Replaces each line by the lower envelope of the parabolas that stand on its samples."""
    n = lines.shape[1]
    apex = np.empty(n, np.int32)
    begin = np.empty(n + 1, np.float64)
    value = np.empty(n, np.float32)
    owner = np.empty(n, np.int32)
    for line in range(start, stop):
        top = -1
        for q in range(n):
            f = np.float64(lines[line, q])
            if owners[line, q] < 0:
                continue
            cut = -np.inf
            while top >= 0:
                v = apex[top]
                cut = (f + q * q - (np.float64(lines[line, v]) + v * v)) / (2.0 * (q - v))
                if cut > begin[top]:
                    break
                top -= 1
            if top < 0:
                cut = -np.inf
            top += 1
            apex[top] = q
            begin[top] = cut
        if top < 0:
            continue
        begin[top + 1] = np.inf
        k = 0
        for q in range(n):
            while begin[k + 1] < q:
                k += 1
            v = apex[k]
            value[q] = lines[line, v] + np.float32((q - v) * (q - v))
            owner[q] = owners[line, v]
        # Number by number: for whole slices numba would also compile an error message, which takes seconds.
        for q in range(n):
            lines[line, q] = value[q]
            owners[line, q] = owner[q]


def depth_in(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(H, W). Distance of each pixel of a mask to the nearest pixel outside it, 0 outside. Bit-equal to SciPy's
    `distance_transform_edt`, whose odd numbers it also gives where nothing is outside."""
    assert mask.ndim == 2 and mask.dtype == np.bool_, (mask.shape, mask.dtype)
    if mask.all():
        return np.asarray(ndimage.distance_transform_edt(mask))
    height, width = mask.shape
    steps, depth = np.empty(mask.shape, np.int32), np.empty(mask.shape)
    for_spans(_along_columns, width, np.ascontiguousarray(mask), steps, span=LANES)
    for_spans(_across_columns, height, steps, depth, span=LINES)
    return depth


@njit(cache=True, nogil=True)
def _along_columns(
    start: int,
    stop: int,
    mask: NDArray[np.bool_],  # [H, W]
    steps: NDArray[np.int32],  # [H, W], filled
) -> None:
    """Fills in the distance to the nearest pixel of the same column that is outside, or more than the diagonal."""
    height, width = mask.shape
    for x in range(start, stop):
        steps[0, x] = height + width if mask[0, x] else 0
    for y in range(1, height):
        for x in range(start, stop):
            steps[y, x] = min(steps[y - 1, x] + 1, height + width) if mask[y, x] else 0
    for y in range(height - 2, -1, -1):
        for x in range(start, stop):
            steps[y, x] = min(steps[y, x], steps[y + 1, x] + 1)


@njit(cache=True, nogil=True)
def _across_columns(
    start: int,
    stop: int,
    steps: NDArray[np.int32],  # [H, W]
    depth: NDArray[np.float64],  # [H, W], filled
) -> None:
    """Fills in the distances of whole rows: the lower envelope of the parabolas that stand on their pixels."""
    width = steps.shape[1]
    apex, begin = np.empty(width, np.int64), np.empty(width, np.int64)
    for y in range(start, stop):
        top = 0
        apex[0], begin[0] = 0, 0
        for x in range(1, width):
            f = np.int64(steps[y, x]) ** 2
            # Back to the parabola that is the lower one where its own part begins.
            while top >= 0:
                v, at = apex[top], begin[top]
                if (at - v) ** 2 + np.int64(steps[y, v]) ** 2 <= (at - x) ** 2 + f:
                    break
                top -= 1
            first = np.int64(0)
            if top >= 0:
                v = apex[top]
                first = 1 + (x * x - v * v + f - np.int64(steps[y, v]) ** 2) // (2 * (x - v))
            if first < width:
                top += 1
                apex[top], begin[top] = x, first
        for x in range(width - 1, -1, -1):
            v = apex[top]
            depth[y, x] = np.sqrt(np.float64((x - v) ** 2 + np.int64(steps[y, v]) ** 2))
            if x == begin[top]:
                top -= 1
