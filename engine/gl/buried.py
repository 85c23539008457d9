"""Which interior atoms can be seen once the skin is taken off: those with no neighbour towards one side or another."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["outermost"]

Float = NDArray[np.float32]

NEAR = 1.8
"""Distance of a neighbour, in lattice constants of the atom (2 sigma): the next one with all the jitter of a fill."""

MOST_CELLS = 1 << 25
"""Cells of the search grid; atoms strewn wider than that all count as seen."""


def outermost(means: Float, sigmas: Float) -> NDArray[np.bool_]:
    """(N,). Atoms with centres (N, 3) that lack a neighbour along +x, -x, +y, -y, +z or -z."""
    if not len(means):
        return np.zeros(0, bool)
    cell = float(2 * NEAR * np.median(sigmas))
    low = means.min(0)
    cells = np.floor((means - low) / cell).astype(np.int64)
    shape = cells.max(0) + 1
    if shape.prod() > MOST_CELLS:
        return np.ones(len(means), bool)
    flat = (cells[:, 0] * shape[1] + cells[:, 1]) * shape[2] + cells[:, 2]
    order = np.argsort(flat, kind="stable")
    first = np.searchsorted(flat[order], np.arange(shape.prod() + 1))
    return exposed_sides(means, sigmas, cells, shape, order, first, np.float32(cell))


@njit(cache=True)
def exposed_sides(means, sigmas, cells, shape, order, first, cell):  # type: ignore[no-untyped-def]
    """The search: a neighbour covers a side if it lies within 60 degrees of it."""
    seen = np.empty(len(means), np.bool_)
    for i in range(len(means)):
        reach = np.float32(2 * NEAR) * sigmas[i]
        span = min(int(np.ceil(reach / cell)), 4)
        covered = 0
        for a in range(max(cells[i, 0] - span, 0), min(cells[i, 0] + span + 1, shape[0])):
            for b in range(max(cells[i, 1] - span, 0), min(cells[i, 1] + span + 1, shape[1])):
                for c in range(max(cells[i, 2] - span, 0), min(cells[i, 2] + span + 1, shape[2])):
                    at = (a * shape[1] + b) * shape[2] + c
                    for k in range(first[at], first[at + 1]):
                        x = means[order[k], 0] - means[i, 0]
                        y = means[order[k], 1] - means[i, 1]
                        z = means[order[k], 2] - means[i, 2]
                        square = x * x + y * y + z * z
                        if square > reach * reach or square == 0:
                            continue
                        half = np.float32(0.5) * np.sqrt(square)
                        covered |= (x > half) | (x < -half) << 1
                        covered |= (y > half) << 2 | (y < -half) << 3
                        covered |= (z > half) << 4 | (z < -half) << 5
            if covered == 63:
                break
        seen[i] = covered != 63
    return seen
