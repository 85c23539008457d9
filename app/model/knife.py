"""Turns a stroke on the screen into a cut through the object."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from app.model.camera_control import project_points, ray
from app.model.document import Document, Key, Part
from app.model.pieces import PlacedPiece, PointSample, visible_pieces
from app.model.rigid_transform import Vec3
from app.translation import _, ngettext
from engine.scene.camera import Camera, equator
from engine.scene.plane import Plane

__all__ = [
    "Outcome",
    "PlaneAngles",
    "Stroke",
    "blade_of",
    "plane_of",
    "plane_through",
    "slice_evenly",
    "slice_object",
    "snapped_plane",
]

Pixel = tuple[float, float]
Points = NDArray[np.float64]

SHORTEST = 6.0
"""Pixels of the shortest stroke: a shorter drag is a click, and its direction is noise."""

SNAP_ANGLE = 15.0
"""Degrees between the upright planes that a stroke snaps to in a view from above."""

STEEP = math.cos(math.radians(20.0))
"""Cosine of the angle between view direction and up axis above which the view counts as from above or below."""


UNSEEN = 1.5
"""Pixels by which a blade may differ from the line that it was drawn along: no hand is steadier. A quarter of a circle
of 200 pixels becomes four planes."""

MOST_PLANES = 24
"""Most planes of one blade: a piece is drawn once for each. A line that needs more is smoothed until it does not."""

CLOSING = 0.12
"""Part of a line's length within which its ends count as meant to meet: a circle may lack a ninth of itself."""


