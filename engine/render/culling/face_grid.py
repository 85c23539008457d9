"""A grid on a cut plane that holds the field of the interior atoms: whether there is to be one, where, and how fine.

What the graphics card keeps as a texture and the processor as an array follows one plan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.chunks import near_plane
from engine.render.culling.look import Look
from engine.render.culling.polygon import section_of_box
from engine.render.culling.store import Spheres
from engine.scene.plane import frame

__all__ = ["KEPT_BYTES", "GridPlan", "plan_grid"]

Double = NDArray[np.float64]

CELLS_PER_SIGMA = 2.5
"""Grid points to a standard deviation; with 4 a grid takes 2.5 times as long to make for 3 dB more."""

WIDEST = 12.0
"""Largest standard deviation over the smallest on one grid: a point is at most 255 cells wide."""

MOST_CELLS = 1 << 22
"""Cells of a grid; beyond it (64 MB) the face is drawn pixel by pixel."""

KEPT_BYTES = 256 << 20
"""Memory for grids that are not in the frame; what was used longest ago goes first."""


@dataclass(frozen=True)
class GridPlan:
    """Cells in a plane, and the atoms that are added up on them."""

    rows: NDArray[np.uint32]
    """(n,). The atoms that the plane meets."""
    axes: Double
    """(3, 3). Rows: two unit vectors in the plane, and its normal."""
    low: Double
    """(2,). Plane coordinates of the grid's corner."""
    cell: float
    """Edge of a cell, world units."""
    width: int
    height: int


def plan_grid(plane: Double, spheres: Spheres, look: Look) -> GridPlan | None:
    """The grid of a plane (4,) in centred object space; None where the atoms' sizes do not allow one."""
    rows, felt = _met_by(plane, spheres, look)
    if not len(rows):
        return None
    widest, least = float(felt[rows].max()) / 3, float(felt[rows].min()) / 3
    axes = frame(plane[:3])
    polygon = section_of_box(plane, spheres.low - 3 * widest, spheres.high + 3 * widest)
    if widest > WIDEST * least or not len(polygon):
        return None
    flat = polygon @ axes[:2].T
    cell = least / CELLS_PER_SIGMA
    # An atom at a corner may have its foot outside of the box's section.
    low = flat.min(0) - 3 * widest
    width, height = np.ceil((flat.max(0) + 3 * widest - low) / cell).astype(int).tolist()
    if width * height > MOST_CELLS:
        return None
    return GridPlan(rows, axes, low, cell, width, height)


def _met_by(plane: Double, spheres: Spheres, look: Look) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Rows of the atoms that a plane (4,) in centred object space meets, and the reach of all atoms (N,)."""
    chunks, enlarge = spheres.chunks, look.ball_scale
    distances, reach = chunks.distances(plane[:3], plane[3]), 3 * chunks.sigma * enlarge
    met = (distances[:, 0] <= reach) & (distances[:, 1] >= -reach)
    count = -(-chunks.count[met] // 2**look.level)
    felt = (spheres.reach * enlarge).astype(np.float32)
    return near_plane(spheres.means, felt, chunks.first[met], count, plane[None].astype(np.float32), 0), felt
