"""Full-screen passes over the pixels of a rectangle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import moderngl

from engine.render.culling.groups import Rect
from engine.render.gl.context import Programs, write_uniforms

__all__ = ["UNDER", "Screen"]

UNDER = moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE
"""Blending of premultiplied colour, front to back."""


class Screen:
    """One triangle that covers the framebuffer."""

    def __init__(self, ctx: moderngl.Context, programs: Programs) -> None:
        self.ctx, self.programs = ctx, programs
        self._arrays: dict[moderngl.Program, moderngl.VertexArray] = {}

    def fill(
        self,
        fbo: moderngl.Framebuffer,
        rect: Rect,
        fragment: str,
        defines: Mapping[str, int | float],
        values: dict[str, Any],
        under: bool = False,
    ) -> None:
        """Runs a fragment shader for each pixel of the rectangle. The depth that it outputs is written untested.

        under: its premultiplied colour is blended under what is there.
        """
        fbo.scissor = rect
        fbo.use()
        # Without the test no depth is written.
        self.ctx.enable_only(moderngl.DEPTH_TEST | (moderngl.BLEND if under else moderngl.NOTHING))
        self.ctx.depth_func = "1"
        self.ctx.blend_func = UNDER
        program = self.programs.get("screen.vert.glsl", fragment, defines)
        write_uniforms(program, values)
        if program not in self._arrays:
            self._arrays[program] = self.ctx.vertex_array(program, [])
        self._arrays[program].render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees the arrays."""
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()
