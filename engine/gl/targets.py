"""Framebuffers: where the passes add up, and the frame that comes out. The top row of a picture is stored first."""

from __future__ import annotations

import moderngl

__all__ = ["Accumulators", "Frame"]


class Frame:
    """A finished picture. Two of them take turns when several pieces are put together."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int) -> None:
        self.colour = ctx.texture((width, height), 4, dtype="f2")
        """RGB over the background, alpha 1: half floats keep 11 bits up to 1."""
        self.info = ctx.texture((width, height), 2, dtype="f4")
        """Depth in world units (3e38: nothing); twice the number of the group of pieces (-1: none) plus coverage."""
        self.colour.repeat_x = self.colour.repeat_y = False
        self.fbo = ctx.framebuffer([self.colour, self.info])
        self.colour_fbo = ctx.framebuffer([self.colour])
        self.info_fbo = ctx.framebuffer([self.info])

    def release(self) -> None:
        """Frees the textures."""
        for item in (self.fbo, self.colour_fbo, self.info_fbo, self.colour, self.info):
            item.release()


class Accumulators:
    """What the passes of one group of pieces write. Sums are 32-bit: as fast on software GL and exact to 1e-6."""

    def __init__(self, ctx: moderngl.Context, width: int, height: int) -> None:
        size = (width, height)
        self.depth = ctx.depth_texture(size)
        self.depth.compare_func = ""  # read as a number, not compared
        self.depth.filter = moderngl.NEAREST, moderngl.NEAREST
        self.splats = ctx.texture(size, 4, dtype="f4")
        self.sharpness = ctx.texture(size, 1, dtype="f4")
        self.field = ctx.texture(size, 4, dtype="f4")
        self.faces = ctx.texture(size, 4, dtype="f2")
        self.face_depths = ctx.texture(size, 1, dtype="f4")
        self.front_fbo = ctx.framebuffer([], self.depth)
        self.splat_fbo = ctx.framebuffer([self.splats, self.sharpness], self.depth)
        self.field_fbo = ctx.framebuffer([self.field])
        self.face_fbo = ctx.framebuffer([self.faces, self.face_depths], self.depth)

    def release(self) -> None:
        """Frees everything."""
        for fbo in (self.front_fbo, self.splat_fbo, self.field_fbo, self.face_fbo):
            fbo.release()
        for texture in (
            self.depth,
            self.splats,
            self.sharpness,
            self.field,
            self.faces,
            self.face_depths,
        ):
            texture.release()
