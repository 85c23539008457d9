"""An octree of interior atoms: coarse leaves where the colours are even, fine ones at seeds, rinds and borders.

The colours are given on a lattice as fine as the smallest atoms. A block of 2^l cells along its edge becomes one atom
if atoms of that size reproduce its colours within a tolerance; the tolerance grows until the atoms fit into a budget.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import widened
from engine.threads import for_each

__all__ = ["COARSEST", "leaf_levels"]

COARSEST = 3
"""Level of the largest leaves, 8 cells along the edge. One level more saves less than 1 % of the atoms."""

MIN_TOLERANCE = 0.02
"""RMS colour error, range [0, 1], that is never worth an atom: it costs a picture at 21 dB, which is how close the
interiors of the sample solids come to the truth, 0.2 dB."""

CONTRAST = 0.05
"""RMS contrast at which an error has weight 1. Higher contrast lowers the weight in proportion: an edge loses most of
its sharpness to atoms of any size, and would otherwise take the atoms of the pulp beside it. At the same number of
atoms the orange's volume comes 1.3 dB closer, and its patches 10 % closer, to the true ones."""

CONTRAST_FLOOR = 0.02
"""RMS contrast below which a block counts as even."""

MAX_TOLERANCE = 0.08
"""RMS error that no budget may force: a pale seed in its flesh would vanish."""

BUDGET = 1 / 3
"""Share of the uniform fill's atoms that the octree may use."""

HALVINGS = 10
"""Halvings of the tolerance interval in the search: down to 1e-4 of colour."""


def leaf_levels(rgb: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.int8]:
    """(X, Y, Z). Level of the leaf that holds each cell, 0 for a cell that is a leaf by itself.

    rgb: (X, Y, Z, 3), colours at the cell centres, also those just outside the solid. solid: (X, Y, Z), cells that hold
    matter; only blocks of such cells are merged. X, Y, Z are multiples of 2^COARSEST. The levels of neighbouring leaves
    differ by at most one. There are at most BUDGET leaves per solid cell unless MAX_TOLERANCE needs more.
    """
    assert rgb.shape[:3] == solid.shape and not any(n % 2**COARSEST for n in solid.shape), (rgb.shape, solid.shape)

    def error_of(size: int) -> NDArray[np.float32]:
        return np.where(blocks(solid, size).min(axis=(1, 3, 5)), approximation_error(rgb, size), np.float32(np.inf))

    errors = [error_of(size) for size in leaf_sizes()]
    cells = int(np.count_nonzero(solid))
    low, high = MIN_TOLERANCE, MAX_TOLERANCE
    if atom_count(merged_blocks(errors, low), cells) > BUDGET * cells:
        if atom_count(merged_blocks(errors, high), cells) < BUDGET * cells:
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                if atom_count(merged_blocks(errors, middle), cells) > BUDGET * cells:
                    low = middle
                else:
                    high = middle
        low = high
    levels = np.zeros(solid.shape, np.int8)
    for level, (size, blocks_merged) in enumerate(zip(leaf_sizes(), merged_blocks(errors, low), strict=True), 1):
        levels[upsample(blocks_merged, size)] = level
    return levels


def leaf_sizes() -> list[int]:
    """Cells along the edge of a leaf of each level above the finest."""
    return [2**level for level in range(1, COARSEST + 1)]


