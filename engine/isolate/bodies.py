"""Tells apart the separate bodies of a capture: three fruits on a table, once the table is left out.

A body is a connected cluster with an inside. Leaves, strings and specks have none: they stay with the nearest body.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.scene.gaussians import Gaussians
from engine.solid.denoise_capture import HAZE_OPACITY, WALL_OPACITY, grid_around, haze_and_fragments
from engine.solid.find_body import find_body
from engine.solid.opacity_field import opacity_field

__all__ = ["Bodies", "find_bodies"]

Vec3 = tuple[float, float, float]

CELLS = 160
"""Cells along the longest side of the grid on which bodies are told apart. Bodies closer than two cells, a thumb's
width on a table of a metre, count as touching: a finer grid would find gaps in thin skins."""

WIDEN = 0.75
"""Cells. Least sigma in the opacity field: a skin is then a wall two cells thick, without gaps between its cells."""

LEAST_SHARE = 0.01
"""Least share of all Gaussians in a cluster: a cherry between two apples has 3 %, debris less."""

LEAST_SIDE = 6
"""Least number of cells along a cluster's longest side: enough for an inside that a solid can be made from."""

BODY_CELLS = 32
"""Cells along the longest side of the grid on which a body's inside is sought: as coarse as LEAST_INRADIUS allows, at
0.2 s each."""

LEAST_INRADIUS = 0.045
"""Least inradius of a body, relative to the longest side of the box around it. A banana has 0.08, a pizza's box 0.07, a
ball 0.5; a mat as thick as its Gaussians 0.02."""


@dataclass(frozen=True)
class Bodies:
    """The bodies of N Gaussians, those with the most Gaussians first."""

    labels: NDArray[np.intp]
    """(N,). Which body each Gaussian belongs to. Range [0, B), all 0 if there are fewer than two bodies."""
    points: tuple[Vec3, ...]
    """B centres of Gaussians in the middle of each body, world units; empty if there are fewer than two bodies."""


def find_bodies(gaussians: Gaussians) -> Bodies:
    """The separate bodies of a capture. Every Gaussian belongs to one; fewer than two bodies are not told apart.

    Bodies that touch count as one. The same Gaussians in the same order give the same bodies, whatever their units.
    """
    gaussians = replace(gaussians, sh=gaussians.sh[:, :1])  # colours play no part, and copies of them take gigabytes
    alone = Bodies(np.zeros(len(gaussians), np.intp), ())
    haze, fragments = haze_and_fragments(gaussians)
    rows = np.flatnonzero(~haze & ~fragments & (gaussians.opacities >= HAZE_OPACITY))
    clusters = _clusters(gaussians[rows], LEAST_SHARE * len(gaussians))
    if len(clusters) < 2:
        return alone
    bodies = [rows[cluster] for cluster in clusters if _has_inside(gaussians[rows[cluster]])]
    if len(bodies) < 2:
        return alone
    labels = np.full(len(gaussians), -1, np.intp)
    for number, body in enumerate(bodies):
        labels[body] = number
    finite = np.isfinite(gaussians.means).all(1)
    tree = cKDTree(gaussians.means[np.concatenate(bodies)])
    owner = np.repeat(np.arange(len(bodies)), [len(body) for body in bodies])
    rest = np.flatnonzero((labels < 0) & finite)
    labels[rest] = owner[tree.query(gaussians.means[rest])[1]]
    labels[labels < 0] = 0  # not finite: no body is nearest, and nothing shows them
    return Bodies(labels, tuple(_middle(gaussians.means[body]) for body in bodies))


def _clusters(gaussians: Gaussians, least: float) -> list[NDArray[np.intp]]:
    """The rows of each connected cluster of at least `least` Gaussians, the largest first."""
    grid = grid_around(gaussians, CELLS) if len(gaussians) else None
    if grid is None:
        return []
    wall = opacity_field(gaussians, grid, WIDEN * grid.cell) >= WALL_OPACITY
    regions, count = ndimage.label(wall, np.ones((3, 3, 3)))
    cells = np.clip(np.round(grid.index(gaussians.means)).astype(int), 0, np.array(grid.shape) - 1)
    cluster = regions[tuple(cells.T)]
    sizes = np.bincount(cluster, minlength=count + 1)
    sides = [max(s.stop - s.start for s in box) for box in ndimage.find_objects(regions)]
    large = [n for n in range(1, count + 1) if sizes[n] >= least and sides[n - 1] >= LEAST_SIDE]
    return [np.flatnonzero(cluster == n) for n in sorted(large, key=lambda n: (-sizes[n], n))]


def _has_inside(gaussians: Gaussians) -> bool:
    """Whether a cluster encloses a solid."""
    try:
        body = find_body(gaussians, BODY_CELLS).body
    except InputError:
        return False
    low, high = gaussians.visible_bounds()
    return body.inradius >= LEAST_INRADIUS * float((high - low).max())


def _middle(means: NDArray[np.float32]) -> Vec3:
    """The centre nearest to the median of the centres (N, 3)."""
    x, y, z = means[((means - np.median(means, axis=0)) ** 2).sum(1).argmin()]
    return float(x), float(y), float(z)
