"""Front-to-back order of the visible Gaussians: a stable radix sort."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.projection import CameraRecord, camera_point
from engine.threads import for_each

__all__ = ["depth_order"]

CHUNK = 1 << 15
"""Gaussians in a task: enough to hide the cost of starting it."""

DIGIT = 11
"""Bits sorted in one pass: a histogram of 2048 counts fits the first-level cache."""

KEY = 32
"""Bits of a sorted depth: more than the 24 of a float32, with which some of half a million depths would tie and be
blended in the wrong order."""


def depth_order(
    cam: CameraRecord,
    means: NDArray[np.floating],  # [N, 3]
) -> NDArray[np.int64]:
    """(V,) int64. Indices of the Gaussians beyond the near plane, nearest first, equal depths in index order.

    The resolution of an orthographic camera is 2^-KEY of the range of depths. That of a pinhole is relative: 2^-32 if
    the farthest depth is twice the nearest, 2^-28 if it is a thousand times the nearest.
    """
    n = len(means)
    chunks = -(-n // CHUNK)
    depths, rows = np.empty(n, np.float64), np.empty(n, np.uint32)
    counts = np.zeros(chunks, np.int64)
    low, high = np.full(chunks, np.inf), np.full(chunks, -np.inf)
    for_each(_depths, chunks, cam, means, depths, rows, counts, low, high)
    visible = int(counts.sum())
    if visible == 0:
        return np.empty(0, np.int64)
    nearest, farthest = low.min(), high.max()
    if cam.orthographic:
        shift, bits = 0, KEY if farthest > nearest else 0
    else:
        spread = int(farthest.view(np.uint64) - nearest.view(np.uint64)).bit_length()
        shift, bits = max(0, spread - KEY), min(spread, KEY)
    scale = (2.0**KEY - 1.0) / (farthest - nearest) if cam.orthographic and farthest > nearest else 0.0
    starts = np.concatenate([[0], np.cumsum(counts)])
    items = np.empty(visible, np.uint64)
    for_each(_pack, chunks, depths, rows, starts, nearest, bool(cam.orthographic), scale, shift, items)
    spare = depths.view(np.uint64)[:visible]
    chunks = -(-visible // CHUNK)
    histogram = np.empty((chunks, 1 << DIGIT), np.int64)
    for done in range(0, bits, DIGIT):
        for_each(_count_digits, chunks, items, done, histogram)
        _prefix(histogram)
        for_each(_scatter_digits, chunks, items, done, histogram, spare)
        items, spare = spare, items
    order = np.empty(visible, np.int64)
    for_each(_indices, chunks, items, order)
    return order


@njit(cache=True, error_model="numpy", nogil=True)
def _depths(chunk, cam, means, depths, rows, counts, low, high):
    """Fills in depths (float64) and rows of a chunk's visible Gaussians, from the chunk's start on."""
    start = chunk * CHUNK
    at = start
    for i in range(start, min(start + CHUNK, len(means))):
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        if not (z > cam.near and abs(x) + abs(y) + abs(z) < 1e30):  # also drops NaN
            continue
        depths[at] = z
        rows[at] = i
        at += 1
        low[chunk] = min(low[chunk], z)
        high[chunk] = max(high[chunk], z)
    counts[chunk] = at - start


@njit(cache=True, error_model="numpy", nogil=True)
def _pack(chunk, depths, rows, starts, nearest, linear, scale, shift, items):
    """Closes the gaps between chunks: depth above the nearest in the upper 32 bits, row in the lower 32.

    Linear: in steps of the range; else by the bits of the float, which sort as positive floats do.
    """
    source = chunk * CHUNK
    one = np.full(1, nearest)
    pattern = one.view(np.uint64)
    bottom = pattern[0]
    by = np.uint64(shift)
    for k in range(starts[chunk + 1] - starts[chunk]):
        one[0] = depths[source + k]
        key = np.uint64((one[0] - nearest) * scale) if linear else (pattern[0] - bottom) >> by
        items[starts[chunk] + k] = (key << np.uint64(32)) | np.uint64(rows[source + k])


@njit(cache=True, error_model="numpy", nogil=True)
def _count_digits(chunk, items, shift, histogram):
    histogram[chunk, :] = 0
    by = np.uint64(32 + shift)
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        histogram[chunk, np.int64(items[k] >> by) & ((1 << DIGIT) - 1)] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def _prefix(histogram):
    """Turns counts into first places, in place: digit after digit, within a digit chunk after chunk."""
    total = 0
    for digit in range(histogram.shape[1]):
        for chunk in range(histogram.shape[0]):
            count = histogram[chunk, digit]
            histogram[chunk, digit] = total
            total += count


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_digits(chunk, items, shift, places, out):
    by = np.uint64(32 + shift)
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        digit = np.int64(items[k] >> by) & ((1 << DIGIT) - 1)
        out[places[chunk, digit]] = items[k]
        places[chunk, digit] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def _indices(chunk, items, order):
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        order[k] = np.int64(items[k] & np.uint64(0xFFFFFFFF))
