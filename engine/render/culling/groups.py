"""Groups of pieces of one solid with the same transform, and the part of the picture that each can touch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.render.culling.drawable import Drawable
from engine.render.culling.polygon import corners_within, face_polygons
from engine.render.culling.view import View
from engine.scene.camera import Camera
from engine.scene.piece import Piece
from engine.scene.plane import stack

__all__ = ["MAX_PLANES", "Group", "Rect", "group_pieces", "visible_groups"]

Double = NDArray[np.float64]
Group = tuple[Double, list[int]]
"""A transform (4, 4) and the indices of the pieces of one solid that have it."""

Rect = tuple[int, int, int, int]
"""x, y, width, height in pixels, from the top left."""

MAX_PLANES = 64
"""Planes that can bound one piece, not counting those that cut nothing off."""


def group_pieces(pieces: Sequence[Piece]) -> list[Group]:
    """The pieces by solid and transform; those of one group fit together as in the uncut object."""
    groups: list[Group] = []
    for i, piece in enumerate(pieces):
        for transform, members in groups:
            if piece.solid == pieces[members[0]].solid and np.array_equal(transform, piece.transform):
                members.append(i)
                break
        else:
            groups.append((piece.transform, [i]))
    return groups


def visible_groups(
    solids: Sequence[Drawable], camera: Camera, pieces: Sequence[Piece], groups: Sequence[Group]
) -> Iterator[tuple[int, Drawable, View, list[Double], Rect]]:
    """The visible groups, farthest first: number, solid, view, each piece's planes (P, 4), rectangle of the picture."""
    owners = [solids[pieces[members[0]].solid] for _, members in groups]
    centres = [transform @ np.append(solid.centre, 1) for solid, (transform, _) in zip(owners, groups, strict=True)]
    depth = [float((camera.viewmat @ centre)[2]) for centre in centres]
    for number in np.argsort(depth)[::-1].tolist():
        (transform, members), solid = groups[number], owners[number]
        view = View(Piece((), transform).camera(camera), solid.centre, solid.radius)
        planes = [left for m in members if (left := bounding_planes(pieces[m], solid)) is not None]
        rect = bounds_on_screen(view, planes, solid) if planes else None
        if rect is not None:
            yield number, solid, view, planes, rect


def bounding_planes(piece: Piece, solid: Drawable) -> Double | None:
    """(P, 4). The planes of a piece that cut the solid, in centred object space; None if nothing is left of it.

    Raises InputError for more than MAX_PLANES.
    """
    planes = stack(piece.planes)
    planes[:, 3] += planes[:, :3] @ solid.centre
    # A plane that misses the object keeps all of it or nothing.
    extent = np.abs(planes[:, :3]) @ solid.box[1]
    if (planes[:, 3] > extent).any():
        return None
    planes = planes[planes[:, 3] > -extent]
    if len(planes) > 1:
        bounding = np.array([len(polygon) >= 3 for polygon in face_polygons(planes, *solid.box)])
        if not bounding.any():
            return None  # no plane bounds the piece anywhere: the half-spaces have no point in common
        planes = planes[bounding]
    if len(planes) > MAX_PLANES:
        raise InputError(f"a piece with {len(planes)} planes; at most {MAX_PLANES} can bound one, cut less often")
    return planes


def bounds_on_screen(view: View, pieces: Sequence[Double], solid: Drawable) -> Rect | None:
    """The part of the picture that the pieces can touch; None if there is none."""
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
