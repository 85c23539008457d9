"""Medians over a window that slides along the rows of a picture, taken of ranks, so that they are exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans

__all__ = ["Ranks"]

ROWS = 16
"""Rows of one channel that a thread takes at a time."""


@dataclass(frozen=True)
class Ranks:
    """The values of a picture and their ranks, which all windows share."""

    rank: NDArray[np.int32]
    """(C, H, W). Rank of each value in its channel."""
    by_rank: NDArray[np.float32]
    """(C, L). The values of each channel in order."""

    @classmethod
    def of(cls, values: NDArray[np.float32]) -> Ranks:
        """The ranks of values (H, W, C)."""
        height, width, channels = values.shape
        planes = np.ascontiguousarray(np.moveaxis(values, 2, 0)).reshape(channels, -1)
        levels, ranks = zip(*(np.unique(plane, return_inverse=True) for plane in planes), strict=True)
        most = max(len(own) for own in levels)
        by_rank = np.stack([np.pad(own, (0, most - len(own)), mode="edge") for own in levels])
        return cls(np.stack(ranks).reshape(channels, height, width).astype(np.int32), by_rank)

    def medians(self, reach: NDArray[np.integer]) -> NDArray[np.float32]:
        """(H, W, C). The medians of the values over a window; the values of the border continue beyond it.

        `reach`: (2 R + 1,). In each row of the window, from R above to R below, columns on either side of its middle.
        Bit-equal to SciPy's median_filter, in a third to a seventh of its time: what enters and leaves the window is
        counted by rank (Huang, Yang and Tang 1979).
        """
        channels, height, _ = self.rank.shape
        out = np.empty(self.rank.shape, np.float32)
        bits = -(-self.by_rank.shape[1].bit_length() // 3)
        count = channels * height
        for_spans(_medians, count, self.rank, self.by_rank, reach.astype(np.int64), bits, out, span=ROWS)
        return np.ascontiguousarray(np.moveaxis(out, 0, 2))


@njit(cache=True, nogil=True)
def _medians(
    start: int,
    stop: int,
    rank: NDArray[np.int32],  # [C, H, W]
    by_rank: NDArray[np.float32],  # [C, L]
    reach: NDArray[np.int64],  # [2 R + 1]
    bits: int,  # of a rank, resolved by each of the three counts
    out: NDArray[np.float32],  # [C, H, W]
) -> None:
    height, width = rank.shape[1], rank.shape[2]
    half = (2 * reach + 1).sum() // 2
    fine = np.zeros(1 << 3 * bits, np.int32)
    some = np.zeros(1 << 2 * bits, np.int32)
    coarse = np.zeros(1 << bits, np.int32)
    for row in range(start, stop):
        c, i = row // height, row % height
        fine[:] = 0
        some[:] = 0
        coarse[:] = 0
        for k in range(len(reach)):
            line = rank[c, min(max(i + k - len(reach) // 2, 0), height - 1)]
            for j in range(-reach[k], reach[k] + 1):
                r = line[min(max(j, 0), width - 1)]
                fine[r] += 1
                some[r >> bits] += 1
                coarse[r >> 2 * bits] += 1
        for j in range(width):
            r, below = 0, 0
            while below + coarse[r] <= half:
                below += coarse[r]
                r += 1
            r <<= bits
            while below + some[r] <= half:
                below += some[r]
                r += 1
            r <<= bits
            while below + fine[r] <= half:
                below += fine[r]
                r += 1
            out[c, i, j] = by_rank[c, r]
            for k in range(len(reach)):
                line = rank[c, min(max(i + k - len(reach) // 2, 0), height - 1)]
                gone, come = line[max(j - reach[k], 0)], line[min(j + reach[k] + 1, width - 1)]
                fine[gone] -= 1
                some[gone >> bits] -= 1
                coarse[gone >> 2 * bits] -= 1
                fine[come] += 1
                some[come >> bits] += 1
                coarse[come >> 2 * bits] += 1
