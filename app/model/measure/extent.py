"""Volume and surface area of pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from app.model.pieces import Cell
from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms
from engine.scene.constants import SOLID_DENSITY
from engine.scene.grid import Grid

__all__ = ["Extent", "Filled", "extent_of"]

Float = NDArray[np.float32]

CELLS = 96
"""Cells along the longest side of the grid: a ball's volume is right to 1 % and its surface area to 3 %."""

BLUR = 1.5
"""Standard deviation, in cells, of the blur that turns filled cells into a smooth share: it removes their steps, which
would count as surface, and leaves only bumps of the skin that are wider than three cells."""


@dataclass(frozen=True)
class Extent:
    """How large a piece is."""

    volume: float
    """World units cubed."""
    skin: float
    """Area of its part of the object's skin, world units squared."""
    faces: float
    """Area of its cut faces, world units squared."""

    @property
    def surface(self) -> float:
        """Area of skin and cut faces together, world units squared."""
        return self.skin + self.faces


@dataclass(frozen=True)
class Filled:
    """The space that atoms fill, on a grid."""

    cell: float
    """Side of a grid cell, world units."""
    centres: Float
    """(N, 3). Centres of the grid cells in or near filled space."""
    share: Float
    """(N,). The filled share of each cell, blurred. Range [0, 1]."""
    slope: Float
    """(N,). How fast the share changes, per world unit."""

    @staticmethod
    def of(atoms: Atoms) -> Filled:
        """By the rule that cut faces follow: space is filled where the density is high enough."""
        bounds = atoms.bounds.astype(np.float64)
        cell = max(float(np.ptp(bounds, axis=0).max()), atoms.pitch) / CELLS
        grid = Grid.around(bounds, cell, round(4 * BLUR))
        centres = grid.centres()
        density = KernelField(atoms).at(centres.reshape(-1, 3))[1].reshape(grid.shape)
        share = ndimage.gaussian_filter((density >= SOLID_DENSITY).astype(np.float32), BLUR)
        slope = np.sqrt(sum(part**2 for part in np.gradient(share, cell)))
        some = (share > 1e-4) | (slope > 1e-4 / cell)
        return Filled(cell, centres[some], share[some], slope[some].astype(np.float32))


def extent_of(filled: Filled, cell: Cell) -> Extent:
    """Volume and areas of the filled space in a cell of a piece.

    The volume is the sum of the shares, times a smooth step across every plane. For an area, a slope takes the place of
    the share or step: a share that rises from 0 to 1 across a surface has a slope that adds up to 1 along each line
    across it. Walls have no area: the piece continues behind them.
    """
    steps = [filled.share, *(_step(-plane.distance(filled.centres), filled.cell) for plane in cell.planes)]
    slopes = [filled.slope, *(_slope(plane.distance(filled.centres), filled.cell) for plane in cell.faces)]
    areas = []
    for k, slope in enumerate(slopes):
        others = [step for i, step in enumerate(steps) if i != k]
        areas.append(_sum([slope, *others]) * filled.cell**3)
    return Extent(_sum(steps) * filled.cell**3, areas[0], sum(areas[1:]))


def _sum(factors: Sequence[Float]) -> float:
    """The sum of the element-wise products."""
    product = factors[0].astype(np.float64)
    for factor in factors[1:]:
        product *= factor
    return float(product.sum())


def _step(distance: Float, cell: float) -> Float:
    """A smooth step: 0 from one cell outside a plane, 1 from one cell inside."""
    part = np.clip(distance / cell, -1, 1)
    return np.asarray(0.5 * (1 + part + np.sin(np.pi * part) / np.pi), np.float32)


def _slope(distance: Float, cell: float) -> Float:
    """The derivative of `_step`, per world unit."""
    part = np.clip(distance / cell, -1, 1)
    return np.asarray(0.5 * (1 + np.cos(np.pi * part)) / cell, np.float32)
