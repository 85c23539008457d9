"""Cubic cells in world space, and the solid as a signed distance on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans, side_by_side

__all__ = ["Body", "Grid", "read_cells", "widened"]


@dataclass(frozen=True)
class Grid:
    """Cubic cells in world space; values on a grid belong to the cell centres."""

    origin: NDArray[np.float64]
    """(3,). World position of the outer corner of cell (0, 0, 0)."""
    cell: float
    """Edge of a cell, world units."""
    shape: tuple[int, int, int]
    """X, Y, Z. Number of cells along each axis."""

    @staticmethod
    def around(bounds: NDArray[np.floating], cell: float, margin: int) -> Grid:
        """The grid centred on bounds (2, 3), with `margin` cells to spare on every side."""
        low, high = bounds
        shape = np.ceil((high - low) / cell).astype(int) + 2 * margin
        x, y, z = shape.tolist()
        return Grid((low + high) / 2 - shape * cell / 2, cell, (x, y, z))

    def index(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(..., 3). Continuous cell coordinates of world points (..., 3); integers at cell centres."""
        return (np.asarray(points, np.float64) - self.origin) / self.cell - 0.5

    def centres(self) -> NDArray[np.float32]:
        """(X, Y, Z, 3). World positions of the cell centres."""
        return np.stack(np.meshgrid(*self._axes(), indexing="ij"), axis=-1, dtype=np.float32, casting="same_kind")

    def layer(self, x: int) -> NDArray[np.float32]:
        """(Y, Z, 3). World positions of the cell centres with this first index."""
        axes = self._axes()
        flat = np.meshgrid(axes[0][x : x + 1], *axes[1:], indexing="ij")
        return np.stack(flat, axis=-1, dtype=np.float32, casting="same_kind")[0]

    def centres_of(self, cells: NDArray[np.bool_]) -> NDArray[np.float32]:
        """(N, 3). World positions of the centres of some cells (X, Y, Z), in the grid's order."""
        return (self.origin + (np.argwhere(cells) + 0.5) * self.cell).astype(np.float32)

    def _axes(self) -> list[NDArray[np.float64]]:
        """World coordinates of the cell centres along each axis."""
        return [self.origin[i] + (np.arange(self.shape[i]) + 0.5) * self.cell for i in range(3)]

    def sample(self, values: NDArray[np.float32], points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...) or (..., C). Values (X, Y, Z) or (X, Y, Z, C) at world points (..., 3), trilinear; outside the grid
        those of the nearest cell."""
        return _read(values, points, np.asarray(self.origin, np.float64), float(self.cell), 0.5)


@dataclass(frozen=True)
class Body:
    """A solid: the signed distance to its skin on a grid."""

    grid: Grid
    depth: NDArray[np.float32]
    """(X, Y, Z). Depth below the skin at cell centres, world units; positive inside."""

    def __post_init__(self) -> None:
        assert self.depth.shape == self.grid.shape, (self.depth.shape, self.grid.shape)

    @property
    def inside(self) -> NDArray[np.bool_]:
        """(X, Y, Z). Cells whose centre lies in the solid."""
        return self.depth > 0

    @property
    def points(self) -> NDArray[np.float32]:
        """(N, 3). World positions of the cell centres in the solid."""
        return self.grid.centres_of(self.inside)

    @property
    def volume(self) -> float:
        """World units cubed; a cell that the skin crosses counts for the part of it under the skin."""
        return float(np.clip(self.depth / self.grid.cell + 0.5, 0, 1).sum(dtype=np.float64)) * self.grid.cell**3

    @property
    def inradius(self) -> float:
        """Depth of the deepest point, world units."""
        return float(self.depth.max())

    @cached_property
    def radius(self) -> float:
        """Distance from the middle of the bounds to the farthest inside point, world units."""
        points = self.points - self.bounds().mean(0)
        return float(np.linalg.norm(points, axis=1).max()) + self.grid.cell / 2 if len(points) else self.grid.cell

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...). Depth at world points (..., 3), trilinear; outside the grid that of the nearest cell."""
        return self.grid.sample(self.depth, points)

    def on(self, grid: Grid) -> NDArray[np.float32]:
        """(X, Y, Z). `at` the cell centres of another grid."""
        return np.stack(side_by_side(lambda x: self.at(grid.layer(x)), range(grid.shape[0])))

    def bounds(self) -> NDArray[np.float64]:
        """(2, 3). Box around the inside cells, world units; that of the whole grid if no cell is inside."""
        cells = np.argwhere(self.inside)
        low, high = (cells.min(0), cells.max(0) + 1) if len(cells) else (np.zeros(3), np.array(self.grid.shape))
        return self.grid.origin + np.stack([low, high]) * self.grid.cell

    def resampled(self, cell: float) -> Body:
        """The same solid on cells of another size, with a margin of two cells."""
        low, high = self.bounds()
        x, y, z = (np.ceil((high - low) / cell).astype(int) + 4).tolist()
        grid = Grid(low - 2 * cell, cell, (x, y, z))
        return Body(grid, self.on(grid))


