"""Which interior atoms can be seen once the skin is taken off: a layer of them along whatever is empty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import FILLED, MOST_CELLS, spread

__all__ = ["outermost"]

Float = NDArray[np.float32]

CELL = 2.0
"""Cells of the occupancy grid, in lattice constants of the atoms (2 sigma). The layer is a cell thick at least, so that
atoms lie behind each other and no gap of the outer ones shows what is beyond."""


def outermost(means: Float, sigmas: Float) -> NDArray[np.bool_]:
    """(N,). Atoms with centres (N, 3) in a cell that touches an empty one; all, if they are strewn too wide to tell."""
    if not len(means):
        return np.zeros(0, bool)
    cell = float(2 * CELL * np.median(sigmas))
    low = means.min(0) - 3 * cell
    cells = np.floor((means - low) / cell).astype(np.int64)
    shape = cells.max(0) + 4
    if shape.prod() > MOST_CELLS:
        return np.ones(len(means), bool)
    solid = np.zeros(shape, np.float32)
    np.add.at(solid, tuple(cells.T), (2 * sigmas / cell) ** 3)
    for axis in range(3):  # evens out how many lattice points happen to fall into a cell
        solid = (np.roll(solid, 1, axis) + 2 * solid + np.roll(solid, -1, axis)) / 4
    near_empty: NDArray[np.bool_] = spread(solid < FILLED)[tuple(cells.T)]
    return near_empty
