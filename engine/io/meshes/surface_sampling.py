"""Points spread evenly over a triangle soup (blue noise)."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["scatter"]

CANDIDATES = 5
"""Candidates per point; more would shrink the gaps by less than a tenth."""

START = 0.95
"""First minimum distance between points, in spacings sqrt(area / count). At most 0.83 fits at random (random sequential
packing fills 0.547 of the plane), so hardly any point is lost by starting here."""

SHRINK = 0.93
"""Factor on that distance after each pass, until there are enough points."""

LEAST = 1e-3
"""Share of the first distance below which the remaining points coincide and are accepted anyway."""

REBUILD = 2.0
"""Ratio of cell to distance at which the grid is rebuilt with smaller cells; fuller cells would cost more."""

MULTIPLIER = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio, odd: multiplying by it spreads neighbours over the high bits (Knuth 6.4)."""

SAME_SIDE = -0.5
"""Cosine between normals above which points keep their distance: around the edge of a box, not through a leaf."""


def scatter(
    triangles: NDArray[np.float64],  # [F, 3, 3]
    count: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Triangle (count,) and barycentric coordinates (count, 3) of points that cover the area evenly.

    Stratified candidates are thinned greedily: a point must keep its distance from all before it on the same side of
    the surface (the two sides of a leaf are independent), and the distance shrinks until `count` are accepted.
    The total area must be above 0.
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled = np.linalg.norm(normals, axis=1)  # twice the area
    normals /= np.maximum(doubled, np.finfo(np.float64).tiny)[:, None]
    many = CANDIDATES * count
    total = np.cumsum(doubled)
    draws = (np.arange(many) + rng.random(many)) / many * total[-1]
    face = np.minimum(np.searchsorted(total, draws, side="right"), len(total) - 1)
    face = rng.permutation(face)
    # The square root keeps the density even over the triangle (Turk 1990).
    root, along = np.sqrt(rng.random(many)), rng.random(many)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    points = np.einsum("nk,nkc->nc", weights, triangles[face])
    spacing = float(np.sqrt(total[-1] / 2 / count))
    chosen = _thin(points - points.min(0), normals[face], count, START * spacing)
    return face[chosen], weights[chosen]


@njit(cache=True, fastmath=False)
def _thin(points: NDArray[np.float64], normals: NDArray[np.float64], count: int, distance: float) -> NDArray[np.int64]:
    """Indices (count,) of points (N, 3), N >= count, that keep the greatest distance, first come, first served.

    Accepted points are found through the cells of a hash grid. The cells shrink with the distance, so few points share
    one even if many faces coincide: at most three points nearby have normals that differ enough to be exempt.
    """
    n = len(points)
    least = LEAST * distance
    cell = distance
    buckets = 1
    while buckets < 2 * count:
        buckets *= 2
    heads = np.full(buckets, -1, np.int64)  # cells hash into buckets; a bucket is a linked list of points
    following = np.full(n, -1, np.int64)
    left = np.arange(n)  # those not yet accepted, in order
    chosen = np.empty(count, np.int64)
    found = 0
    while found < count:
        last_pass = distance < least  # the remaining candidates coincide
        if cell > REBUILD * distance and not last_pass:
            cell = distance
            heads[:] = -1
            for k in range(found):
                _enter(int(chosen[k]), points, cell, heads, following)
        waiting = 0
        for k in range(len(left)):
            i = int(left[k])
            if not last_pass and not _is_free(i, points, normals, distance, cell, heads, following):
                left[waiting] = i
                waiting += 1
                continue
            chosen[found] = i
            found += 1
            if found == count:
                break
            if not last_pass:
                _enter(i, points, cell, heads, following)
        left = left[:waiting]
        distance *= SHRINK
    return chosen


@njit(cache=True, fastmath=False)
def _is_free(
    i: int,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    distance: float,
    cell: float,
    heads: NDArray[np.int64],
    following: NDArray[np.int64],
) -> bool:
    """Whether a point keeps the distance (at most a cell) from all accepted points on its side."""
    x, y, z = np.floor(points[i, 0] / cell), np.floor(points[i, 1] / cell), np.floor(points[i, 2] / cell)
    for offset in range(27):
        turned = (offset + 13) % 27  # the point's cell first, where most are rejected
        j = heads[_bucket(x + turned // 9 - 1, y + turned // 3 % 3 - 1, z + turned % 3 - 1, len(heads))]
        while j >= 0:
            gap = 0.0
            facing = 0.0
            for k in range(3):
                gap += (points[i, k] - points[j, k]) ** 2
                facing += normals[i, k] * normals[j, k]
            if gap < distance * distance and facing > SAME_SIDE:
                return False
            j = following[j]
    return True


@njit(cache=True, fastmath=False)
def _enter(
    i: int, points: NDArray[np.float64], cell: float, heads: NDArray[np.int64], following: NDArray[np.int64]
) -> None:
    """Puts a point into the list of its cell."""
    x, y, z = np.floor(points[i, 0] / cell), np.floor(points[i, 1] / cell), np.floor(points[i, 2] / cell)
    home = _bucket(x, y, z, len(heads))
    following[i] = heads[home]
    heads[home] = i


@njit(cache=True, fastmath=False)
def _bucket(x: float, y: float, z: float, buckets: int) -> int:
    """Hash of a cell; buckets is a power of two.

    Hashes the bits of floats, not integers: on a needle the cell index may exceed any integer type.
    """
    mixed = np.uint64(0)
    for value in (x, y, z):
        bits = np.float64(value + 0.0).view(np.uint64)  # + 0.0 turns -0.0 into 0.0
        mixed = (mixed ^ bits) * np.uint64(MULTIPLIER)
        mixed ^= mixed >> np.uint64(32)
    return int(np.int64(mixed & np.uint64(buckets - 1)))
