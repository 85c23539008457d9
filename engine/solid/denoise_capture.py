"""Removes from a capture what cannot be part of a skin: haze, background, and floaters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.gather import gathered
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Grid
from engine.solid.opacity_field import opacity_field

__all__ = ["HAZE_OPACITY", "WALL_OPACITY", "grid_around", "haze_and_fragments", "without_haze"]

WALL_OPACITY = 0.2
"""The paper's sigma_th: d on a sheet is the sum of the alphas that a ray meets there, and from here on it loses 18 %
(1 - exp(-0.2)). Captures have skins as thin as that, seen against what lies behind them."""

HAZE_SIZE = 0.05
"""Share of the longest side. A Gaussian longer than this is haze if it is also fainter than HAZE_OPACITY."""
HAZE_OPACITY = 0.1

HUGE = 0.25
"""Share of the longest side. A Gaussian longer than this is background, whatever its opacity."""

OUTLIER = 1.0
"""Share of the longest span between the 5th and 95th percentiles of the centres: no stem reaches farther out."""

FLOATER = 0.003
"""Share of all Gaussians. A separate cluster with fewer is a floater, which must not widen the grid."""

COARSE = 64
"""Cells along the longest side of the grid that separates clusters."""

MOST_SUMMED = 250_000
"""Gaussians above which a capture is gathered before clusters are sought: some ten for each cell of the skin."""

MARGIN = 4
"""Cells around the outermost centres: room for the wall, and a way around it for the flood."""


def grid_around(gaussians: Gaussians, cells: int) -> Grid | None:
    """The grid around the centres with `cells` cells along their longest side; None if they all coincide."""
    bounds = np.stack([gaussians.means.min(0), gaussians.means.max(0)]).astype(np.float64)
    cell = float((bounds[1] - bounds[0]).max()) / cells
    return Grid.around(bounds, cell, MARGIN) if cell > 0 else None


def without_haze(gaussians: Gaussians) -> tuple[Gaussians, list[str]]:
    """The Gaussians that may be part of a skin, and a sentence on each kind that was left out."""
    visible = _visible(gaussians)
    if not visible.all():
        gaussians = gaussians[visible]
    haze, fragments = haze_and_fragments(gaussians)
    notes = []
    if haze.any():
        notes.append(f"{int(haze.sum())} large faint Gaussians (haze) were left out")
    if fragments.any():
        notes.append(f"{int(fragments.sum())} Gaussians apart from the object were left out")
    return gaussians[~haze & ~fragments] if notes else gaussians, notes


def haze_and_fragments(gaussians: Gaussians) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which Gaussians (N,) are background or too large and faint for a skin, and which (N,) lie apart from the object.

    No Gaussian is both. Those that are invisible, or not finite, are haze.
    """
    haze, fragments = np.ones(len(gaussians), bool), np.zeros(len(gaussians), bool)
    gaussians = replace(gaussians, sh=gaussians.sh[:, :1])  # the rest takes most of the memory, for nothing
    rows = np.flatnonzero(_visible(gaussians))
    if not len(rows):
        return haze, fragments
    seen = gaussians[rows]
    low, high = np.percentile(seen.means, [5, 95], axis=0)
    side = float((high - low).max())
    near = ((seen.means >= low - OUTLIER * side) & (seen.means <= high + OUTLIER * side)).all(1)
    longest = seen.scales.max(1)
    large = (longest > HUGE * side) | ((longest > HAZE_SIZE * side) & (seen.opacities < HAZE_OPACITY))
    haze[rows] = near & large
    fragments[rows[~near]] = True
    shell = rows[near & ~large]
    fragments[shell] = _floaters(gaussians[shell])
    return haze, fragments


def _visible(gaussians: Gaussians) -> NDArray[np.bool_]:
    """(N,). Which Gaussians are drawn at all."""
    finite = np.isfinite(gaussians.means).all(1) & np.isfinite(gaussians.scales).all(1)
    return np.asarray(finite & (gaussians.opacities > 0))


def _floaters(gaussians: Gaussians) -> NDArray[np.bool_]:
    """(N,). Whether each Gaussian lies in a cluster too small to be part of the object."""
    grid = grid_around(gaussians, COARSE) if len(gaussians) else None
    if grid is None:
        return np.zeros(len(gaussians), bool)
    field = opacity_field(gathered(gaussians, MOST_SUMMED), grid, grid.cell)
    regions, count = ndimage.label(field >= WALL_OPACITY)
    cells = np.clip(np.round(grid.index(gaussians.means)).astype(int), 0, np.array(grid.shape) - 1)
    cluster = regions[tuple(cells.T)]
    sizes = np.bincount(cluster, minlength=count + 1)
    sizes[0] = 0
    return sizes[cluster] < min(FLOATER * len(gaussians), sizes.max())
