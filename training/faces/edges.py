"""Strength of the edge that an outline follows, by which one of two outlines is chosen."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["EDGE_GAIN", "MIXED", "cheapest_path", "edge_cost", "edge_strength", "rims_apart"]

EDGE_GAIN = 2.0
"""How many times cheaper the other outline has to be before the found one moves. The cost is the inverse edge strength
of an outline's pixels, summed, or in the mean where one is much longer. If both follow an edge they differ by less."""

MIXED = 3
"""Pixels on either side of an outline in which the lens mixes face and background."""


def edge_strength(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W). How fast the colours of a picture (H, W, 3) change, per pixel."""
    steps = [ndimage.gaussian_gradient_magnitude(rgb[..., c], 1.5) for c in range(3)]
    return np.asarray(np.sqrt(np.square(steps).sum(0)))


def edge_cost(strength: NDArray[np.float32]) -> NDArray[np.float64]:
    """(H, W). What a pixel of an outline costs: the less, the stronger its edge (Caselles et al. 1997)."""
    return np.asarray(1 / (strength + 0.005), np.float64)  # one 8-bit step a pixel is no edge


def rims_apart(
    part: NDArray[np.bool_], ours: NDArray[np.bool_], theirs: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(H, W), (H, W). The pixels of each of two faces' outlines along a part (H, W) that only one of the faces has,
    without those near both outlines."""
    rims = [inside & ~ndimage.binary_erosion(inside, border_value=1) for inside in (ours, theirs)]
    apart = ndimage.binary_dilation(part) & ~ndimage.binary_dilation(rims[0] & rims[1], iterations=MIXED)
    return rims[0] & apart, rims[1] & apart


@njit(cache=True, nogil=True)
def cheapest_path(costs: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,). The row in each column of the cheapest way across costs (R, N), at most one row up or down per column."""
    rows, columns = costs.shape
    total = costs[:, 0].copy()
    before = np.empty((columns, rows), np.int64)
    for column in range(1, columns):
        so_far = total.copy()
        for row in range(rows):
            best = row
            for other in (row - 1, row + 1):
                if 0 <= other < rows and so_far[other] < so_far[best]:
                    best = other
            before[column, row] = best
            total[row] = so_far[best] + costs[row, column]
    path = np.empty(columns, np.int64)
    path[-1] = total.argmin()
    for column in range(columns - 1, 0, -1):
        path[column - 1] = before[column, path[column]]
    return path
