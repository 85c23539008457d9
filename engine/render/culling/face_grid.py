"""Plan of the grid that samples the field of the interior atoms on a cut plane: whether to make one, where, how fine.

The graphics card has such a grid as a texture, the software path as an array; both follow this plan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.chunks import atoms_at_plane
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.polygon import section_of_box
from engine.render.culling.store import Spheres
from engine.scene.plane import frame

__all__ = ["GridPlan", "plan_grid"]

Double = NDArray[np.float64]

CELLS_PER_SIGMA = 2.5
"""Grid points per standard deviation; with 4, a grid takes 2.5 times as long to make for 3 dB more."""

WIDEST = 12.0
"""Largest ratio of standard deviations on one grid: six of an atom's are then at most 180 cells, 255 diagonally."""

MOST_CELLS = 1 << 22
"""Largest grid (64 MB); a face that needs more is drawn pixel by pixel."""


@dataclass(frozen=True)
class GridPlan:
    """Cells in a plane, and the atoms that are summed on them."""

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


def plan_grid(plane: Double, spheres: Spheres, options: DrawOptions) -> GridPlan | None:
    """The grid of a plane (4,) in centred object space; None if the atoms' sizes do not allow one."""
    rows, reach = _atoms_at(plane, spheres, options)
    if not len(rows):
        return None
    widest, least = float(reach[rows].max()) / 3, float(reach[rows].min()) / 3
    axes = frame(plane[:3])
    polygon = section_of_box(plane, spheres.low - 3 * widest, spheres.high + 3 * widest)
    if widest > WIDEST * least or not len(polygon):
        return None
    flat = polygon @ axes[:2].T
    cell = least / CELLS_PER_SIGMA
    # An atom at a corner may have its foot outside the box's section.
    low = flat.min(0) - 3 * widest
    width, height = np.ceil((flat.max(0) + 3 * widest - low) / cell).astype(int).tolist()
    if width * height > MOST_CELLS:
        return None
    return GridPlan(rows, axes, low, cell, width, height)


def _atoms_at(plane: Double, spheres: Spheres, options: DrawOptions) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Rows of the atoms that a plane (4,) in centred object space meets, and the reach of all atoms (N,)."""
    chunks, enlarge = spheres.chunks, options.ball_scale
    distances, chunk_reach = chunks.distances(plane[:3], plane[3]), 3 * chunks.sigma * enlarge
    met = (distances[:, 0] <= chunk_reach) & (distances[:, 1] >= -chunk_reach)
    count = -(-chunks.count[met] // 2**options.level)
    reach = (spheres.reach * enlarge).astype(np.float32)
    return atoms_at_plane(spheres.means, reach, chunks.first[met], count, plane[None].astype(np.float32), 0), reach
