"""Framebuffers: the accumulators of the passes, and the finished frame. The top row of a picture is stored first."""

from __future__ import annotations

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.scene.constants import NOTHING

__all__ = ["Accumulators", "Frame", "Layers"]


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
        """Clears to a background (3,)."""
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
        """Depth beyond which fragments are left out of the sums."""
        self.splats = ctx.texture(size, 4, dtype="f4")
        self.rims = ctx.texture(size, 4, dtype="f4")
        self.behind = ctx.texture(size, 4, dtype="f4")
        self.edges = ctx.texture(size, 4, dtype="f4")
        self.field = ctx.texture(size, 4, dtype="f4")
        self.skin_field = ctx.texture(size, 4, dtype="f4")
        self.faces = ctx.texture(size, 4, dtype="f2")
        self.face_depths = ctx.texture(size, 1, dtype="f4")
        self.front_fbo = ctx.framebuffer([], self.depth)
        self.limit_fbo = ctx.framebuffer([], self.limit)
        self.splat_fbo = ctx.framebuffer([self.splats, self.rims, self.behind, self.edges], self.limit)
        """Tests against a depth of its own, because its shader reads that of the front."""
        self.splat_fbo.depth_mask = False
        self.field_fbo = ctx.framebuffer([self.field])
        self.skin_field_fbo = ctx.framebuffer([self.skin_field])
        self.face_fbo = ctx.framebuffer([self.faces, self.face_depths], self.depth)
        self.coverage_fbo = ctx.framebuffer([self.faces])
        """For clearing only the coverage: where it is 0, nothing else is read."""

    def release(self) -> None:
        """Frees everything."""
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


class Layers:
    """A capture blended front to back: the slab of depths in progress, and what lies in front of it."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int, slabs: str | None) -> None:
        """slabs: their float type, f2 or f4; None for no slabs: everything is blended directly."""
        self.size = width, height
        self.slabs = slabs
        self.light = ctx.texture(self.size, 4, dtype="f4")
        """Premultiplied colour, opacity."""
        self.depth = ctx.texture(self.size, 4, dtype="f4")
        """Depth by weight; opacity in alpha, where blending reads it."""
        self.slab_light = ctx.texture(self.size, 4, dtype=slabs) if slabs else self.light
        self.slab_depth = ctx.texture(self.size, 4, dtype=slabs) if slabs else self.depth
        """Depth by weight, measured from the slab's near end in units of its thickness."""
        self.limit = ctx.depth_texture(self.size)
        """0 where nothing more shows, else 1."""
        self.fbo = ctx.framebuffer([self.light, self.depth])
        self.slab_fbo = ctx.framebuffer([self.slab_light, self.slab_depth], self.limit)
        self.slab_fbo.depth_mask = False
        self.limit_fbo = ctx.framebuffer([], self.limit)

    def clear(self) -> None:
        """Empties the layers."""
        self.limit_fbo.use()  # a clear obeys the depth mask of what was bound
        self.limit_fbo.clear(depth=1.0)
        self.fbo.clear()

    def release(self) -> None:
        """Frees everything."""
        for fbo in (self.fbo, self.slab_fbo, self.limit_fbo):
            fbo.release()
        for texture in {self.light, self.depth, self.slab_light, self.slab_depth, self.limit}:
            texture.release()
