"""Finds which way is up: captures differ, and few files say. The user can overrule it.

Every piece of evidence is a density over directions (`evidence.py`). Each is trusted only so far, so it enters as a
mixture with the uniform density, and the mixtures are multiplied: what several weak reasons agree on outweighs a single
strong one, and no reason can forbid what all others say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from engine.scene.gaussians import Gaussians
from engine.solid.up_axis.evidence import DIRECTIONS, flat_base, near_directions, resting_pose, symmetry, touching
from engine.solid.up_axis.support_plane import support_plane

__all__ = ["UpAxis", "detect_up"]

Points = NDArray[np.float64]

MIN_OPACITY = 0.1
"""Opacity below which a Gaussian is no evidence of the object's shape."""

MOST = 200_000
"""Most Gaussians that are looked at, evenly chosen from all: some ten for each cell of the skin."""

CELLS = 48
"""Cells along the longest side in which the skin is gathered, so that it counts by its area, not by how finely a part
of it was captured. A pot's foot is still ten cells wide."""

COVERED = 0.15
"""Part of a cell's side that Gaussians must cover for the cell to be skin rather than haze."""

COMPANIONS = 4
"""Cells of skin, itself included, that there must be around a cell; others are floaters."""

FEWEST = 100
"""Cells below which there is no shape to speak of."""

TRUST = {"support": 0.9, "base": 0.8, "symmetry": 0.8, "rest": 0.05}
"""How often each kind of evidence is right about the things that people capture. A table is nearly always below; most
things have a foot and stand upright on it; how a thing would fall says little, as a plant, a guitar and a person are
captured standing."""

REASONS = {
    "support": "away from what it stands on",
    "base": "on its flat base",
    "symmetry": "along its symmetry",
    "rest": "as it comes to rest",
    "file": "as files of this kind have it",
}

CLEAR = 1.0
"""Gain in log-likelihood from which a piece of evidence is named as a reason."""

SUPPORT_SPREAD = math.radians(5)
"""How far the normal of a support may be from vertical: tables are level, and a mat is found to 2 degrees."""

FILE_SPREAD = math.radians(15)
"""How far a capture may be tilted in the axes of its file: the first camera was held level by hand."""

NEAR = math.radians(12)
"""Angle within which directions count as the same answer: two or three steps of DIRECTIONS."""

PRECISION = {"support": math.radians(2), "base": math.radians(4), "symmetry": math.radians(8)}
"""How exactly each finds the axis. A coordinate axis of the file within that angle is taken instead: whoever levelled
the scene knew better."""


@dataclass(frozen=True)
class UpAxis:
    """The up axis of an object, and why it is believed to be that."""

    axis: NDArray[np.float64]
    """(3,). Unit vector."""
    reason: str
    """The axis and the reason for it, in words for the user."""
    certainty: float
    """Probability that it is right, as far as the evidence goes. Range [0, 1]."""


