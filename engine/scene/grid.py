"""The solid on a grid: how deep under the skin a point lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["Body"]


@dataclass(frozen=True)
class Body:
    """A signed distance to the skin, sampled at cell centres."""

    origin: NDArray[np.float64]
    """(3,). World position of the outer corner of cell (0, 0, 0)."""
    cell: float
    """Edge of a cell, world units."""
    depth: NDArray[np.float32]
    """(X, Y, Z). Distance under the skin at cell centres, world units; positive inside."""

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(X, Y, Z). Cells whose centre lies in the solid."""
        return self.depth > 0

    @property
    def volume(self) -> float:
        """World units cubed; cells at the skin count by how much of them the skin cuts off."""
        return float(np.clip(self.depth / self.cell + 0.5, 0, 1).sum(dtype=np.float64)) * self.cell**3

    @property
    def inradius(self) -> float:
        """Depth of the deepest point, world units."""
        return float(self.depth.max())

    @property
    def radius(self) -> float:
        """Distance of the farthest inside point from the middle of the bounds, world units."""
        points = self.centres()[self.inside] - self.bounds().mean(0)
        return float(np.linalg.norm(points, axis=1).max()) + self.cell / 2 if len(points) else self.cell

    def centres(self) -> NDArray[np.float32]:
        """(X, Y, Z, 3). World positions of the cell centres."""
        axes = [self.origin[i] + (np.arange(self.depth.shape[i]) + 0.5) * self.cell for i in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...). Depth at world points (..., 3), trilinear; outside of the grid the nearest cell's."""
        index = (np.moveaxis(np.asarray(points, np.float64), -1, 0) - self.origin[:, *[None] * (points.ndim - 1)]) / (
            self.cell
        ) - 0.5
        return ndimage.map_coordinates(self.depth, index, order=1, mode="nearest", output=np.float32)

    def bounds(self) -> NDArray[np.float64]:
        """(2, 3). Corners of the cells that lie inside; the grid's own where none does."""
        cells = np.argwhere(self.inside)
        low, high = (cells.min(0), cells.max(0) + 1) if len(cells) else (np.zeros(3), np.array(self.depth.shape))
        return self.origin + np.stack([low, high]) * self.cell

    def resampled(self, cell: float) -> Body:
        """The same solid on cells of another size, two cells of margin around it."""
        low, high = self.bounds()
        origin = low - 2 * cell
        shape = np.ceil((high - low) / cell).astype(int) + 4
        empty = Body(origin, cell, np.zeros(tuple(shape), np.float32))
        return Body(origin, cell, self.at(empty.centres()))
