"""Which of many things are laid, so that none lies too close to another, and which of them lie near a point."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["LATTICE", "Lattice", "lattice_side", "lay"]

LATTICE = 1.3
"""Half a side of the lattice in which things are looked up, in radii: the body and a thing's reach."""


SMALLEST = 0.03
"""Least edge in radii of the cells in which what reaches a point is looked up: 87 along a side, which take 5 MB."""


class Lattice(NamedTuple):
    """Things by the cells of a lattice."""

    cell: float
    """Edge of a cell, in radii."""
    starts: NDArray[np.int64]
    """(C + 1,). Where the things of each cell start in `members`."""
    members: NDArray[np.int64]
    """(M,). Rows of the things, cell after cell."""

    @classmethod
    def of(cls, middles: NDArray[np.float32], cell: float) -> Lattice:
        """Of things around middles (B, 3), by the cells in which these are. No thing reaches farther than `cell`."""
        side = lattice_side(cell)
        at = np.clip(((middles + LATTICE) / np.float32(cell)).astype(np.int64), 0, side - 1)
        return cls._sorted(cell, (at[:, 0] * side + at[:, 1]) * side + at[:, 2], np.arange(len(middles)))

    @classmethod
    def reaching(cls, middles: NDArray[np.float32], reach: NDArray[np.float32]) -> Lattice:
        """Of things around middles (B, 3), at least one, by all cells that they may reach (B,): what reaches a point is
        among the things of its cell."""
        cell = max(float(reach.max()), SMALLEST)
        side, around = lattice_side(cell), 1.0001 * reach[:, None]  # rounding must not lose what ends at a cell's side
        low, high = (((middles + far + LATTICE) / cell).astype(np.int64) for far in (-around, around))
        steps = np.stack(np.meshgrid(*3 * [np.arange((high - low).max() + 1)], indexing="ij"), -1).reshape(-1, 3)
        at = low[:, None] + steps
        things, step = np.nonzero(((at <= high[:, None]) & (at >= 0) & (at < side)).all(-1))
        x, y, z = at[things, step].T
        return cls._sorted(cell, (x * side + y) * side + z, things)

    @classmethod
    def _sorted(cls, cell: float, number: NDArray[np.int64], things: NDArray[np.intp]) -> Lattice:
        """Of things (M,) in cells of this `number` (M,)."""
        order = np.argsort(number, kind="stable")
        return cls(cell, np.searchsorted(number[order], np.arange(lattice_side(cell) ** 3 + 1)), things[order])


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
