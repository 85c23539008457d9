"""The field of the interior atoms on a cut plane where the processor draws, kept for as long as the plane stays.

A plane that moves is drawn pixel by pixel, which costs less than its grid; the grid is made when it is seen again.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.tiles import CHUNKS
from engine.render.cpu.window_faces import BAND, GRID, SECTION, bin_bands, fill_grid, sections
from engine.render.culling.face_grid import KEPT_BYTES, plan_grid
from engine.render.culling.look import Look
from engine.render.culling.store import Spheres
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.threads import for_each

__all__ = ["KeptGrids"]

Double = NDArray[np.float64]
Grid = tuple[NDArray[np.float32], Double]
"""Weight and RGB by weight (cells, 4), and what it is (GRID,)."""


class KeptGrids:
    """The grids of one set of interior atoms."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Any, ...], Grid | None] = OrderedDict()
        self._seen: set[tuple[Any, ...]] = set()
        self._now: set[tuple[Any, ...]] = set()
        self._row: list[tuple[Any, ...]] = []
        self._cells = np.zeros((0, 4), np.float32)

    def begin(self) -> None:
        """A new frame."""
        self._seen, self._now = self._now, set()

    def get(self, plane: Double, spheres: Spheres, look: Look) -> tuple[Any, ...] | None:
        """The key of the grid of a plane (4,), made if the last frame showed it, too; None where there is none."""
        key = (*plane.tolist(), look.level)
        self._now.add(key)
        if key not in self._kept:
            if key not in self._seen:
                return None
            self._kept[key] = make(plane, spheres, look)
        self._kept.move_to_end(key)
        total = sum(grid[0].nbytes for grid in self._kept.values() if grid is not None)
        for old in [old for old in self._kept if old not in self._now and old not in self._seen]:
            if total <= KEPT_BYTES and len(self._kept) < 1000:
                break
            grid = self._kept.pop(old)
            total -= 0 if grid is None else grid[0].nbytes
        return None if self._kept[key] is None else key

    def together(self, keys: Sequence[tuple[int, tuple[Any, ...]]], planes: int) -> Grid:
        """The grids of some planes one after the other, and for each of `planes` planes where its own is (P, GRID)."""
        if self._row != [key for _, key in keys]:
            found = [grid[0] for _, key in keys if (grid := self._kept[key]) is not None]
            self._cells = np.concatenate(found) if found else np.zeros((0, 4), np.float32)
            self._row = [key for _, key in keys]
        table, at = np.full((planes, GRID), -1.0), 0
        for plane, key in keys:
            grid = self._kept[key]
            assert grid is not None
            table[plane] = grid[1]
            table[plane, 0] = at
            at += len(grid[0])
        return self._cells, table

    def clear(self) -> None:
        """Drops all: the atoms or their colours have changed."""
        self._kept.clear()
        self._row = []
        self._cells = np.zeros((0, 4), np.float32)


def make(plane: Double, spheres: Spheres, look: Look) -> Grid | None:
    """The grid of a plane (4,) in centred object space; None where the atoms' sizes do not allow one."""
    plan = plan_grid(plane, spheres, look)
    if plan is None:
        return None
    (e1, e2, _), low, cell, width, height = plan.axes, plan.low, plan.cell, plan.width, plan.height
    # A camera that looks straight at the plane, a cell to a pixel.
    matrix = np.eye(4)
    matrix[:3, :3] = plan.axes
    across, down = float(-low[0] / cell), float(-low[1] / cell)
    straight = Camera(np.eye(4), 1 / cell, 1 / cell, across, down, width, height, orthographic=True)
    records, boxes = np.empty((len(plan.rows), SECTION), np.float32), np.empty((len(plan.rows), 4), np.int32)
    for_each(
        sections, CHUNKS, -(-len(plan.rows) // CHUNKS), plan.rows, *spheres.kept, look.ball_scale, plane, e1, e2,
        matrix, camera_record(straight), records, boxes,
    )  # fmt: skip
    # Narrowed by the variance of the hat that linear interpolation is, with the same reach and the same sum.
    widened = 1 / (1 - 2 * records[:, 2:3] * cell * cell / 6)
    records[:, 2:10] *= widened
    records[:, 3] = 0
    first, listed = bin_bands(boxes, -(-height // BAND))
    grid = np.empty((height, width, 4), np.float32)
    for_each(fill_grid, -(-height // BAND), low[0], low[1], cell, first, listed, boxes, records, grid)
    return grid.reshape(-1, 4), np.array([0, height, width, low[0], low[1], 1 / cell])
