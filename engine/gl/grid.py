"""The field of the interior atoms on a cut plane, kept as a texture for as long as the plane stays.

A face looks the same from every camera, so its sums need not be made again for each frame: a plane's grid is made
once, read with linear interpolation, and shared by the two pieces that the plane parts. The cells are fine against the
atoms, and the atoms are narrowed by what the interpolation widens them. What stays is the edge of each kernel at three
sigma, where it falls by 1/90, which falls between grid points: 55 dB on black and white atoms side by side.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.gl.batches import Pool
from engine.gl.chunks import near_plane
from engine.gl.context import Programs, write_uniforms
from engine.gl.look import Look
from engine.gl.polygon import section_of_box
from engine.gl.store import Spheres
from engine.plane import frame

__all__ = ["Grid", "Grids", "met_by"]

Double = NDArray[np.float64]

CELLS_PER_SIGMA = 2.5
"""Grid points to a standard deviation; with 4 a grid takes 2.5 times as long to make for 3 dB more."""

WIDEST = 12.0
"""Largest standard deviation over the smallest on one grid: a point is at most 255 cells wide."""

MOST_CELLS = 1 << 22
"""Cells of a grid; beyond it (64 MB) the face is drawn pixel by pixel."""

KEPT_BYTES = 256 << 20
"""GPU memory for grids that are not in the frame; what was used longest ago goes first."""


@dataclass(frozen=True)
class Grid:
    """A texture in a plane."""

    texture: moderngl.Texture
    """Weighted RGB and weight."""
    to_grid: Double
    """(4, 4). Centred object space to texture coordinates."""

    @property
    def size(self) -> int:
        """Bytes."""
        return self.texture.width * self.texture.height * 16


class Grids:
    """The grids of one set of interior atoms."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool
        self._kept: OrderedDict[tuple[Any, ...], Grid | None] = OrderedDict()
        self._used: set[tuple[Any, ...]] = set()

    def begin(self) -> None:
        """A new frame."""
        self._used.clear()

    def get(self, plane: Double, spheres: Spheres, look: Look) -> Grid | None:
        """The grid of a plane (4,) in centred object space; None where the atoms' sizes do not allow one."""
        plane = plane if plane[np.argmax(np.abs(plane[:3]))] > 0 else -plane  # both sides share it
        key = (*plane.tolist(), look.level)
        if key not in self._kept:
            self._kept[key] = self._make(plane, spheres, look)
        self._kept.move_to_end(key)
        self._used.add(key)
        self._evict()
        return self._kept[key]

    def clear(self) -> None:
        """Drops all: the atoms or their colours have changed."""
        for grid in self._kept.values():
            if grid is not None:
                grid.texture.release()
        self._kept.clear()

    def _evict(self) -> None:
        total = sum(grid.size for grid in self._kept.values() if grid is not None)
        for key in [key for key in self._kept if key not in self._used]:
            if total <= KEPT_BYTES and len(self._kept) < 1000:
                return
            grid = self._kept.pop(key)
            if grid is not None:
                total -= grid.size
                grid.texture.release()

    def _make(self, plane: Double, spheres: Spheres, look: Look) -> Grid | None:
        enlarge = look.ball_scale
        rows, felt = met_by(plane, spheres, look)
        if not len(rows):
            return None
        widest, least = float(felt[rows].max()) / 3, float(felt[rows].min()) / 3
        e1, e2, _ = frame(plane[:3])
        polygon = section_of_box(plane, spheres.low - 3 * widest, spheres.high + 3 * widest)
        if widest > WIDEST * least or not len(polygon):
            return None
        flat = polygon @ np.stack([e1, e2], 1)
        cell = least / CELLS_PER_SIGMA
        # An atom at a corner may have its foot outside of the box's section.
        low = flat.min(0) - 3 * widest
        cells = np.ceil((flat.max(0) + 3 * widest - low) / cell).astype(int)
        if cells.prod() > MOST_CELLS or cells.max() > 8192:
            return None
        width, height = cells.tolist()
        texture = self.ctx.texture((width, height), 4, dtype="f4")
        texture.repeat_x = texture.repeat_y = False
        target = self.ctx.framebuffer([texture])
        previous = self.ctx.fbo
        target.use()
        target.clear()
        self.ctx.enable_only(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
        self.ctx.blend_func = moderngl.ONE, moderngl.ONE
        program = self.programs.get("grid.vert.glsl", "grid.frag.glsl")
        values = {
            "cut": plane,
            "cut_x": e1,
            "cut_y": e2,
            "low": tuple(low),
            "cell": cell,
            "cells": (float(width), float(height)),
            "enlarge": enlarge,
        }
        write_uniforms(program, values)
        self.pool.write_indices(rows)
        self.pool.source(program, *spheres.streams).render(moderngl.POINTS, vertices=len(rows))
        previous.use()  # a framebuffer that is gone must not stay bound
        target.release()
        to_grid = np.zeros((4, 4))
        to_grid[0, :3], to_grid[1, :3] = e1 / (width * cell), e2 / (height * cell)
        to_grid[0, 3], to_grid[1, 3] = -low[0] / (width * cell), -low[1] / (height * cell)
        return Grid(texture, to_grid)


def met_by(plane: Double, spheres: Spheres, look: Look) -> tuple[NDArray[np.uint32], NDArray[np.float32]]:
    """Rows of the atoms that a plane (4,) in centred object space meets, and the reach of all atoms (N,)."""
    chunks, enlarge = spheres.chunks, look.ball_scale
    distances, reach = chunks.distances(plane[:3], plane[3]), 3 * chunks.sigma * enlarge
    met = (distances[:, 0] <= reach) & (distances[:, 1] >= -reach)
    count = -(-chunks.count[met] // 2**look.level)
    felt = (spheres.reach * enlarge).astype(np.float32)
    return near_plane(spheres.means, felt, chunks.first[met], count, plane[None].astype(np.float32), 0), felt
