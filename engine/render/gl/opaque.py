"""Opaque mode: pieces of solids, drawn group by group and composited by depth.

Pieces of a solid with the same transform fit together as in the uncut object: their splats share the same sums, so that
joined pieces give exactly the uncut object, without a seam that lets the background through. Each group is resolved on
its own and composited over or under the frame so far, pixel by pixel, because a silhouette in front has to be
anti-aliased against the piece behind it, not against the background.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.drawable import Drawable
from engine.render.culling.groups import Group, Rect, visible_groups
from engine.render.culling.view import View
from engine.render.gl.batches import Pool
from engine.render.gl.buffers import Buffers
from engine.render.gl.context import Programs
from engine.render.gl.screen import Screen
from engine.render.gl.section import SectionPass
from engine.render.gl.surface import SurfacePass
from engine.render.gl.targets import Accumulators, Frame
from engine.scene.camera import Camera
from engine.scene.constants import JOINT_PITCHES
from engine.scene.piece import Piece

__all__ = ["OpaqueMode"]

Double = NDArray[np.float64]


class OpaqueMode:
    """Draws pieces of solids into a frame."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, screen: Screen) -> None:
        self.ctx, self.screen = ctx, screen
        self.buffers = Buffers(ctx)
        self.surface = SurfacePass(ctx, programs, pool, screen, self.buffers)
        self.section = SectionPass(ctx, programs, pool, self.buffers)

    def draw(
        self,
        solids: Sequence[Drawable],
        camera: Camera,
        pieces: Sequence[Piece],
        groups: Sequence[Group],
        frames: Sequence[Frame],
        sums: Accumulators,
        background: Double,
        options: DrawOptions,
    ) -> None:
        """Draws the pieces into the first of two frames, which holds the background; the second is scratch."""
        self.section.grids.begin()
        frame, scratch = frames
        empty = True
        for number, solid, view, planes, rect in visible_groups(solids, camera, pieces, groups):
            faces = self._sum_group(view, planes, solid, sums, rect, options)
            values: dict[str, Any] = {
                **view.uniforms,
                "in_layer@0": sums.splats,
                "edges@1": sums.edges,
                "rims@7": sums.rims,
                "behind@8": sums.behind,
                "front@2": sums.depth,
                "faces@3": sums.faces,
                "face_depths@4": sums.face_depths,
                "background": tuple(background),
                "tolerance": JOINT_PITCHES * solid.pitch,
                "group": float(number),
            }
            defines = {"FACES": int(faces), "BELOW": int(not empty)}
            if empty:
                self.screen.fill(frame.fbo, rect, "resolve.frag.glsl", defines, values)
            else:
                values |= {"below@5": frame.colour, "below_info@6": frame.info}
                self.screen.fill(scratch.fbo, rect, "resolve.frag.glsl", defines, values)
                values = {"colour@0": scratch.colour, "info@1": scratch.info}
                self.screen.fill(frame.fbo, rect, "copy.frag.glsl", {}, values)
            empty = False

    def _sum_group(
        self, view: View, planes: list[Double], solid: Drawable, sums: Accumulators, rect: Rect, options: DrawOptions
    ) -> bool:
        """Fills the accumulators with pieces that lie together; True if a face is visible."""
        sums.front_fbo.scissor = (0, 0, *sums.front_fbo.size)
        sums.front_fbo.use()  # transform feedback needs a complete framebuffer, which a window may not have
        # Software GL clears a whole texture of bytes, half floats or depths faster than a part, but not one of floats.
        sums.front_fbo.clear(depth=1.0)
        for fbo in (sums.front_fbo, sums.splat_fbo, sums.field_fbo, sums.face_fbo):
            fbo.scissor = rect
        skin = None if options.interior_only else solid.skin
        has_faces = False
        for i, piece in enumerate(planes):
            if len(piece) and not has_faces:
                sums.coverage_fbo.clear()
            neighbours = planes[:i] + planes[i + 1 :]
            has_faces |= self.section.draw(
                view, piece, neighbours, solid.box, solid.inside, skin, sums, solid.pitch, rect, options
            )
        runs = self.surface.project(view, planes, solid.splats(options.interior_only), options)
        sums.splat_fbo.clear(viewport=rect)
        self.surface.draw(view, runs, sums, rect, solid.pitch, has_faces, options)
        return has_faces

    def clear(self) -> None:
        """Frees what was uploaded for the solids: others follow."""
        self.section.grids.clear()
        self.buffers.release()

    def release(self) -> None:
        """Frees the passes' GPU memory."""
        self.section.release()
        self.buffers.release()
