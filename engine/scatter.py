"""Points spread evenly over a triangle soup: no clumps, no gaps."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["scatter"]

CANDIDATES = 5
"""Candidates per point that is wanted; with more the gaps shrink by less than a tenth."""

START = 0.95
"""First distance that points keep, in spacings sqrt(area / count). No more than 0.83 fits at random (Renyi's packing in
the plane fills 0.547), so hardly a point is lost by starting here."""

SHRINK = 0.93
"""Factor on that distance after each pass, until enough points have found a place."""

SAME_SIDE = -0.5
"""Cosine between normals above which points keep their distance: across the edge of a box, not across a leaf."""


def scatter(
    triangles: NDArray[np.float64],  # [F, 3, 3]
    count: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Triangle (count,) and barycentric coordinates (count, 3) of points that cover the area evenly.

    Stratified candidates are thinned greedily: a point must keep its distance from all before it on the same side of
    the surface (the two faces of a leaf do not thin each other), and the distance shrinks until `count` have a place.
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
    """Indices (count,) of points (N, 3) that keep as far from each other as they can, first come, first served.

    N >= count. Coordinates are not negative, so that cells are small integers whatever the mesh's place.
    """
    n = len(points)
    cell = distance
    buckets = 1
    while buckets < 2 * count:
        buckets *= 2
    heads = np.full(buckets, -1, np.int64)  # cells hash into buckets; a bucket is a linked list of points
    following = np.full(n, -1, np.int64)
    taken = np.zeros(n, np.bool_)
    chosen = np.empty(count, np.int64)
    found = 0
    while found < count:
        last_pass = distance < 1e-3 * cell  # all candidates coincide, so nothing is left to keep apart
        for i in range(n):
            if taken[i]:
                continue
            x = int(np.floor(points[i, 0] / cell))
            y = int(np.floor(points[i, 1] / cell))
            z = int(np.floor(points[i, 2] / cell))
            free = True
            for offset in range(27):
                if last_pass or not free:
                    break
                a, b, c = x + offset // 9 - 1, y + offset // 3 % 3 - 1, z + offset % 3 - 1
                j = heads[_bucket(a, b, c, buckets)]
                while j >= 0:
                    gap = 0.0
                    facing = 0.0
                    for k in range(3):
                        gap += (points[i, k] - points[j, k]) ** 2
                        facing += normals[i, k] * normals[j, k]
                    if gap < distance * distance and facing > SAME_SIDE:
                        free = False
                        break
                    j = following[j]
            if free:
                taken[i] = True
                chosen[found] = i
                found += 1
                if found == count:
                    break
                home = _bucket(x, y, z, buckets)
                following[i] = heads[home]
                heads[home] = i
        distance *= SHRINK
    return chosen


@njit(cache=True, fastmath=False)
def _bucket(x: int, y: int, z: int, buckets: int) -> int:
    """Hash of a cell; buckets is a power of two."""
    return ((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (buckets - 1)
