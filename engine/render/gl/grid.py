"""The field of the interior atoms on cut planes, as textures that are kept while the planes stay.

A face looks the same from every camera, so its sums need not be computed for each frame: a plane's grid is computed
once, read with linear interpolation, and shared by the two pieces that the plane separates. The cells are fine compared
with the atoms, and the atoms are narrowed by as much as the interpolation widens them. What error remains comes from
the edge of each kernel at three sigma, a step of 1/90 between grid points: 55 dB for black and white atoms side by
side.
"""

from __future__ import annotations

from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.face_grid import plan_grid
from engine.render.culling.grid_cache import GridCache, grid_key
from engine.render.culling.store import Spheres
from engine.render.gl.batches import Pool
from engine.render.gl.buffers import Buffers
from engine.render.gl.context import Programs, write_uniforms

__all__ = ["Grid", "GridTextures"]

Double = NDArray[np.float64]

LARGEST = 8192
"""Most cells along an edge: the smallest texture limit of current OpenGL 3.3 drivers."""


@dataclass(frozen=True)
class Grid:
    """A texture in a plane."""

    texture: moderngl.Texture
    """Weighted RGB and weight."""
    to_grid: Double
    """(4, 4). Centred object space to texture coordinates."""

    @property
    def size(self) -> int:
        """Size of the texture, bytes."""
        return self.texture.width * self.texture.height * 16


class GridTextures:
    """The grids of sets of interior atoms, as textures."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, buffers: Buffers) -> None:
        self.ctx, self.programs, self.pool, self.buffers = ctx, programs, pool, buffers
        self._cache = GridCache[Grid](lambda grid: grid.size, lambda grid: grid.texture.release())

    def begin(self) -> None:
        """Begins a new frame."""
        self._cache.begin()

    def get(self, plane: Double, spheres: Spheres, options: DrawOptions) -> Grid | None:
        """The grid of a plane (4,) in centred object space; None if the atoms' sizes do not allow one."""
        plane = plane if plane[np.argmax(np.abs(plane[:3]))] > 0 else -plane  # both orientations share it
        return self._cache.get(grid_key(plane, spheres, options), lambda: self._make(plane, spheres, options))

    def clear(self) -> None:
        """Frees all grids: the atoms or their colours have changed."""
        self._cache.clear()

    def _make(self, plane: Double, spheres: Spheres, options: DrawOptions) -> Grid | None:
        plan = plan_grid(plane, spheres, options)
        if plan is None or max(plan.width, plan.height) > LARGEST:
            return None
        (e1, e2, _), low, cell, width, height = plan.axes, plan.low, plan.cell, plan.width, plan.height
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
            "enlarge": options.ball_scale,
        }
        write_uniforms(program, values)
        self.pool.write_indices(plan.rows)
        self.pool.source(program, *self.buffers.streams(spheres)).render(moderngl.POINTS, vertices=len(plan.rows))
        previous.use()  # a released framebuffer must not stay bound
        target.release()
        to_grid = np.zeros((4, 4))
        to_grid[0, :3], to_grid[1, :3] = e1 / (width * cell), e2 / (height * cell)
        to_grid[0, 3], to_grid[1, 3] = -low[0] / (width * cell), -low[1] / (height * cell)
        return Grid(texture, to_grid)
