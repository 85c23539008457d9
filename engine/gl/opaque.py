"""Opaque mode: pieces of a solid, drawn group by group and put together by depth.

Pieces with the same transform lie together as they grew: their splats are added up in the same sums, so that pieces put
back together are the uncut object to the pixel, with no seam that lets the background through. Each such group is
resolved by itself and put over or under the frame so far, pixel by pixel, because a silhouette in front is to be
anti-aliased against the piece behind, not against the background.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.camera import Camera
from engine.errors import InputError
from engine.formula import JOINT_PITCHES
from engine.gl.batches import Pool
from engine.gl.context import Programs
from engine.gl.look import Look
from engine.gl.polygon import corners_within, face_polygons
from engine.gl.screen import Rect, Screen
from engine.gl.section import SectionPass
from engine.gl.solid import Solid
from engine.gl.surface import MAX_PLANES, SurfacePass
from engine.gl.targets import Accumulators, Frame
from engine.gl.view import View
from engine.piece import Piece
from engine.plane import stack

__all__ = ["Group", "OpaqueMode", "grouped", "seen_groups"]

Double = NDArray[np.float64]
Group = tuple[Double, list[int]]
"""A transform (4, 4) and the numbers of the pieces that have it."""


class OpaqueMode:
    """Draws a solid's pieces into a frame."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, screen: Screen) -> None:
        self.ctx, self.screen = ctx, screen
        self.surface = SurfacePass(ctx, programs, pool)
        self.section = SectionPass(ctx, programs, pool)

    def draw(
        self,
        solid: Solid,
        camera: Camera,
        pieces: Sequence[Piece],
        groups: Sequence[Group],
        frames: Sequence[Frame],
        sums: Accumulators,
        background: Double,
        look: Look,
    ) -> None:
        """Puts the pieces into the first of two frames, which shows the background; the second is scratch."""
        self.section.grids.begin()
        frame, scratch = frames
        empty = True
        for number, view, planes, rect in seen_groups(solid, camera, pieces, groups):
            faces = self._add_up(view, planes, solid, sums, rect, look)
            values: dict[str, Any] = {
                **view.uniforms,
                "splats@0": sums.splats,
                "sharpness@1": sums.sharpness,
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

    def _add_up(
        self, view: View, planes: list[Double], solid: Solid, sums: Accumulators, rect: Rect, look: Look
    ) -> bool:
        """Fills the accumulators with pieces that lie together; True where a face is seen."""
        sums.front_fbo.scissor = (0, 0, *sums.front_fbo.size)
        sums.front_fbo.use()  # transform feedback asks for a whole framebuffer, too, and a window may not have one
        # Software GL clears a whole texture of bytes, half floats or depth faster than a part of it, one of floats not.
        sums.front_fbo.clear(depth=1.0)
        for fbo in (sums.front_fbo, sums.splat_fbo, sums.field_fbo, sums.face_fbo):
            fbo.scissor = rect
        skin = None if look.interior_only else solid.skin
        has_faces = False
        for i, piece in enumerate(planes):
            if len(piece) and not has_faces:
                sums.coverage_fbo.clear()
            mates = planes[:i] + planes[i + 1 :]
            has_faces |= self.section.draw(
                view, piece, mates, solid.box, solid.inside, skin, sums, solid.pitch, rect, look
            )
        runs = []
        for splats in solid.splats(look.interior_only):
            runs += self.surface.project(view, planes, splats, look)
        sums.splat_fbo.depth_mask = False
        sums.splat_fbo.clear(viewport=rect)
        self.surface.draw(view, runs, sums, solid.pitch * look.disc_scale)
        return has_faces

    def release(self) -> None:
        """Frees what the passes hold."""
        self.section.release()


def grouped(pieces: Sequence[Piece]) -> list[Group]:
    """Pieces that lie together."""
    groups: list[Group] = []
    for i, piece in enumerate(pieces):
        for transform, members in groups:
            if np.array_equal(transform, piece.transform):
                members.append(i)
                break
        else:
            groups.append((piece.transform, [i]))
    return groups


def seen_groups(
    solid: Solid, camera: Camera, pieces: Sequence[Piece], groups: Sequence[Group]
) -> Iterator[tuple[int, View, list[Double], Rect]]:
    """The groups that show, farthest first: number, view, each piece's planes (P, 4), and where on the screen."""
    depth = [float((camera.viewmat @ transform @ np.append(solid.centre, 1))[2]) for transform, _ in groups]
    for number in np.argsort(depth)[::-1].tolist():
        transform, members = groups[number]
        view = View(Piece((), transform).camera(camera), solid.centre, solid.radius)
        planes = [left for m in members if (left := bounding_planes(pieces[m], solid)) is not None]
        rect = bounds_on_screen(view, planes, solid) if planes else None
        if rect is not None:
            yield number, view, planes, rect


def bounding_planes(piece: Piece, solid: Solid) -> Double | None:
    """(P, 4). The planes of a piece that cut the solid, in centred object space; None where nothing is left.

    Raises InputError where they are more than MAX_PLANES.
    """
    planes = stack(piece.planes)
    planes[:, 3] += planes[:, :3] @ solid.centre
    # Those that miss the object: all of it is kept, or nothing.
    if (planes[:, 3] > solid.radius).any():
        return None
    planes = planes[planes[:, 3] >= -solid.radius]
    if len(planes) > 1:
        polygons = face_polygons(planes, *solid.box)
        showing = np.array([len(p) >= 3 for p in polygons])
        if not showing.any() and len(planes):
            return None  # they shut each other out, or would bound the piece somewhere
        planes = planes[showing]
    if len(planes) > MAX_PLANES:
        raise InputError(f"a piece with {len(planes)} planes; at most {MAX_PLANES} can bound one, cut less often")
    return planes


def bounds_on_screen(view: View, pieces: Sequence[Double], solid: Solid) -> Rect | None:
    """The part of the picture that what the pieces keep of the solid can touch; None where there is none."""
    least, most = view.extent(np.zeros((1, 3)), np.array([solid.reach]))
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for planes in pieces:
        corners = corners_within(planes, *solid.box)
        if len(corners):
            first, last = view.extent(corners, np.zeros(len(corners)))
            low, high = np.minimum(low, first), np.maximum(high, last)
    size = np.array([view.camera.width, view.camera.height])
    begin = np.clip(np.floor(np.maximum(low, least)) - 4, 0, size).astype(int)
    end = np.clip(np.ceil(np.minimum(high, most)) + 4, 0, size).astype(int)
    if (end <= begin).any():
        return None
    return int(begin[0]), int(begin[1]), int(end[0] - begin[0]), int(end[1] - begin[1])
