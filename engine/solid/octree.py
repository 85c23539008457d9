"""An octree of interior atoms: coarse leaves where the colours are even, fine ones at seeds, rinds and borders.

The colours are given on a lattice as fine as the smallest atoms. A block of 2^l cells along its edge becomes one atom
if atoms of that size reproduce its colours within a tolerance; the tolerance grows until the atoms fit into a budget.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import side_by_side

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

NEIGHBOURHOOD = np.ones((3, 3, 3), bool)


def leaf_levels(rgb: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.int8]:
    """(X, Y, Z). Level of the leaf that holds each cell, 0 for a cell that is a leaf by itself.

    rgb: (X, Y, Z, 3), colours at the cell centres, also those just outside the solid. solid: (X, Y, Z), cells that hold
    matter; only blocks of such cells are merged. X, Y, Z are multiples of 2^COARSEST. The levels of neighbouring leaves
    differ by at most one. There are at most BUDGET leaves per solid cell unless MAX_TOLERANCE needs more.
    """
    assert rgb.shape[:3] == solid.shape and not any(n % 2**COARSEST for n in solid.shape), (rgb.shape, solid.shape)

    def error_of(size: int) -> NDArray[np.float32]:
        return np.where(blocks(solid, size).min(axis=(1, 3, 5)), approximation_error(rgb, size), np.float32(np.inf))

    errors = side_by_side(error_of, leaf_sizes())
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
    error = np.zeros(tuple(n // size for n in rgb.shape[:3]), np.float32)
    variance = np.zeros_like(error)
    for channel in np.moveaxis(rgb, -1, 0):
        means = blocks(channel, size).mean(axis=(1, 3, 5))
        lattice = ndimage.zoom(means, size, order=1, mode="nearest", grid_mode=True)
        error += blocks((lattice - channel) ** 2, size).mean(axis=(1, 3, 5)) / rgb.shape[-1]
        variance += blocks(np.square(channel), size).mean(axis=(1, 3, 5)) / rgb.shape[-1]
        variance -= np.square(means) / rgb.shape[-1]
    contrast = np.sqrt(ndimage.maximum_filter(np.maximum(variance, 0), 3) + CONTRAST_FLOOR**2)
    return error * (CONTRAST / contrast)


def merged_blocks(errors: list[NDArray[np.float32]], tolerance: float) -> list[NDArray[np.bool_]]:
    """For each level above the finest, the blocks that are one leaf or lie within a larger one."""
    result: list[NDArray[np.bool_]] = []
    for error in errors:
        good = error <= tolerance**2
        if result:  # all eight parts and their neighbours are merged, so neighbouring leaves differ by one level
            good &= blocks(ndimage.binary_erosion(result[-1], NEIGHBOURHOOD, border_value=1), 2).min(axis=(1, 3, 5))
        result.append(good)
    return result


def atom_count(merges: list[NDArray[np.bool_]], cells: int) -> int:
    """Number of atoms that `cells` cells become: each merge turns eight into one."""
    return cells - 7 * sum(int(np.count_nonzero(blocks)) for blocks in merges)
