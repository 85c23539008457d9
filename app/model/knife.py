"""From a stroke on the screen to a cut through the object."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.model.camera_control import project_points, ray
from app.model.document import Document, Key, Part
from app.model.pieces import PlacedPiece, Solid, visible_pieces
from app.model.rigid_transform import Vec3
from engine.scene.camera import Camera, equator
from engine.scene.plane import Plane

__all__ = [
    "Outcome",
    "PlaneAngles",
    "Stroke",
    "plane_of",
    "plane_through",
    "slice_evenly",
    "slice_object",
    "snapped_plane",
]

SHORTEST = 6.0
"""Pixels of the shortest stroke: a shorter drag is a click, and its direction is noise."""

SNAP_ANGLE = 15.0
"""Degrees between the upright planes that a stroke snaps to in a view from above."""

STEEP = math.cos(math.radians(20.0))
"""Cosine of the angle between view direction and up axis above which the view counts as one from above or below."""


@dataclass(frozen=True)
class Stroke:
    """A straight drag across the picture, in its pixels."""

    start: tuple[float, float]
    end: tuple[float, float]
    snap: bool = False
    """To the horizontal and vertical planes of the object."""

    @property
    def length(self) -> float:
        """Pixels."""
        return math.dist(self.start, self.end)

    @property
    def middle(self) -> tuple[float, float]:
        """Midpoint, in pixels."""
        return (self.start[0] + self.end[0]) / 2, (self.start[1] + self.end[1]) / 2


@dataclass(frozen=True)
class Outcome:
    """The result of a stroke."""

    document: Document | None
    """The document with the cut; None if nothing was cut."""
    message: str
    """One line for the user."""


def plane_of(camera: Camera, stroke: Stroke, up: Vec3, centre: NDArray[np.floating]) -> Plane | None:
    """The plane of a stroke: through the eye and the stroke, or the plane that it snaps to.

    `centre` (3,) of the object gives a snapped horizontal plane its depth. None for a stroke that is too short to have
    a direction. The kept side is to the right of the stroke.
    """
    if stroke.length < SHORTEST:
        return None
    start, first = ray(camera, stroke.start)
    end, last = ray(camera, stroke.end)
    normal = np.cross(first, end - start) if camera.orthographic else np.cross(first, last)
    if not np.linalg.norm(normal) > 1e-12:
        return None
    free = Plane.through(start, -normal)
    return snapped_plane(camera, stroke, free, np.asarray(up), centre) if stroke.snap else free


def snapped_plane(
    camera: Camera, stroke: Stroke, free: Plane, up: NDArray[np.float64], centre: NDArray[np.floating]
) -> Plane:
    """The horizontal or vertical plane nearest to a stroke, through the stroke's midpoint.

    A stroke that follows the projected up axis gives the vertical plane seen edge-on; one across it gives the
    horizontal plane, at the height of the stroke's midpoint at the depth of the object's centre. In a view from above
    every stroke gives a vertical plane, at the nearest multiple of 15 degrees.
    """
    start, direction = ray(camera, stroke.middle)
    point = start + direction * max(0.0, float((centre - start) @ direction))
    normal = np.asarray(free.normal)
    if abs(camera.forward @ up) > STEEP:
        flat = normal - up * (normal @ up)
        if np.linalg.norm(flat) < 1e-6:
            return free
        right, forward = camera.viewmat[0, :3], np.cross(up, camera.viewmat[0, :3])
        angle = math.degrees(math.atan2(float(flat @ forward), float(flat @ right)))
        step = math.radians(round(angle / SNAP_ANGLE) * SNAP_ANGLE)
        e1 = right - up * (right @ up)
        e1 = e1 / np.linalg.norm(e1)
        return Plane.through(point, math.cos(step) * e1 + math.sin(step) * np.cross(up, e1))
    seen, _ = project_points(
        camera, np.stack([point, point + up * 1e-3 * max(1e-9, float(np.linalg.norm(point - start)))])
    )
    axis = seen[1] - seen[0]
    run = np.subtract(stroke.end, stroke.start)
    if abs(run @ axis) >= math.cos(math.radians(45.0)) * np.linalg.norm(run) * np.linalg.norm(axis):
        upright = np.cross(up, direction)
        return Plane.through(point, upright if upright @ normal > 0 else -upright)
    return Plane.through(point, up if up @ normal > 0 else -up)


def slice_object(
    document: Document,
    solid: Solid,
    camera: Camera,
    stroke: Stroke,
    up: Vec3,
    selected: Iterable[Key] = (),
) -> Outcome:
    """Cuts every visible piece that the stroke crosses, or only the selected ones among them."""
    plane = plane_of(camera, stroke, up, solid.centre)
    if plane is None:
        return Outcome(None, "That was too short to cut. Drag across the object.")
    chosen = set(selected)
    visible = visible_pieces(document, solid)
    candidates = [piece for piece in visible if not chosen or piece.key in chosen] or visible
    parts = [
        Part(piece.motion.inverse().carried(plane), piece.key)
        for piece in candidates
        if _crossed(piece, solid, camera, stroke, plane)
    ]
    if not parts:
        whose = "the selected piece" if chosen else "the object"
        return Outcome(None, f"The knife missed {whose}. Drag across it from side to side.")
    cut = document.with_cut(_joined(parts))
    count = len(parts)
    return Outcome(cut, "Cut into two." if count == 1 and len(visible) == 1 else f"Cut {_pieces(count)}.")


def _crossed(piece: PlacedPiece, solid: Solid, camera: Camera, stroke: Stroke, plane: Plane) -> bool:
    """Whether the plane divides the piece, and the stroke passes over the place where it does."""
    if not len(piece.rows):
        return False
    points = piece.motion.apply(solid.points[piece.rows])
    distance = plane.distance(points)
    if (distance > 0).all() or not (distance > 0).any():
        return False
    near = points[np.abs(distance) <= max(solid.spacing, float(np.abs(distance).min()))]
    pixels, depth = project_points(camera, near)
    pixels = pixels[depth > 0]
    run = np.subtract(stroke.end, stroke.start)
    along = (pixels - np.asarray(stroke.start)) @ run / (run @ run)
    return bool(len(along)) and float(along.max()) >= 0 and float(along.min()) <= 1


def _joined(parts: list[Part]) -> tuple[Part, ...]:
    """The parts of the new cut; a cut of the uncut object needs no scope."""
    first = parts[0]
    if len(parts) > 1 or first.scope:
        return tuple(parts)
    return (Part(first.plane),)


def _pieces(count: int) -> str:
    return "one piece" if count == 1 else f"{count} pieces"


@dataclass(frozen=True)
class PlaneAngles:
    """A plane in words that need no equation."""

    distance: float
    """From the object's centre along the normal, world units."""
    tilt: float
    """Degrees between the normal and the up axis: 0 for a level plane, 90 for an upright one. Range [0, 180]."""
    turn: float
    """Degrees of the normal about the up axis, from the first vector of `equator`; 0 for a level plane."""

    @staticmethod
    def of(plane: Plane, up: NDArray[np.float64], centre: NDArray[np.floating]) -> PlaneAngles:
        """Of a plane beside an object with this unit up axis (3,) and centre (3,)."""
        normal = np.asarray(plane.normal)
        e1, e2 = equator(up)
        along, x, y = float(normal @ up), float(normal @ e1), float(normal @ e2)
        flat = math.hypot(x, y)
        turn = math.degrees(math.atan2(y, x)) if flat > 1e-9 else 0.0
        return PlaneAngles(-float(plane.distance(centre)), math.degrees(math.atan2(flat, along)), turn)

    def plane(self, up: NDArray[np.float64], centre: NDArray[np.floating]) -> Plane:
        """The plane that it describes."""
        tilt, turn = math.radians(self.tilt), math.radians(self.turn)
        e1, e2 = equator(up)
        normal = math.cos(tilt) * up + math.sin(tilt) * (math.cos(turn) * e1 + math.sin(turn) * e2)
        return Plane.through(centre + self.distance * normal, normal)


