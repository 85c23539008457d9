"""An object that is thrown up and cut in flight: where its pieces are at any time, and what a stroke does to them.

It is a game: gravity is gentle, and there is no air and no collision. The document does not change until the user keeps
the cuts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from app.model.document import Document, Key, Part, Placement
from app.model.knife import Stroke, slice_object
from app.model.pieces import PlacedPiece, PointSample, pieces
from app.model.rigid_transform import Motion, Vec3
from engine.scene.camera import Camera

__all__ = ["SECONDS", "Flight", "Throw", "in_flight", "sliced", "thrown"]

SECONDS = 4.5
"""Time from leaving the picture's lower edge to falling back there: long enough for four or five strokes."""

HEIGHT = 1.05
"""Height of the flight, as a multiple of that from its start to the middle of the picture: it peaks a little above."""

TUMBLE = 32.0
"""Degrees a second that the object turns in flight."""

PARTING, SPINNING = 0.35, 40.0
"""Speed at which the sides of a cut move apart, radii a second, and at which they topple outwards, degrees a second."""


@dataclass(frozen=True)
class Flight:
    """The flight of one piece from one moment on."""

    since: float
    """When it begins, seconds."""
    start: Motion
    """Where the piece is then."""
    centre: NDArray[np.float64]
    """(3,). Then the place of the point that the piece turns about and that flies on a parabola, world space."""
    velocity: NDArray[np.float64]
    """(3,). Velocity of that point at that moment, world units a second."""
    axis: NDArray[np.float64]
    """(3,). The axis that the piece turns about, a unit vector."""
    spin: float
    """Degrees a second about the axis."""

    def at(self, time: float, fall: NDArray[np.float64]) -> Motion:
        """Where the piece is at a time. `fall` (3,): the acceleration of gravity."""
        passed = time - self.since
        moved = Motion.by(passed * self.velocity + 0.5 * passed**2 * fall)
        return moved.after(Motion.about(self.centre, self.axis, passed * self.spin)).after(self.start)

    def speed(self, time: float, points: NDArray[np.float64], fall: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,). Velocity at a time of a point (3,) of the piece, in object space."""
        step = 1e-3
        before, after = (self.at(time + way * step, fall).apply(points) for way in (-0.5, 0.5))
        return (after - before) / step


@dataclass(frozen=True)
class Throw:
    """The object in the air."""

    document: Document
    """The document with the cuts made so far; the flights say where its pieces are."""
    flights: Mapping[Key, Flight] = field(default_factory=dict)
    fall: Vec3 = (0.0, 0.0, 0.0)
    """Acceleration of gravity, world units a second squared."""
    cuts: int = 0
    """Number of cuts made in flight."""


def thrown(document: Document, solid: PointSample, camera: Camera, distance: float, time: float) -> Throw:
    """Throws all visible pieces up together, from below a picture whose middle is at `distance` from the camera."""
    visible = [piece for piece in pieces(document, solid) if piece.visible]
    rows = [piece.motion.apply(solid.points[piece.rows]) for piece in visible]
    centre = np.concatenate(rows).mean(0) if rows else np.asarray(solid.centre)
    across = camera.height / camera.fy * (1.0 if camera.orthographic else distance)
    up, right = -camera.viewmat[1, :3], camera.viewmat[0, :3]
    middle = camera.position + distance * camera.forward
    below = middle - (across / 2 + solid.radius) * up
    rise = HEIGHT * float(np.linalg.norm(middle - below))
    strength = 8 * rise / SECONDS**2  # half of the time going up, half coming down
    begin = Motion.by(below - centre)
    axis = right + 0.35 * up
    axis /= np.linalg.norm(axis)
    velocity = up * strength * SECONDS / 2
    flights = {piece.key: Flight(time, begin.after(piece.motion), below, velocity, axis, TUMBLE) for piece in visible}
    x, y, z = (-strength * up).tolist()
    return Throw(replace(document, gap=0.0, explode=0.0), flights, (x, y, z))


def in_flight(throw: Throw, time: float) -> Document:
    """The document with its pieces where they are at a time."""
    document, fall = throw.document, np.asarray(throw.fall)
    for key, flight in throw.flights.items():
        placement = replace(document.placement(key), motion=flight.at(time, fall))
        document = document.placed(key, partial(_first, placement))
    return document


def _first(new: Placement, _: Placement) -> Placement:
    """The first of two placements: the new one replaces the old one."""
    return new


def sliced(throw: Throw, solid: PointSample, camera: Camera, stroke: Stroke, up: Vec3, time: float) -> Throw:
    """The throw after a stroke: each piece that it crosses becomes two, which move and turn apart."""
    cut = slice_object(in_flight(throw, time), solid, camera, stroke, up).document
    if cut is None:
        return throw
    fall = np.asarray(throw.fall)
    flights: dict[Key, Flight] = {}
    last = cut.cuts[-1]
    for piece in pieces(cut, solid):
        parent = throw.flights.get(piece.key)
        if parent is not None:
            flights[piece.key] = parent
        elif (parent := throw.flights.get(piece.key[:-1])) is not None and piece.visible:
            flights[piece.key] = _apart(
                piece, parent, solid, _leaving(last.parts_for(piece.key[:-1]), piece), time, fall
            )
    return replace(throw, document=replace(throw.document, cuts=cut.cuts), flights=flights, cuts=throw.cuts + 1)


def _leaving(parts: Sequence[Part], piece: PlacedPiece) -> NDArray[np.float64]:
    """(3,). Unit vector along which a piece moves away from the other side of its last cut."""
    normal = np.mean([part.plane.normal for part in parts], axis=0)
    world = piece.key[-1][1] * (piece.motion.rotation @ normal)
    return np.asarray(world / max(float(np.linalg.norm(world)), 1e-9))


def _apart(
    piece: PlacedPiece,
    parent: Flight,
    solid: PointSample,
    away: NDArray[np.float64],
    time: float,
    fall: NDArray[np.float64],
) -> Flight:
    """The flight of a piece that has just been cut off."""
    middle = solid.points[piece.rows].mean(0)
    motion = parent.at(time, fall)
    velocity = parent.speed(time, middle, fall) + PARTING * solid.radius * away
    # The piece goes on turning as before, and also topples outwards.
    outwards = np.cross(fall / max(float(np.linalg.norm(fall)), 1e-9), away)
    turning = math.radians(parent.spin) * parent.axis + math.radians(SPINNING) * outwards
    spin = float(np.linalg.norm(turning))
    axis = turning / spin if spin > 1e-9 else parent.axis
    return Flight(time, motion, motion.apply(middle), velocity, axis, math.degrees(spin))
