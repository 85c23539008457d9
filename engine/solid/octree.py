"""Where an inside needs fine atoms: coarse leaves where its colours are even, fine ones at seeds, rinds and borders.

The colours stand on a lattice as fine as an atom may be. A block of 2^l cells along its edge becomes one atom if atoms
of that size show its colours within a tolerance; the tolerance grows until the atoms fit into a budget.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["COARSEST", "leaf_levels"]

COARSEST = 3
"""Level of the largest leaves, 8 cells along the edge: one more saves less than a hundredth of the atoms."""

TOLERANCE = 0.02
"""RMS of a colour difference, of 1, that is never worth an atom: it takes 0.2 dB off a picture at 21 dB, which is how
near to the truth the insides of the sample solids come."""

CONTRAST = 0.05
"""RMS contrast at which a difference counts as what it is. Where there is more it counts less, in proportion: an edge
loses most of its sharpness to atoms of any size, and pulp beside it would be given up for it. At the same number of
atoms this comes 1.3 dB nearer to the orange's volume, and its patches 10 % nearer to true ones."""

EVEN = 0.02
"""RMS contrast that counts as none."""

WORST = 0.08
"""RMS that no budget may exceed: a pale seed in its flesh."""

SHARE = 1 / 3
"""Of the uniform fill's atoms: the budget."""

HALVINGS = 10
"""Of the span of tolerances in the search: to 1e-4 of colour."""

CORNERS = np.ones((3, 3, 3), bool)


def leaf_levels(rgb: NDArray[np.float32], solid: NDArray[np.bool_]) -> NDArray[np.int8]:
    """(X, Y, Z). For each cell the level of the leaf that holds it, 0 where it is one by itself.

    rgb: (X, Y, Z, 3), colours at the cell centres, also those just outside of the solid. solid: (X, Y, Z), cells that
    hold matter; only blocks of such cells are merged. Sides are multiples of 2^COARSEST. A leaf has neighbours of its
    own level or of the next ones. At most SHARE of the solid cells are leaves unless even WORST asks for more.
    """
    assert rgb.shape[:3] == solid.shape and not any(n % 2**COARSEST for n in solid.shape), (rgb.shape, solid.shape)
    errors = [np.where(blocks(solid, s).min(axis=(1, 3, 5)), missed(rgb, s), np.inf) for s in sizes()]
    cells = int(np.count_nonzero(solid))
    low, high = TOLERANCE, WORST
    if leaves(merged(errors, low), cells) > SHARE * cells:
        if leaves(merged(errors, high), cells) < SHARE * cells:
            for _ in range(HALVINGS):
                middle = (low + high) / 2
                if leaves(merged(errors, middle), cells) > SHARE * cells:
                    low = middle
                else:
                    high = middle
        low = high
    levels = np.zeros(solid.shape, np.int8)
    for level, (size, whole) in enumerate(zip(sizes(), merged(errors, low), strict=True), 1):
        levels[spread(whole, size)] = level
    return levels


def sizes() -> list[int]:
    """Cells along the edge of a leaf of each level above the finest."""
    return [2**level for level in range(1, COARSEST + 1)]


def blocks(values: NDArray[np.generic], size: int) -> NDArray[np.generic]:
    """(X / size, size, Y / size, size, Z / size, size, ...). A grid seen as blocks of cells."""
    x, y, z = (n // size for n in values.shape[:3])
    return values.reshape(x, size, y, size, z, size, *values.shape[3:])


def spread(values: NDArray[np.bool_], size: int) -> NDArray[np.bool_]:
    """Each entry `size` times along every axis."""
    for axis in range(3):
        values = np.repeat(values, size, axis)
    return values


def missed(rgb: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """(X / size, ...). Mean square of what a lattice of atoms of this size, each of its block's colour, cannot show,
    where the contrast in a block or beside it is CONTRAST; in inverse proportion to that elsewhere."""
    error = np.zeros(tuple(n // size for n in rgb.shape[:3]), np.float32)
    variance = np.zeros_like(error)
    for channel in np.moveaxis(rgb, -1, 0):
        means = blocks(channel, size).mean(axis=(1, 3, 5))
        shown = ndimage.zoom(means, size, order=1, mode="nearest", grid_mode=True)
        error += blocks((shown - channel) ** 2, size).mean(axis=(1, 3, 5)) / rgb.shape[-1]
        variance += blocks(np.square(channel), size).mean(axis=(1, 3, 5)) / rgb.shape[-1]
        variance -= np.square(means) / rgb.shape[-1]
    contrast = np.sqrt(ndimage.maximum_filter(np.maximum(variance, 0), 3) + EVEN**2)
    return error * (CONTRAST / contrast)


def merged(errors: list[NDArray[np.float32]], tolerance: float) -> list[NDArray[np.bool_]]:
    """For each level above the finest the blocks that are one leaf, or within a larger one."""
    result: list[NDArray[np.bool_]] = []
    for error in errors:
        good = error <= tolerance**2
        if result:  # of blocks that are leaves themselves, among such: sizes change by one level at a time
            good &= blocks(ndimage.binary_erosion(result[-1], CORNERS, border_value=1), 2).min(axis=(1, 3, 5))
        result.append(good)
    return result


def leaves(merges: list[NDArray[np.bool_]], cells: int) -> int:
    """How many atoms remain of so many cells: each merge makes one of eight."""
    return cells - 7 * sum(int(np.count_nonzero(whole)) for whole in merges)
