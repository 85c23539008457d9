"""What an object's shape says about which way is up: where it is flat, how it is symmetric, how it rests.

Each kind of evidence is a density over directions of up, relative to the uniform one: 1 says nothing, 10 makes a
direction ten times as likely. A ball gives 1 everywhere, without being a special case.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.spatial import ConvexHull, cKDTree

from engine.scene.camera import spread_directions

__all__ = ["DIRECTIONS", "flat_base", "near_directions", "resting_pose", "symmetry", "touching"]

Points = NDArray[np.float64]
Density = NDArray[np.float64]

_UPPER = spread_directions(2000, 0.5)[:1000]
DIRECTIONS = np.concatenate([_UPPER, -_UPPER])
"""(D, 3). Unit vectors 4.5 degrees apart, about as finely as the up axis of a capture can be told: those of the upper
half of the sphere, then their opposites."""

BLUR = math.radians(5)
"""Angle over which densities are blurred: the distance of neighbouring directions."""

GIVE = 0.02
"""How much the centre of mass may rise from its lowest place, as a share of its greatest height: the skin of a capture
is as uneven as that."""

CONTACT = 1.5
"""Thickness of what touches the ground, in spacings of the points: one for the raster, half for its rounding."""

FLAT = 0.05
"""Share of the skin within CONTACT of the ground at which the evidence for a base is half of its most. A ball has 0.04,
a pot on its foot 0.05, the face of a box over 0.1."""

FLAT_STEP = 0.12
"""Difference on that scale of 0 to 1 that makes a direction e times as likely."""

MIRROR_CELLS = 32
"""Cells along the object's longest side in which it is compared with its mirror image."""

MIRROR_POINTS = 1500
"""Points that are reflected: the share that falls on the object is then known to 1 %."""

MIRROR_STEP = 0.05
"""Difference in the share of the skin that falls on itself that makes a mirror plane e times as likely: the gaps of a
capture differ that much between two sides."""

RING = math.radians(4)
"""How far from vertical a mirror plane counts as vertical: enough for a ring without gaps."""


def near_directions(axis: NDArray[np.float64], spread: float) -> Density:
    """(D,). A bell around a unit vector (3,), of `spread` radians."""
    bell = np.exp((DIRECTIONS @ axis - 1) / spread**2)
    return bell / bell.mean()


def resting_pose(points: Points) -> Density:
    """(D,). How likely a thing dropped at random is to come to rest with each direction up.

    A solid on a plane rolls until its centre of mass is as low as it gets nearby. So the height of the centre over
    the plane, as a function of the direction, divides all directions into basins; a basin's share is the likelihood of
    the pose at its bottom (Goldberg et al., Part pose statistics, 1999). `points` (N, 3) are its skin.
    """
    hull = ConvexHull(points, qhull_options="QJ")  # QJ takes even coplanar points
    corners = points[hull.vertices] - _centre_of_mass(points, hull.simplices)
    height = -(corners @ DIRECTIONS.T).min(axis=0)
    neighbours = cKDTree(DIRECTIONS).query(DIRECTIONS, k=9)[1]  # itself and eight around it
    bottom = neighbours[np.arange(len(DIRECTIONS)), height[neighbours].argmin(axis=1)]
    while (bottom[bottom] != bottom).any():
        bottom = bottom[bottom]
    weight = np.exp(-(height - height[bottom]) / (GIVE * height.max()))
    share = np.bincount(bottom, minlength=len(DIRECTIONS))
    total = np.bincount(bottom, weight, minlength=len(DIRECTIONS))
    blur = np.exp((DIRECTIONS @ DIRECTIONS.T - 1) / BLUR**2)
    return blur @ (weight * share[bottom] / total[bottom]) / blur.sum(axis=1)


def _centre_of_mass(points: Points, triangles: NDArray[np.integer]) -> Points:
    """(3,). Centre of mass of the convex hull, filled evenly."""
    middle = points.mean(axis=0)
    a, b, c = (points[triangles[:, corner]] - middle for corner in range(3))
    volume = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    return middle + volume @ (a + b + c) / 4 / max(float(volume.sum()), 1e-300)  # a thin rod has no volume


def flat_base(points: Points, spacing: float) -> Density:
    """(D,). The more of the skin touches the ground, the likelier. `points` (N, 3) are the skin, `spacing` apart."""
    share = touching(points, DIRECTIONS.T, spacing).mean(axis=0)
    density = np.exp(share / (share + FLAT) / FLAT_STEP)
    return density / density.mean()


def touching(points: Points, up: Points, spacing: float) -> NDArray[np.bool_]:
    """(N,) or (N, K). Whether points (N, 3) touch the ground if `up` (3,), or each column of `up` (3, K), is up."""
    heights = points @ up
    near: NDArray[np.bool_] = heights < heights.min(axis=0) + CONTACT * spacing
    return near


def symmetry(points: Points) -> Density:
    """(D,). The more planes through the axis mirror the skin, `points` (N, 3), onto itself, the likelier.

    A pot has mirror planes all around its axis, a loaf two, a person one, and all stand so that these are vertical.
    """
    local = points - points.mean(axis=0)
    radius = float(np.abs(local).max()) * 1.001
    cell = 2 * radius / MIRROR_CELLS
    filled = np.zeros((MIRROR_CELLS, MIRROR_CELLS, MIRROR_CELLS), bool)
    filled[tuple(((local + radius) / cell).astype(np.int64).T)] = True
    filled = binary_dilation(filled)
    few = local[np.linspace(0, len(local) - 1, min(len(local), MIRROR_POINTS)).astype(np.int64)]
    normals = DIRECTIONS[: len(DIRECTIONS) // 2]
    same = np.empty(len(normals))
    for row, normal in enumerate(normals):
        mirrored = few - 2 * (few @ normal)[:, None] * normal
        cells = np.floor((mirrored + radius) / cell).astype(np.int64)
        inside = ((cells >= 0) & (cells < MIRROR_CELLS)).all(axis=1)
        same[row] = filled[tuple(cells[inside].T)].sum() / len(few)
    mirrors = np.exp((same - same.max()) / MIRROR_STEP)
    upright = np.exp(-0.5 * ((DIRECTIONS @ normals.T) / RING) ** 2)
    # Squared: with one mirror plane the axis may lie anywhere in it, but with two it is where they cross.
    density = (upright @ mirrors / upright.sum(axis=1)) ** 2
    return density / density.mean()
