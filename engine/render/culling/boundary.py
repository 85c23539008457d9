"""The boundary layer of the interior: the atoms that can be seen once the skin is removed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import FILLED, MOST_CELLS, dilated

__all__ = ["boundary_atoms"]

Float = NDArray[np.float32]

CELL = 2.0
"""Edge of an occupancy cell in lattice constants of the atoms (2 sigma). The layer is at least one cell thick, so that
atoms lie behind one another and gaps between the outer ones show no background."""


def boundary_atoms(means: Float, sigmas: Float) -> NDArray[np.bool_]:
    """(N,). Whether an atom with centre (N, 3) is in a cell next to an empty one; all, if the grid gets too large."""
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
    for axis in range(3):  # smooths how many lattice points happen to fall into a cell
        solid = (np.roll(solid, 1, axis) + 2 * solid + np.roll(solid, -1, axis)) / 4
    near_empty: NDArray[np.bool_] = dilated(solid < FILLED)[tuple(cells.T)]
    return near_empty