def read_cells(values: NDArray[np.float32], at: NDArray[np.floating]) -> NDArray[np.float32]:
    """(...) or (..., C). Values (X, Y, Z) or (X, Y, Z, C) at places (..., 3) in cells whose centres are at whole
    numbers; the values of the border continue beyond it. Bit-equal to SciPy's map_coordinates of order 1 for each
    channel, which sums in float64, in a quarter to a half of its time, an eighth for three channels."""
    return _read(values, at, np.zeros(3), 1.0, 0.0)


def _read(
    values: NDArray[np.float32], points: NDArray[np.floating], origin: NDArray[np.float64], cell: float, centre: float
) -> NDArray[np.float32]:
    """`read_cells` at points (..., 3) from an origin, in cells of this size, whose centres are so far in their cell."""
    cells = np.ascontiguousarray(values).reshape(*values.shape[:3], -1)
    out = np.empty((points.size // 3, cells.shape[3]), np.float32)
    at = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    for_spans(_read_span, len(out), cells, at, origin, cell, centre, out)
    return out.reshape(*points.shape[:-1], *values.shape[3:])


@njit(cache=True, nogil=True)
def _read_span(
    start: int,
    stop: int,
    values: NDArray[np.float32],  # [X, Y, Z, C]
    points: NDArray[np.float64],  # [M, 3]
    origin: NDArray[np.float64],  # [3]
    cell: float,
    centre: float,
    out: NDArray[np.float32],  # [M, C]
) -> None:
    nx, ny, nz, channels = values.shape
    for m in range(start, stop):
        i, i1, a = _between((points[m, 0] - origin[0]) / cell - centre, nx)
        j, j1, b = _between((points[m, 1] - origin[1]) / cell - centre, ny)
        k, k1, c = _between((points[m, 2] - origin[2]) / cell - centre, nz)
        for n in range(channels):
            total = np.float64(values[i, j, k, n]) * a * b * c
            total += np.float64(values[i, j, k1, n]) * a * b * (1.0 - c)
            total += np.float64(values[i, j1, k, n]) * a * (1.0 - b) * c
            total += np.float64(values[i, j1, k1, n]) * a * (1.0 - b) * (1.0 - c)
            total += np.float64(values[i1, j, k, n]) * (1.0 - a) * b * c
            total += np.float64(values[i1, j, k1, n]) * (1.0 - a) * b * (1.0 - c)
            total += np.float64(values[i1, j1, k, n]) * (1.0 - a) * (1.0 - b) * c
            total += np.float64(values[i1, j1, k1, n]) * (1.0 - a) * (1.0 - b) * (1.0 - c)
            out[m, n] = total


@njit(cache=True)
def _between(place: float, cells: int) -> tuple[int, int, float]:
    """The two cells around a place along an axis, and the weight of the first."""
    at = min(place, cells - 1.0) if place > 0 else 0.0
    below = int(at)
    return below, min(below + 1, cells - 1), 1.0 - (at - below)


def widened(cells: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """(X, Y, Z). Cells with a true one in the cube that goes so many cells to every side."""
    for axis in range(3):
        near = np.moveaxis(cells.copy(), axis, 0)
        for step in range(1, min(reach, len(near) - 1) + 1):
            there = np.moveaxis(cells, axis, 0)
            near[step:] |= there[:-step]
            near[:-step] |= there[step:]
        cells = np.moveaxis(near, 0, axis)
    return cells
