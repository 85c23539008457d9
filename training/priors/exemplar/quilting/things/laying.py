"""Which of many things are laid, so that none lies too close to another, and which of them lie near a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["LATTICE", "Lattice", "lattice_side", "lay"]

LATTICE = 1.3
"""Half a side of the lattice in which things are looked up, in radii: the body and a thing's reach."""


class Lattice(NamedTuple):
    """Things by the cells of a lattice in which their middles are."""

    cell: float
    """Edge of a cell, in radii: no thing reaches farther."""
    starts: NDArray[np.int64]
    """(C + 1,). Where the things of each cell start in `members`."""
    members: NDArray[np.int64]
    """(M,). Rows of the things, cell after cell."""

    @classmethod
    def of(cls, middles: NDArray[np.float32], cell: float) -> Lattice:
        """Of things around middles (M, 3)."""
        side = lattice_side(cell)
        at = np.clip(((middles + LATTICE) / np.float32(cell)).astype(np.int64), 0, side - 1)
        number = (at[:, 0] * side + at[:, 1]) * side + at[:, 2]
        members = np.argsort(number, kind="stable")
        return cls(cell, np.searchsorted(number[members], np.arange(side**3 + 1)), members)


@njit(cache=True)
def lattice_side(cell: float) -> int:
    """Cells along a side of the lattice in which things are looked up."""
    return int(2 * LATTICE / cell) + 1


@njit(cache=True)
def lay(
    middles: NDArray[np.float32],  # [M, 3]
    radii: NDArray[np.float32],  # [M]
    near: np.float32,
    cell: float,
    fixed: int,
    most: int,
) -> NDArray[np.bool_]:
    """(M,). Which of the things are laid: the first `fixed` ones, and of the others up to `most`, each of which is at
    least `near` times the sum of both radii away from all before it. `cell` is at least the largest such distance."""
    side = lattice_side(cell)
    first = np.full(side * side * side, -1, np.int64)
    following = np.full(len(radii), -1, np.int64)
    laid = np.zeros(len(radii), np.bool_)
    for b in range(len(radii)):
        x = int((middles[b, 0] + np.float32(LATTICE)) / cell)
        y = int((middles[b, 1] + np.float32(LATTICE)) / cell)
        z = int((middles[b, 2] + np.float32(LATTICE)) / cell)
        free = most > 0
        for i in range(max(x - 1, 0), min(x + 2, side)):
            for j in range(max(y - 1, 0), min(y + 2, side)):
                for k in range(max(z - 1, 0), min(z + 2, side)):
                    other = first[(i * side + j) * side + k]
                    while other >= 0:
                        away = np.float32(0)
                        for c in range(3):
                            d = middles[other, c] - middles[b, c]
                            away += d * d
                        least = near * (radii[other] + radii[b])
                        free = free and away >= least * least
                        other = following[other]
        if free or b < fixed:
            laid[b] = True
            most -= b >= fixed
            here = (x * side + y) * side + z
            following[b] = first[here]
            first[here] = b
    return laid
