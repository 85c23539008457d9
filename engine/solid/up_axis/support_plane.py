"""Finds the table, mat or ground that an object stands on, as evidence of which way is up.

`engine.isolate.floor` finds it in order to cut it off: it looks at Gaussians, by their area and opacity, and not at
points spread evenly over the skin, asks for a free edge around the object's foot and not for an overhang, and puts the
plane on top of the floor and not through its middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from engine.scene.plane import Plane, frame

__all__ = ["support_plane"]

Points = NDArray[np.float64]

POINTS = 4000
"""Points that hypotheses are tested on: a plane with 10 % then has 400 of them, which gives its share to 5 %."""

HYPOTHESES = 1500
"""Number of planes through three random points: five of them lie on a support with 15 % of the points."""

FINALISTS = 8
"""Hypotheses that are fitted: neighbouring ones lead to the same plane."""

HALF_THICKNESS = 1 / 64
"""Half the thickness of the plane's slab, as a share of the object's longest side: a photographed table is about as
uneven as that."""

BELOW = 0.25
"""Most surface behind a plane, as a share of that on it: haze below a table, not the other half of a box."""

OVERHANG = 1 / 3
"""Share of a support that must reach beyond what stands on it. The base of a box or a pot has none; a mat that is 1.5
times as wide as the object has half."""

CURVED = 1.2
"""Ratio of the surface in twice the slab to that in the slab from which it is no plane: the cap of a bowl has 1.4 to 2,
tables and mats with things on them at most 1.08."""

FOOTPRINT_CELLS = 24
"""Cells along the longest side in which support and footprint are compared."""


def support_plane(means: NDArray[np.floating], weights: NDArray[np.floating]) -> Plane | None:
    """The plane below the object, its normal towards the object; None if there is none.

    `means` (N, 3) in world units, `weights` (N,), not negative: how much surface each stands for. The support is the
    plane with the most surface on it that has everything else on one side and reaches beyond what stands on it; a flat
    face of the object itself does not. `distance` of the result is the height above the support. Equal input gives
    equal planes.
    """
    rows = np.flatnonzero(weights > 0)
    if len(rows) < 100:
        return None
    points, area = means[rows].astype(np.float64), weights[rows].astype(np.float64)
    area /= area.sum()
    few = np.linspace(0, len(points) - 1, min(POINTS, len(points))).astype(np.int64)
    half = HALF_THICKNESS * float(np.ptp(points, axis=0).max())
    if not half > 0:
        return None
    found = [
        _fitted(points[few], area[few], normal, offset, half)
        for normal, offset in _hypotheses(points[few], area[few], half)
    ]
    best: Plane | None = None
    most = 0.0
    for plane in found:
        height = plane.distance(points)
        on, below = area[np.abs(height) < half].sum(), area[height <= -half].sum()
        flat = area[np.abs(height) < 2 * half].sum() < CURVED * on
        if flat and below < BELOW * on and on - below > most and _overhang(points, plane, half) > OVERHANG:
            best, most = plane, float(on - below)
    return best


def _hypotheses(points: Points, weights: NDArray[np.float64], half: float) -> list[tuple[Points, float]]:
    """Normal and offset of the most promising planes through three points, most promising first."""
    rng = np.random.default_rng(0)
    a, b, c = points[rng.integers(0, len(points), (3, HYPOTHESES))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    wide = lengths > (8 * half) ** 2  # a smaller triangle does not fix a normal
    a, normals = a[wide], normals[wide] / lengths[wide, None]
    offsets = -np.einsum("ij,ij->i", normals, a)
    heights = points @ normals.T + offsets
    on = weights @ (np.abs(heights) < half)
    above, below = weights @ (heights >= half), weights @ (heights <= -half)
    signs = np.where(above < below, -1.0, 1.0)
    below = np.minimum(above, below)
    score = np.where(below < BELOW * on, on - below, 0.0)
    best = np.argsort(-score, kind="stable")[:FINALISTS]
    return [(signs[i] * normals[i], float(signs[i] * offsets[i])) for i in best if score[i] > 0]


def _fitted(points: Points, weights: NDArray[np.float64], normal: Points, offset: float, half: float) -> Plane:
    """The plane fitted to the points in its slab by least squares, several times over."""
    for _ in range(4):
        near = np.abs(points @ normal + offset) < half
        if near.sum() < 3:
            break
        middle = np.average(points[near], axis=0, weights=weights[near])
        spread = np.sqrt(weights[near])[:, None] * (points[near] - middle)
        fitted = np.linalg.eigh(spread.T @ spread)[1][:, 0]
        normal = fitted if fitted @ normal >= 0 else -fitted
        offset = -float(normal @ middle)
    return Plane.of(normal, offset)


def _overhang(points: Points, plane: Plane, half: float) -> float:
    """Share of the plane's area that is not below anything standing on it. Range [0, 1]."""
    e1, e2, _ = frame(plane.normal)
    flat = np.stack([points @ e1, points @ e2], 1)
    flat -= flat.min(axis=0)
    cells = (flat / (max(float(flat.max()), 1e-12) / FOOTPRINT_CELLS)).astype(np.int64)
    height = plane.distance(points)
    support, footprint = np.zeros((2, FOOTPRINT_CELLS + 1, FOOTPRINT_CELLS + 1), bool)
    support[tuple(cells[np.abs(height) < half].T)] = True
    footprint[tuple(cells[height > 2 * half].T)] = True
    alone = support & ~binary_dilation(footprint, np.ones((3, 3)))
    return float(alone.sum() / max(support.sum(), 1))