def plane_through(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> Plane | None:
    """The plane through three points (3,); None if they lie in a line."""
    normal = np.cross(b - a, c - a)
    longest = max(float(np.linalg.norm(side)) for side in (b - a, c - a, c - b))
    return Plane.through((a + b + c) / 3, normal) if np.linalg.norm(normal) > 1e-3 * longest**2 else None


def slice_evenly(
    document: Document, solid: Solid, normal: NDArray[np.float64], count: int, selected: Iterable[Key] = ()
) -> Document | None:
    """Cuts what is visible, or the selected pieces of it, into `count` slices of one thickness along a unit normal
    (3,), from the first to the last point of all of them together. None if there is nothing to cut."""
    chosen = set(selected)
    visible = [piece for piece in visible_pieces(document, solid) if len(piece.rows)]
    candidates = [piece for piece in visible if not chosen or piece.key in chosen] or visible
    if not candidates:
        return None
    along = [piece.motion.apply(solid.points[piece.rows]) @ normal for piece in candidates]
    low, high = min(float(a.min()) for a in along), max(float(a.max()) for a in along)
    for height in np.linspace(low, high, count + 1)[1:-1]:
        plane = Plane.through(height * normal, normal)
        # Made for the pieces as they are now: each slice is a part of one of them, wherever it moves to.
        parts = [
            Part(piece.motion.inverse().carried(plane), piece.key)
            for piece, a in zip(candidates, along, strict=True)
            if a.min() < height < a.max()
        ]
        if parts:
            document = document.with_cut(_joined(parts), "Slice")
    return document
