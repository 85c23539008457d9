"""Films that need no file: once around, a plane through the object and back, or pieces apart and together again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.model.film.motion import Film, Keyframe
from engine.scene.plane import Plane

__all__ = ["explode", "sweep", "turntable"]

THIRD = 120.0
"""Degrees between the keyframes of a turntable: under 180, so that the short way round is the way forward."""

EDGE = 0.01
"""Part of the object that a sweep leaves out at either end: a film with an empty frame flickers."""

PARTED = 0.7
"""Explosion halfway through: whole faces are visible, and one still sees where the pieces belong."""

FARTHER = 0.65
"""Zoom at that moment: eight pieces of a ball, whose centres lie 0.65 radii out, stay inside the picture."""


def turntable(start: Keyframe, seconds: float) -> Film:
    """Once around at a steady pace, counter-clockwise as seen from above, beginning with what `start` shows."""
    steps = range(4)
    return Film(
        tuple(replace(start, time=seconds * step / 3, azimuth=start.azimuth + THIRD * step) for step in steps),
    )


def sweep(start: Keyframe, seconds: float, plane: Plane, points: NDArray[np.floating]) -> Film:
    """A plane that moves through points (N, 3) against its normal and back; what it has passed is removed.

    The planes of `start` stay as they are.
    """
    along = np.asarray(points, np.float64) @ np.asarray(plane.normal) if len(points) else np.zeros(1)
    low, high = float(along.min()), float(along.max())
    keys = []
    for time, part in ((0.0, 1 - EDGE), (seconds / 2, EDGE), (seconds, 1 - EDGE)):
        moved = Plane(plane.normal, -(low + (high - low) * part))
        keys.append(replace(start, time=time, planes=(moved, *start.planes)))
    return Film(tuple(keys))


def explode(start: Keyframe, seconds: float, cuts: tuple[Plane, ...]) -> Film:
    """The pieces that the cuts make move apart and together again."""
    apart = replace(start, time=seconds / 2, zoom=FARTHER * start.zoom, explosion=PARTED)
    return Film((replace(start, time=0.0), apart, replace(start, time=seconds)), cuts)