@dataclass(frozen=True)
class Stroke:
    """A drag across the picture, in its pixels."""

    start: Pixel
    end: Pixel
    snap: bool = False
    """Whether it snaps to the horizontal and vertical planes of the object."""
    path: tuple[Pixel, ...] = ()
    """The line drawn from start to end, for a blade that follows it; () for a straight cut."""

    @property
    def length(self) -> float:
        """Distance from start to end, pixels."""
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

    `centre` (3,): the object's, gives a snapped horizontal plane its depth. The kept side is to the right of the
    stroke. None if the stroke is too short to have a direction.
    """
    if stroke.length < SHORTEST:
        return None
    free = _plane_between(camera, stroke.start, stroke.end)
    return snapped_plane(camera, stroke, free, np.asarray(up), centre) if stroke.snap and free else free


def _plane_between(camera: Camera, a: Pixel, b: Pixel) -> Plane | None:
    """The plane through the eye and two points of the picture, its kept side to the right of the way from a to b."""
    start, first = ray(camera, a)
    end, last = ray(camera, b)
    normal = np.cross(first, end - start) if camera.orthographic else np.cross(first, last)
    return Plane.through(start, -normal) if np.linalg.norm(normal) > 1e-12 else None


@dataclass(frozen=True)
class Facet:
    """One plane of a blade, and the part of the drawn line that it follows."""

    plane: Plane
    stroke: Stroke
    walls: tuple[Plane, ...] = ()
    """Half-spaces that limit where it cuts."""


def blade_of(camera: Camera, stroke: Stroke, up: Vec3, centre: NDArray[np.floating]) -> tuple[Facet, ...] | str:
    """The planes that a stroke cuts along, swept from the eye through its line; or a message why it cannot cut.

    A line that goes on in one direction divides everything into what is left and what is right of it: walls across the
    line, one at each corner, bound the planes. A closed line is divided into sectors about its middle, and the side it
    encloses is kept. A line without a bend gives one plane, as a stroke without a path does.
    """
    line = _simplified(np.array(stroke.path or (stroke.start, stroke.end), np.float64))
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    if len(line) < 3 or length < SHORTEST:
        plane = plane_of(camera, Stroke(stroke.start, stroke.end, stroke.snap), up, centre)
        return _("That was too short to cut. Drag across the object.") if plane is None else (Facet(plane, stroke),)
    bounds: list[tuple[Plane | None, Plane | None]]
    if np.linalg.norm(line[-1] - line[0]) < CLOSING * length:
        line = line[:-1] if len(line) > 3 else line
        line = line if _areas(line).sum() > 0 else line[::-1]  # so that the inside is to the right
        starts, ends, areas = line, np.roll(line, -1, axis=0), _areas(line)
        area = max(float(areas.sum()), 1e-9)  # nothing, for a line that goes back on itself
        middle = ((starts + ends) * areas[:, None]).sum(0) / (3 * area)
        if (_areas(line - middle) <= 0).any():
            return _("Part of that shape hides behind another, seen from its middle. Draw a rounder one.")
        spokes = [_plane_between(camera, _pixel(middle), _pixel(corner)) for corner in line]
        bounds = [(one, other and other.flipped()) for one, other in pairwise([*spokes, spokes[0]])]
    else:
        starts, ends = line[:-1], line[1:]
        along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
        if ((ends - starts) @ along <= 0).any():
            return _("The blade turned back. Draw it in one direction, or all around a shape to punch it out.")
        across = SHORTEST * np.array([-along[1], along[0]])  # has the earlier part of the line on its right
        walls = [_plane_between(camera, _pixel(corner), _pixel(corner + across)) for corner in line[1:-1]]
        bounds = [(one and one.flipped(), other) for one, other in pairwise([None, *walls, None])]
    facets = []
    for start, end, between in zip(starts, ends, bounds, strict=True):
        plane = _plane_between(camera, _pixel(start), _pixel(end))
        if plane is not None:
            walls_here = tuple(wall for wall in between if wall is not None)
            facets.append(Facet(plane, Stroke(_pixel(start), _pixel(end)), walls_here))
    return tuple(facets)


def _areas(line: Points) -> Points:
    """(N,). Twice the area between the origin and each side of a closed line (N, 2), with rows counted downwards as in
    pictures: below 0 where the origin is left of the side."""
    ends = np.roll(line, -1, axis=0)
    return np.asarray(line[:, 0] * ends[:, 1] - line[:, 1] * ends[:, 0])


def _pixel(point: Points) -> Pixel:
    return float(point[0]), float(point[1])


def _simplified(line: Points) -> Points:
    """(M, 2). The corners of a line (N, 2) that a blade needs, including its ends (Douglas and Peucker 1973)."""
    unseen = UNSEEN
    while True:
        kept = np.zeros(len(line), bool)
        kept[[0, -1]] = True
        spans = [(0, len(line) - 1)]
        if np.linalg.norm(line[-1] - line[0]) < CLOSING * np.linalg.norm(np.diff(line, axis=0), axis=1).sum():
            far = int(np.linalg.norm(line - line[0], axis=1).argmax())  # the ends of a closed line say nothing about it
            kept[far] = True
            spans = [(0, far), (far, len(line) - 1)]
        while spans:
            low, high = spans.pop()
            run = line[high] - line[low]
            off = line[low + 1 : high] - line[low]
            part = np.clip(off @ run / max(float(run @ run), 1e-12), 0, 1)
            apart = np.linalg.norm(off - part[:, None] * run, axis=1)
            if len(apart) and apart.max() > unseen:
                corner = low + 1 + int(apart.argmax())
                kept[corner] = True
                spans += [(low, corner), (corner, high)]
        if kept.sum() <= MOST_PLANES + 1:
            return line[kept]
        unseen *= 1.5


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
    solid: PointSample,
    camera: Camera,
    stroke: Stroke,
    up: Vec3,
    selected: Iterable[Key] = (),
) -> Outcome:
    """Cuts every visible piece that the stroke crosses, or only the selected ones among them."""
    blade = blade_of(camera, stroke, up, solid.centre)
    if isinstance(blade, str):
        return Outcome(None, blade)
    chosen = set(selected)
    visible = visible_pieces(document, solid)
    candidates = [piece for piece in visible if not chosen or piece.key in chosen] or visible
    parts = []
    for piece in candidates:
        if _crossed(piece, solid, camera, blade):
            back = piece.motion.inverse()
            parts += [Part(back.carried(f.plane), piece.key, tuple(map(back.carried, f.walls))) for f in blade]
    if not parts:
        whose = _("the selected piece") if chosen else _("the object")
        return Outcome(None, _("The knife missed {whose}. Drag across it from side to side.").format(whose=whose))
    cut = document.with_cut(tuple(parts))
    count = len({part.scope for part in parts})
    return Outcome(
        cut,
        _("Cut into two.") if count == 1 and len(visible) == 1 else _("Cut {pieces}.").format(pieces=_pieces(count)),
    )


def _crossed(piece: PlacedPiece, solid: PointSample, camera: Camera, blade: Sequence[Facet]) -> bool:
    """Whether the blade divides the piece, and the drawn line passes over a place where it does."""
    points = piece.motion.apply(solid.points[piece.rows])
    removed, passed = np.zeros(len(points), bool), False
    for facet in blade:
        within = np.logical_and.reduce([np.ones(len(points), bool), *(w.distance(points) <= 0 for w in facet.walls)])
        distance = facet.plane.distance(points)
        removed |= within & (distance > 0)
        apart = np.abs(distance[within])
        if len(apart):
            near = points[within][apart <= max(solid.spacing, float(apart.min()))]
            pixels, depth = project_points(camera, near)
            start, end = np.asarray(facet.stroke.start), np.asarray(facet.stroke.end)
            along = (pixels[depth > 0] - start) @ (end - start) / ((end - start) @ (end - start))
            passed |= bool(len(along)) and float(along.max()) >= 0 and float(along.min()) <= 1
    return passed and bool(removed.any()) and not removed.all()


def _pieces(count: int) -> str:
    return ngettext("one piece", "{count} pieces", count).format(count=count)


@dataclass(frozen=True)
class PlaneAngles:
    """A plane as a distance and two angles, which users understand without its equation."""

    distance: float
    """Distance from the object's centre along the normal, world units."""
    tilt: float
    """Degrees between the normal and the up axis: 0 for a level plane, 90 for an upright one. Range [0, 180]."""
    turn: float
    """Degrees from the first vector of `equator` to the normal, about the up axis; 0 for a level plane."""

    @staticmethod
    def of(plane: Plane, up: NDArray[np.float64], centre: NDArray[np.floating]) -> PlaneAngles:
        """From a plane, for an object with this unit up axis (3,) and centre (3,)."""
        normal = np.asarray(plane.normal)
        e1, e2 = equator(up)
        along, x, y = float(normal @ up), float(normal @ e1), float(normal @ e2)
        flat = math.hypot(x, y)
        turn = math.degrees(math.atan2(y, x)) if flat > 1e-9 else 0.0
        return PlaneAngles(-float(plane.distance(centre)), math.degrees(math.atan2(flat, along)), turn)

    def plane(self, up: NDArray[np.float64], centre: NDArray[np.floating]) -> Plane:
        """The plane that they describe; `up` and `centre` as in `of`."""
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
    document: Document, solid: PointSample, normal: NDArray[np.float64], count: int, selected: Iterable[Key] = ()
) -> Document | None:
    """Cuts the visible pieces, or only the selected ones among them, into `count` slices of equal thickness along a
    unit normal (3,), between the first and the last point of all of them together. None if there is nothing to cut."""
    chosen = set(selected)
    visible = [piece for piece in visible_pieces(document, solid) if len(piece.rows)]
    candidates = [piece for piece in visible if not chosen or piece.key in chosen] or visible
    if not candidates:
        return None
    along = [piece.motion.apply(solid.points[piece.rows]) @ normal for piece in candidates]
    low, high = min(float(a.min()) for a in along), max(float(a.max()) for a in along)
    for height in np.linspace(low, high, count + 1)[1:-1]:
        plane = Plane.through(height * normal, normal)
        # Made for the pieces as they are placed now: each slice stays a part of its piece, wherever that moves.
        parts = [
            Part(piece.motion.inverse().carried(plane), piece.key)
            for piece, a in zip(candidates, along, strict=True)
            if a.min() < height < a.max()
        ]
        if parts:
            document = document.with_cut(tuple(parts), _("Slice"))
    return document
