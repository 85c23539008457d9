"""Kernels that choose a label for every cell of a grid so that seams run where the labels' colours agree."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans

__all__ = ["improve_labels", "labels_near", "nearest_colour", "two_nearest"]

NO_SEAM = np.float32(0.01)
"""Cost of a seam between equal colours, so that no label is changed for nothing."""

_HALF = np.float32(0.5)
_F1 = np.float32(1)


def improve_labels(
    labels: NDArray[np.int32],  # [M], changed in place
    number: NDArray[np.int32],  # [X, Y, Z] row of each cell, -1 outside
    cells: NDArray[np.int32],  # [M, 3]
    colours: NDArray[np.float32],  # [M, K, 3] of every label at every cell
    costs: NDArray[np.float32],  # [M, K], infinite where a label is out of the question
    weight: float,
    sweeps: int,
) -> None:
    """Sweeps of iterated conditional modes (Besag 1986).

    The seam between two neighbours costs the difference of their labels' colours at both (Kwatra et al. 2003).
    Neighbours are the six beside a cell and the eight at its corners: with six alone, seams follow the grid.
    Cells are updated an eighth at a time, those of one parity: no two of them are neighbours, so any number of threads
    gives the same labels. A cell is looked at again only after a neighbour has changed: in the finest grid of a quilt
    one cell in fifteen changes in the first sweep, and one in sixty in the second. The colours of a label are read only
    at cells where it is in question, and beside them.
    """
    stale = np.ones(len(cells), np.bool_)
    for _ in range(sweeps):
        for parity in range(8):
            args = labels, stale, number, cells, colours, costs, np.float32(weight), parity
            for_spans(_improve_labels, len(cells), *args)


@njit(cache=True, nogil=True)
def _improve_labels(
    start: int,
    stop: int,
    labels: NDArray[np.int32],  # [M], changed in place
    stale: NDArray[np.bool_],  # [M], whether a neighbour has changed since; changed in place
    number: NDArray[np.int32],  # [X, Y, Z]
    cells: NDArray[np.int32],  # [M, 3]
    colours: NDArray[np.float32],  # [M, K, 3]
    costs: NDArray[np.float32],  # [M, K]
    strength: np.float32,
    parity: int,
) -> None:
    near, share = np.empty(14, np.int64), np.empty(14, np.float32)
    for m in range(start, stop):
        i, j, k = cells[m, 0], cells[m, 1], cells[m, 2]
        if not stale[m] or (i & 1) + 2 * (j & 1) + 4 * (k & 1) != parity:
            continue
        stale[m] = False
        found = 0
        for d in range(14):
            if d < 6:
                step = 1 if d & 1 else -1
                x, y, z = i, j, k
                if d < 2:
                    x += step
                elif d < 4:
                    y += step
                else:
                    z += step
            else:
                x = i + (1 if d & 1 else -1)
                y = j + (1 if (d - 6) >> 1 & 1 else -1)
                z = k + (1 if (d - 6) >> 2 & 1 else -1)
            if min(x, y, z) < 0 or x >= number.shape[0] or y >= number.shape[1] or z >= number.shape[2]:
                continue
            if number[x, y, z] >= 0:
                near[found], share[found] = number[x, y, z], _F1 if d < 6 else _HALF
                found += 1
        # An energy only grows with each neighbour, so most labels are out of the question after few of them.
        best, least = labels[m], np.float32(np.inf)
        for n in range(-1, colours.shape[1]):
            a = labels[m] if n < 0 else n
            if n == labels[m]:
                continue
            energy = costs[m, a]
            for d in range(found):
                if energy > least:
                    break
                if a != labels[near[d]]:
                    energy += share[d] * strength * _seam(colours, m, near[d], a, labels[near[d]])
            if energy < least or (energy == least and a < best):
                best, least = a, energy
        if best != labels[m]:
            labels[m] = best
            for d in range(found):
                stale[near[d]] = True


@njit(cache=True, nogil=True, inline="always")
def _seam(colours, m, n, a, b):  # type: ignore[no-untyped-def]
    """Cost of a seam between labels a and b at the neighbours m and n."""
    here, there = np.float32(0), np.float32(0)
    for c in range(3):
        u = colours[m, a, c] - colours[m, b, c]
        v = colours[n, a, c] - colours[n, b, c]
        here += u * u
        there += v * v
    return np.sqrt(here) + np.sqrt(there) + NO_SEAM


def labels_near(
    labels: NDArray[np.int32],  # [M]
    number: NDArray[np.int32],  # [X, Y, Z] row of each cell, -1 outside
    cells: NDArray[np.int32],  # [M, 3]
    count: int,
    reach: int,
) -> NDArray[np.bool_]:
    """(M, count). Which labels are among those of each cell and of all within `reach` cells along each axis."""
    out = np.zeros((len(cells), count), np.bool_)
    for_spans(_labels_near, len(cells), labels, number, cells, reach, out)
    return out


@njit(cache=True, nogil=True)
def _labels_near(
    start: int,
    stop: int,
    labels: NDArray[np.int32],  # [M]
    number: NDArray[np.int32],  # [X, Y, Z]
    cells: NDArray[np.int32],  # [M, 3]
    reach: int,
    out: NDArray[np.bool_],  # [M, K]
) -> None:
    for m in range(start, stop):
        i, j, k = cells[m, 0], cells[m, 1], cells[m, 2]
        for x in range(max(i - reach, 0), min(i + reach + 1, number.shape[0])):
            for y in range(max(j - reach, 0), min(j + reach + 1, number.shape[1])):
                for z in range(max(k - reach, 0), min(k + reach + 1, number.shape[2])):
                    if number[x, y, z] >= 0:
                        out[m, labels[number[x, y, z]]] = True


def nearest_colour(
    colours: NDArray[np.float32],  # [M, 3]
    x: NDArray[np.float32],  # [M] first pixel index
    y: NDArray[np.float32],  # [M] second pixel index
    mirrored: NDArray[np.float32],  # [M] first pixel index on the other side of the axis
    picture: NDArray[np.float32],  # [W, H, 3]
    step: float,
) -> NDArray[np.float32]:
    """(M,). Smallest squared distance of each colour to those of a picture on 5x5 points, `step` pixels apart, around
    a place and around its mirror image."""
    out = np.empty(len(colours), np.float32)
    for_spans(_nearest_colour, len(out), colours, x, y, mirrored, picture, step, out)
    return out


@njit(cache=True, nogil=True)
def _nearest_colour(
    start: int,
    stop: int,
    colours: NDArray[np.float32],  # [M, 3]
    x: NDArray[np.float32],  # [M]
    y: NDArray[np.float32],  # [M]
    mirrored: NDArray[np.float32],  # [M]
    picture: NDArray[np.float32],  # [W, H, 3]
    step: float,
    out: NDArray[np.float32],  # [M]
) -> None:
    width, height = picture.shape[0], picture.shape[1]
    for m in range(start, stop):
        best = np.float32(9)
        for side in range(2):
            middle = x[m] if side == 0 else mirrored[m]
            for i in range(-2, 3):
                for j in range(-2, 3):
                    u = min(max(int(middle + i * step), 0), width - 1)
                    v = min(max(int(y[m] + j * step), 0), height - 1)
                    gap = np.float32(0)
                    for c in range(3):
                        d = picture[u, v, c] - colours[m, c]
                        gap += d * d
                    best = min(best, gap)
        out[m] = best


def two_nearest(
    labels: NDArray[np.int32],  # [M]
    number: NDArray[np.int32],  # [X, Y, Z] row of each cell, -1 outside
    at: NDArray[np.float32],  # [P, 3] in cells, cell centres at whole numbers
    count: int,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """(P, 2) twice. The two of `count` labels with the largest trilinear weights at each point, and these weights; 0
    where no cell is near."""
    best, shares = np.empty((len(at), 2), np.int32), np.empty((len(at), 2), np.float32)
    for_spans(_two_nearest, len(at), labels, number, at, count, best, shares)
    return best, shares


@njit(cache=True, nogil=True)
def _two_nearest(
    start: int,
    stop: int,
    labels: NDArray[np.int32],  # [M]
    number: NDArray[np.int32],  # [X, Y, Z]
    at: NDArray[np.float32],  # [P, 3]
    count: int,
    out: NDArray[np.int32],  # [P, 2]
    shares: NDArray[np.float32],  # [P, 2]
) -> None:
    weights = np.empty(count, np.float32)
    for p in range(start, stop):
        weights[:] = 0
        i, j, k = int(np.floor(at[p, 0])), int(np.floor(at[p, 1])), int(np.floor(at[p, 2]))
        a, b, c = at[p, 0] - np.float32(i), at[p, 1] - np.float32(j), at[p, 2] - np.float32(k)
        for d in range(8):
            x, y, z = i + (d & 1), j + (d >> 1 & 1), k + (d >> 2)
            if 0 <= x < number.shape[0] and 0 <= y < number.shape[1] and 0 <= z < number.shape[2]:
                row = number[x, y, z]
                if row >= 0:
                    weight = a if d & 1 else _F1 - a
                    weight *= b if d >> 1 & 1 else _F1 - b
                    weight *= c if d >> 2 else _F1 - c
                    weights[labels[row]] += weight
        for n in range(2):
            best = 0
            for label in range(1, count):
                if weights[label] > weights[best]:
                    best = label
            out[p, n], shares[p, n] = best, max(weights[best], np.float32(0))
            weights[best] = -1
