"""Front-to-back order of the Gaussians that may be seen: stable, exact, by radix."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.projection import camera_point
from engine.threads import for_each

__all__ = ["depth_order"]

CHUNK = 1 << 15
"""Gaussians to a task: long enough to hide the cost of handing it out."""

DIGIT = 12
"""Bits sorted in one pass: its histogram of 4096 counts fits a first-level cache. Depths within a factor of two of each
other differ in 23 bits: two passes."""


def depth_order(
    cam: NDArray[np.float64],  # [CAMERA_SIZE]
    means: NDArray[np.floating],  # [N, 3]
) -> NDArray[np.int64]:
    """(V,) int64. Indices of the Gaussians beyond the near plane, nearest first, equal depths in index order.

    Float32 means are ordered by their depth in float32, float64 ones in float64.
    """
    n = len(means)
    if means.dtype == np.float64:
        depths = means @ cam[6:9] + cam[11]
        rows = np.flatnonzero((depths > cam[21]) & np.isfinite(depths))
        return rows[np.argsort(depths[rows], kind="stable")]
    chunks = -(-n // CHUNK)
    items = np.empty(n, np.uint64)
    counts = np.zeros(chunks, np.int64)
    low = np.full(chunks, 0xFFFFFFFF, np.uint64)
    high = np.zeros(chunks, np.uint64)
    for_each(_depth_keys, chunks, cam, means, items, counts, low, high)
    visible = int(counts.sum())
    if visible == 0:
        return np.empty(0, np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)])
    packed = np.empty(visible, np.uint64)
    bottom = np.uint64(low.min())
    for_each(_pack, chunks, items, starts, bottom, packed)
    bits = int(high.max() - bottom).bit_length()
    spare = items[:visible]
    chunks = -(-visible // CHUNK)
    histogram = np.empty((chunks, 1 << DIGIT), np.int64)
    for shift in range(0, bits, DIGIT):
        for_each(_count_digits, chunks, packed, shift, histogram)
        _prefix(histogram)
        for_each(_scatter_digits, chunks, packed, shift, histogram, spare)
        packed, spare = spare, packed
    order = np.empty(visible, np.int64)
    for_each(_indices, chunks, packed, order)
    return order


@njit(cache=True, error_model="numpy", nogil=True)
def _depth_keys(chunk, cam, means, items, counts, low, high):  # type: ignore[no-untyped-def]
    """Sortable key of the depth in the upper, index in the lower 32 bits; visible ones first in the chunk."""
    start = chunk * CHUNK
    stop = min(start + CHUNK, len(means))
    one = np.empty(1, np.float32)
    bits = one.view(np.uint32)
    at = start
    for i in range(start, stop):
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        if not (z > cam[21] and abs(x) + abs(y) + abs(z) < 1e30):  # also drops what is not a number
            continue
        one[0] = z
        key = np.uint64(bits[0])
        # Floats of one sign order as their bits do; the others are turned round, below them.
        key = key | np.uint64(0x80000000) if key < np.uint64(0x80000000) else np.uint64(0xFFFFFFFF) - key
        items[at] = (key << np.uint64(32)) | np.uint64(i)
        at += 1
        low[chunk] = min(low[chunk], key)
        high[chunk] = max(high[chunk], key)
    counts[chunk] = at - start


@njit(cache=True, error_model="numpy", nogil=True)
def _pack(chunk, items, starts, bottom, packed):  # type: ignore[no-untyped-def]
    """Closes the gaps between chunks and counts keys from the smallest one."""
    source = chunk * CHUNK
    offset = bottom << np.uint64(32)
    for k in range(starts[chunk + 1] - starts[chunk]):
        packed[starts[chunk] + k] = items[source + k] - offset


@njit(cache=True, error_model="numpy", nogil=True)
def _count_digits(chunk, items, shift, histogram):  # type: ignore[no-untyped-def]
    histogram[chunk, :] = 0
    by = np.uint64(32 + shift)
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        histogram[chunk, np.int64(items[k] >> by) & ((1 << DIGIT) - 1)] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def _prefix(histogram):  # type: ignore[no-untyped-def]
    """Counts to first places: all of a digit before the next digit, within a digit by chunk."""
    total = 0
    for digit in range(histogram.shape[1]):
        for chunk in range(histogram.shape[0]):
            count = histogram[chunk, digit]
            histogram[chunk, digit] = total
            total += count


@njit(cache=True, error_model="numpy", nogil=True)
def _scatter_digits(chunk, items, shift, places, out):  # type: ignore[no-untyped-def]
    by = np.uint64(32 + shift)
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        digit = np.int64(items[k] >> by) & ((1 << DIGIT) - 1)
        out[places[chunk, digit]] = items[k]
        places[chunk, digit] += 1


@njit(cache=True, error_model="numpy", nogil=True)
def _indices(chunk, items, order):  # type: ignore[no-untyped-def]
    for k in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(items))):
        order[k] = np.int64(items[k] & np.uint64(0xFFFFFFFF))
