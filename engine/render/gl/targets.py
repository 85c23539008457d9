"""Framebuffers: the accumulators of the passes, and the finished frame. The top row of a picture is stored first."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.scene.constants import NOTHING

__all__ = ["Accumulators", "Frame"]


class Frame:
    """A finished picture. Two of them alternate while several groups of pieces are composited."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int) -> None:
        self.colour = ctx.texture((width, height), 4, dtype="f2")
        """RGB over the background, alpha 1: half floats keep 11 bits up to 1."""
        self.info = ctx.texture((width, height), 2, dtype="f4")
        """Depth in world units (NOTHING: none); twice the number of the group of pieces (-1: none) plus coverage."""
        self.colour.repeat_x = self.colour.repeat_y = False
        self.fbo = ctx.framebuffer([self.colour, self.info])
        self.colour_fbo = ctx.framebuffer([self.colour])
        self.info_fbo = ctx.framebuffer([self.info])

    def clear(self, background: NDArray[np.float64]) -> None:
        """Nothing but a background (3,)."""
        self.colour_fbo.use()  # a clear obeys the scissor of what was bound
        red, green, blue = background.tolist()
        self.colour_fbo.clear(red, green, blue, 1.0)
        self.info_fbo.clear(NOTHING, -2.0)

    def release(self) -> None:
        """Frees the textures."""
        for item in (self.fbo, self.colour_fbo, self.info_fbo, self.colour, self.info):
            item.release()


class Accumulators:
    """The sums of one group of pieces. They are 32-bit: as fast on software GL as 16-bit, and exact to 1e-6."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int) -> None:
        size = (width, height)
        self.depth = ctx.depth_texture(size)
        self.depth.compare_func = ""  # read as a number, not compared
        self.depth.filter = moderngl.NEAREST, moderngl.NEAREST
        self.limit = ctx.depth_texture(size)
        """What lies farther is left out of the sums."""
        self.splats = ctx.texture(size, 4, dtype="f4")
        self.rims = ctx.texture(size, 4, dtype="f4")
        self.behind = ctx.texture(size, 4, dtype="f4")
        self.edges = ctx.texture(size, 4, dtype="f4")
        self.field = ctx.texture(size, 4, dtype="f4")
        self.skin_field = ctx.texture(size, 4, dtype="f4")
        self.faces = ctx.texture(size, 4, dtype="f2")
        self.face_depths = ctx.texture(size, 1, dtype="f4")
        self._ctx = ctx
        self._distances: moderngl.Texture | None = None
        self._classic_fbo: moderngl.Framebuffer | None = None
        self.front_fbo = ctx.framebuffer([], self.depth)
        self.limit_fbo = ctx.framebuffer([], self.limit)
        self.splat_fbo = ctx.framebuffer([self.splats, self.rims, self.behind, self.edges], self.limit)
        """With a depth of its own to test against: its shader reads that of the front."""
        self.splat_fbo.depth_mask = False
        self.field_fbo = ctx.framebuffer([self.field])
        self.skin_field_fbo = ctx.framebuffer([self.skin_field])
        self.face_fbo = ctx.framebuffer([self.faces, self.face_depths], self.depth)
        self.coverage_fbo = ctx.framebuffer([self.faces])
        """For clearing: where the coverage is 0, nothing else is read."""

    @property
    def distances(self) -> moderngl.Texture:
        """Depth by weight of classic mode; created on first use, since few frames need it."""
        if self._distances is None:
            self._distances = self._ctx.texture(self.splats.size, 4, dtype="f4")
        return self._distances

    @property
    def classic_fbo(self) -> moderngl.Framebuffer:
        """Framebuffer of classic mode's sums."""
        if self._classic_fbo is None:
            self._classic_fbo = self._ctx.framebuffer([self.splats, self.distances])
        return self._classic_fbo

    def release(self) -> None:
        """Frees everything."""
        if self._classic_fbo is not None:
            self._classic_fbo.release()
        if self._distances is not None:
            self._distances.release()
        for fbo in (
            self.front_fbo,
            self.limit_fbo,
            self.splat_fbo,
            self.field_fbo,
            self.skin_field_fbo,
            self.face_fbo,
            self.coverage_fbo,
        ):
            fbo.release()
        for texture in (
            self.depth,
            self.limit,
            self.splats,
            self.rims,
            self.behind,
            self.edges,
            self.field,
            self.skin_field,
            self.faces,
            self.face_depths,
        ):
            texture.release()