def detect_up(gaussians: Gaussians, file_axes: Mapping[tuple[int, int, int], float]) -> UpAxis:
    """The up axis that the shape and the kind of file make most likely. Equal input gives equal results.

    `file_axes`: share of the files of this kind in which each axis is up, as in `LoadedScene.file_axes`.
    """
    file = (
        1.0
        - sum(file_axes.values())
        + sum(part * near_directions(np.asarray(axis, np.float64), FILE_SPREAD) for axis, part in file_axes.items())
    )
    gains = {"file": np.log(file * np.ones(len(DIRECTIONS)))}
    points, spacing = _skin(gaussians)
    support = None
    if len(points) >= FEWEST:
        support = support_plane(points, np.ones(len(points)))
        densities = {}
        if support is not None:
            densities["support"] = near_directions(np.asarray(support.normal), SUPPORT_SPREAD)
            standing = points[support.distance(points) > spacing]
            points = standing if len(standing) >= FEWEST else points
        densities |= {
            "base": flat_base(points, spacing),
            "symmetry": symmetry(points),
            "rest": resting_pose(points),
        }
        gains |= {kind: np.log(1 - TRUST[kind] + TRUST[kind] * density) for kind, density in densities.items()}
    total = np.sum(list(gains.values()), axis=0)
    best = int(total.argmax())
    posterior = np.exp(total - total[best])
    near = np.arccos(np.clip(DIRECTIONS @ DIRECTIONS[best], -1, 1)) < NEAR
    clear = sorted((k for k in gains if gains[k][best] >= CLEAR), key=lambda kind: -gains[kind][best])[:2]
    axis, precision = DIRECTIONS[best], PRECISION["symmetry"]
    if len(points) >= FEWEST:
        axis = posterior[near] @ DIRECTIONS[near]
        axis = axis / np.linalg.norm(axis)
    if "support" in clear and support is not None:  # a plane is more exact than a shape
        axis, precision = np.asarray(support.normal), PRECISION["support"]
    elif "base" in clear:
        standing_on = _base_normal(points, axis, spacing)
        if standing_on @ axis > math.cos(NEAR):
            axis, precision = standing_on, PRECISION["base"]
    nearest = np.zeros(3)
    nearest[np.abs(axis).argmax()] = np.sign(axis[np.abs(axis).argmax()])
    if nearest @ axis > math.cos(precision):
        axis = nearest
    words = " and ".join(REASONS[kind] for kind in clear) or "nothing in the scene says otherwise"
    return UpAxis(axis, f"{axis_words(axis)}, {words}", float(posterior[near].sum() / posterior.sum()))


def axis_words(axis: NDArray[np.float64]) -> str:
    """'+z' for an axis of the file, the three numbers for any other unit vector (3,)."""
    largest = int(np.abs(axis).argmax())
    if abs(axis[largest]) > 1 - 1e-6:
        return f"{'+' if axis[largest] > 0 else '-'}{'xyz'[largest]}"
    return "({:.2f}, {:.2f}, {:.2f})".format(*axis)


def _skin(gaussians: Gaussians) -> tuple[Points, float]:
    """Points (N, 3) on what is opaque, one for each cell of a grid, and the side of its cells in world units."""
    rows = np.unique(np.linspace(0, len(gaussians) - 1, min(MOST, len(gaussians))).astype(np.int64))
    part = len(rows) / max(len(gaussians), 1)
    rows = rows[gaussians.opacities[rows] >= MIN_OPACITY]
    means = gaussians.means[rows].astype(np.float64)
    if len(rows) < FEWEST:
        return means[:0], 1.0
    low, high = np.percentile(means, [1, 99], axis=0)
    middle, half = (low + high) / 2, 0.6 * float((high - low).max())
    inside = (np.abs(means - middle) < half).all(axis=1)
    rows, means = rows[inside], means[inside]
    side = 2 * half / CELLS
    sizes = np.sort(gaussians.scales[rows].astype(np.float64), axis=1)
    # 2 pi s1 s2 is the area of a Gaussian's kernel; the chosen Gaussians stand for those left out.
    area = np.minimum(2 * math.pi * sizes[:, 1] * sizes[:, 2] * gaussians.opacities[rows] / part, side * side)
    cells = ((means - middle + half) / side).astype(np.int64)
    _, cell = np.unique(cells @ np.array([CELLS * CELLS, CELLS, 1]), return_inverse=True)
    covered = np.bincount(cell, area)
    points = np.stack([np.bincount(cell, area * means[:, k]) for k in range(3)], axis=1) / covered[:, None]
    points = points[covered > COVERED * side * side]
    around = cKDTree(points).query_ball_point(points, 1.8 * side, return_length=True)  # over sqrt(3): next cells
    return points[around >= COMPANIONS], side


def _base_normal(points: Points, axis: Points, spacing: float) -> Points:
    """(3,). The normal, upwards, of the plane through what touches the ground where `axis` (3,) is up."""
    for _ in range(6):
        base = points[touching(points, axis, spacing)]
        if len(base) < 3:
            break
        normal = np.linalg.svd(base - base.mean(axis=0), full_matrices=False)[2][2]
        axis = normal if normal @ axis >= 0 else -normal
    return axis