def blocks(values: NDArray[np.generic], size: int) -> NDArray[np.generic]:
    """(X / size, size, Y / size, size, Z / size, size, ...). A view of a grid as blocks of cells."""
    x, y, z = (n // size for n in values.shape[:3])
    return values.reshape(x, size, y, size, z, size, *values.shape[3:])


def upsample(values: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """Each entry repeated `size` times along every axis."""
    for axis in range(3):
        values = np.repeat(values, size, axis)
    return values


def approximation_error(rgb: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(X / size, ...). Mean squared error of a lattice of atoms of this size, each of its block's mean colour, times
    CONTRAST over the contrast in the block and its neighbours."""
    x, y, z = (n // size for n in rgb.shape[:3])
    means, variance = np.empty((x, y, z, 3)), np.empty((x, y, z))
    for_each(_summarise, x, rgb, size, means, variance)
    error = np.empty((x, y, z))
    for_each(_compare, x, rgb, size, means, error)
    contrast = np.sqrt(ndimage.maximum_filter(np.maximum(variance, 0), 3) + CONTRAST_FLOOR**2)
    return (error * (CONTRAST / contrast)).astype(np.float32)


@njit(cache=True, nogil=True)
def _summarise(
    i: int,
    rgb: NDArray[np.float32],  # [X, Y, Z, 3]
    size: int,
    means: NDArray[np.float64],  # out [X / size, Y / size, Z / size, 3]
    variance: NDArray[np.float64],  # out [X / size, Y / size, Z / size]
) -> None:
    """The mean and the variance, over cells and channels, of each block in a layer of blocks."""
    for j in range(means.shape[1]):
        for k in range(means.shape[2]):
            square, square_of_means = 0.0, 0.0
            for c in range(3):  # for a whole row numba would also compile an error message, which takes seconds
                means[i, j, k, c] = 0
            for x in range(i * size, (i + 1) * size):
                for y in range(j * size, (j + 1) * size):
                    for z in range(k * size, (k + 1) * size):
                        for c in range(3):
                            value = np.float64(rgb[x, y, z, c])
                            means[i, j, k, c] += value
                            square += value * value
            for c in range(3):
                means[i, j, k, c] /= size**3
                square_of_means += means[i, j, k, c] * means[i, j, k, c]
            variance[i, j, k] = (square / size**3 - square_of_means) / 3


@njit(cache=True, nogil=True)
def _compare(
    i: int,
    rgb: NDArray[np.float32],  # [X, Y, Z, 3]
    size: int,
    means: NDArray[np.float64],  # [X / size, Y / size, Z / size, 3]
    error: NDArray[np.float64],  # out [X / size, Y / size, Z / size]
) -> None:
    """The mean squared difference, in each block of a layer, between the colours and the blocks' means, trilinear
    between the middles of blocks."""
    corners, weights = np.empty((size**3, 8), np.int64), np.empty((size**3, 8))
    for n in range(size**3):
        for d in range(8):
            corners[n, d], weights[n, d] = 0, 1.0
            for axis, step in enumerate((n // size**2, n // size % size, n % size)):
                place = (step + 0.5) / size + 0.5
                below = int(place)
                along, above = place - below, d >> axis & 1
                corners[n, d] = 3 * corners[n, d] + below + above
                weights[n, d] *= along if above else 1 - along
    near, last = np.empty((27, 3)), np.array(means.shape[:3]) - 1
    for j in range(means.shape[1]):
        for k in range(means.shape[2]):
            m = 0
            for x in range(i - 1, i + 2):
                for y in range(j - 1, j + 2):
                    for z in range(k - 1, k + 2):
                        mean = means[min(max(x, 0), last[0]), min(max(y, 0), last[1]), min(max(z, 0), last[2])]
                        near[m, 0], near[m, 1], near[m, 2] = mean[0], mean[1], mean[2]
                        m += 1
            total, n = 0.0, 0
            for x in range(i * size, (i + 1) * size):
                for y in range(j * size, (j + 1) * size):
                    for z in range(k * size, (k + 1) * size):
                        red, green, blue = 0.0, 0.0, 0.0
                        for d in range(8):
                            weight, m = weights[n, d], corners[n, d]
                            red += weight * near[m, 0]
                            green += weight * near[m, 1]
                            blue += weight * near[m, 2]
                        total += (red - rgb[x, y, z, 0]) ** 2
                        total += (green - rgb[x, y, z, 1]) ** 2
                        total += (blue - rgb[x, y, z, 2]) ** 2
                        n += 1
            error[i, j, k] = total / (3 * size**3)


def merged_blocks(errors: list[NDArray[np.float32]], tolerance: float) -> list[NDArray[np.bool_]]:
    """For each level above the finest, the blocks that are one leaf or lie within a larger one."""
    result: list[NDArray[np.bool_]] = []
    for error in errors:
        good = error <= tolerance**2
        if result:  # all eight parts and their neighbours are merged, so neighbouring leaves differ by one level
            good &= blocks(~widened(~result[-1], 1), 2).min(axis=(1, 3, 5))
        result.append(good)
    return result


def atom_count(merges: list[NDArray[np.bool_]], cells: int) -> int:
    """Number of atoms that `cells` cells become: each merge turns eight into one."""
    return cells - 7 * sum(int(np.count_nonzero(blocks)) for blocks in merges)
