"""Cached grids of the interior's field on a cut plane, for the software path.

A moving plane is drawn pixel by pixel, which costs less than its grid. The grid is made when two frames in a row show
the same plane, and cached while it stays.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.software_faces import GRID, fill_grid
from engine.render.cpu.software_sections import BAND, SECTION, AtomBatch, SectionView, bin_bands, sections
from engine.render.cpu.tiles import CHUNKS
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.face_grid import CACHE_BYTES, plan_grid
from engine.render.culling.store import Spheres
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.threads import for_each

__all__ = ["GridCache"]

Double = NDArray[np.float64]
Grid = tuple[NDArray[np.float32], Double]
"""Weight and RGB by weight (cells, 4), and the numbers that describe the grid (GRID,)."""


class GridCache:
    """The grids of sets of interior atoms."""

    def __init__(self) -> None:
        self._cache: OrderedDict[tuple[Any, ...], Grid | None] = OrderedDict()
        self._seen: set[tuple[Any, ...]] = set()
        self._now: set[tuple[Any, ...]] = set()
        self._keys: list[tuple[Any, ...]] = []
        self._cells = np.zeros((0, 4), np.float32)

    def begin(self) -> None:
        """Begins a new frame."""
        self._seen, self._now = self._now, set()

    def get(self, plane: Double, spheres: Spheres, options: DrawOptions) -> tuple[Any, ...] | None:
        """The key of the grid of a plane (4,), made if the last frame showed it too; None if there is none."""
        key = (id(spheres), *plane.tolist(), options.level, options.size)  # the renderer holds `spheres` until `clear`
        self._now.add(key)
        if key not in self._cache:
            if key not in self._seen:
                return None
            self._cache[key] = make(plane, spheres, options)
        self._cache.move_to_end(key)
        total = sum(grid[0].nbytes for grid in self._cache.values() if grid is not None)
        for old in [old for old in self._cache if old not in self._now and old not in self._seen]:
            if total <= CACHE_BYTES and len(self._cache) < 1000:
                break
            grid = self._cache.pop(old)
            total -= 0 if grid is None else grid[0].nbytes
        return None if self._cache[key] is None else key

    def concatenated(self, keys: Sequence[tuple[int, tuple[Any, ...]]], planes: int) -> Grid:
        """The grids of some planes, one after another, and the description of each plane's grid (planes, GRID)."""
        if self._keys != [key for _, key in keys]:
            grids = [grid[0] for _, key in keys if (grid := self._cache[key]) is not None]
            self._cells = np.concatenate(grids) if grids else np.zeros((0, 4), np.float32)
            self._keys = [key for _, key in keys]
        table, first = np.full((planes, GRID), -1.0), 0
        for plane, key in keys:
            grid = self._cache[key]
            assert grid is not None
            table[plane] = grid[1]
            table[plane, 0] = first
            first += len(grid[0])
        return self._cells, table

    def clear(self) -> None:
        """Drops all grids: the atoms or their colours have changed."""
        self._cache.clear()
        self._keys = []
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
    return grid.reshape(-1, 4), np.array([0, height, width, low[0], low[1], 1 / cell])
