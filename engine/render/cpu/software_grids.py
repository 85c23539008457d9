"""The field of the interior atoms on cut planes, as arrays that the software path keeps while the planes stay.

A moving plane is drawn pixel by pixel, which costs less than its grid. The grid is made when two frames in a row show
the same plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.software_faces import GRID, fill_grid
from engine.render.cpu.software_sections import BAND, SECTION, AtomBatch, SectionView, bin_bands, sections
from engine.render.cpu.tiles import CHUNKS
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.face_grid import plan_grid
from engine.render.culling.grid_cache import GridCache, grid_key
from engine.render.culling.store import Spheres
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.threads import for_each

__all__ = ["GridArrays"]

Double = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grid:
    """An array in a plane."""

    cells: NDArray[np.float32]
    """(cells, 4). Weight and RGB by weight."""
    layout: Double
    """(GRID,). The numbers that describe the grid to the kernels; the first, where its cells begin, is 0."""


class GridArrays:
    """The grids of sets of interior atoms, as arrays."""

    def __init__(self) -> None:
        self._cache = GridCache[Grid](lambda grid: grid.cells.nbytes)
        self._joined: list[Grid] = []
        self._cells = np.zeros((0, 4), np.float32)
        """The cells of the grids that were joined last."""

    def begin(self) -> None:
        """Begins a new frame."""
        self._cache.begin()

    def get(self, plane: Double, spheres: Spheres, options: DrawOptions) -> Grid | None:
        """The grid of a plane (4,) in centred object space, made if the last frame showed it too; None if there is
        none."""
        key = grid_key(plane, spheres, options)
        return self._cache.get(key, lambda: make(plane, spheres, options), at_once=False)

    def concatenated(self, grids: Sequence[tuple[int, Grid]], planes: int) -> tuple[NDArray[np.float32], Double]:
        """The cells of some planes' grids, one after another (cells, 4), and the layout of each plane's grid
        (planes, GRID), -1 where there is none. `grids`: each after the index of its plane."""
        joined = [grid for _, grid in grids]
        if self._joined != joined:
            self._cells = np.concatenate([grid.cells for grid in joined]) if joined else np.zeros((0, 4), np.float32)
            self._joined = joined
        table, first = np.full((planes, GRID), -1.0), 0
        for plane, grid in grids:
            table[plane] = grid.layout
            table[plane, 0] = first
            first += len(grid.cells)
        return self._cells, table

    def clear(self) -> None:
        """Drops all grids: the atoms or their colours have changed."""
        self._cache.clear()
        self._joined = []
        self._cells = np.zeros((0, 4), np.float32)


def make(plane: Double, spheres: Spheres, options: DrawOptions) -> Grid | None:
    """The grid of a plane (4,) in centred object space; None where the atoms' sizes do not allow one."""
    plan = plan_grid(plane, spheres, options)
    if plan is None:
        return None
    (e1, e2, _), low, cell, width, height = plan.axes, plan.low, plan.cell, plan.width, plan.height
    # A camera that looks straight at the plane, one pixel per cell.
    matrix = np.eye(4)
    matrix[:3, :3] = plan.axes
    across, down = float(-low[0] / cell), float(-low[1] / cell)
    straight = Camera(np.eye(4), 1 / cell, 1 / cell, across, down, width, height, orthographic=True)
    section_view = SectionView(plane, e1, e2, matrix, camera_record(straight))
    atoms = AtomBatch(plan.rows, *spheres.arrays, options.ball_scale)
    records, boxes = np.empty((len(plan.rows), SECTION), np.float32), np.empty((len(plan.rows), 4), np.int32)
    for_each(sections, CHUNKS, -(-len(plan.rows) // CHUNKS), atoms, section_view, records, boxes)
    # Linear interpolation convolves with a hat function: narrow the atoms by its variance, keeping reach and sum.
    with np.errstate(all="ignore"):  # records of atoms that the plane misses are unset
        records[:, 2:10] *= 1 / (1 - 2 * records[:, 2:3] * cell * cell / 6)
    records[:, 3] = 0
    band_starts, section_ids = bin_bands(boxes, -(-height // BAND))
    grid = np.empty((height, width, 4), np.float32)
    for_each(fill_grid, -(-height // BAND), low[0], low[1], cell, band_starts, section_ids, boxes, records, grid)
    return Grid(grid.reshape(-1, 4), np.array([0, height, width, low[0], low[1], 1 / cell]))
