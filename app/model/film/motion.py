"""Motion of every film: keyframes, and what a film shows at any time between them.

Values run through their keyframes on piecewise cubic curves without overshoot (F. N. Fritsch and J. Butland, "A method
for constructing local monotone piecewise cubic interpolants", SIAM J. Sci. Stat. Comput. 5, 1984): steady motion stays
steady, and no value leaves the range of its neighbours. A film that ends as it began goes round without a jolt; any
other one begins and ends at rest, so that two keyframes alone are joined by a smoothstep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from app.model.camera_control import OrbitCamera
from app.model.document import DEFAULT_GAP, Document, Part
from app.model.pieces import PointSample, pieces
from app.model.rigid_transform import Vec3, vec3
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["Film", "Keyframe", "frame_count", "frame_times", "frames", "motion", "placed", "seen"]

SAME = 1e-6
"""Degrees by which two equal azimuths may differ: far more than rounding errors, far less than anyone sees."""


@dataclass(frozen=True)
class Keyframe:
    """What a film shows of one object at one time."""

    time: float
    """Seconds from the beginning. Range [0, inf)."""
    azimuth: float
    """Degrees, see `engine.scene.camera.orbit`. The next keyframe's is reached the short way round."""
    elevation: float
    """Degrees. Range [-90, 90]."""
    zoom: float = 1.0
    """How many times nearer the eye is than at a zoom of 1. Range (0, inf)."""
    planes: tuple[Plane, ...] = ()
    """Planes that hide what is on their removed sides; all keyframes of a film have the same number."""
    explosion: float = 0.0
    """How far the pieces are parted; 0 puts them together. Range [0, 2], as in a document."""
    gap: float | None = None
    """Gap between the two sides of a cut, in radii of the object. Range [0, 2]. None: it follows the explosion."""
    target: Vec3 = (0.0, 0.0, 0.0)
    """What is in the middle of the picture, as an offset in world units from the target of the film's camera."""

    @property
    def parted(self) -> float:
        """The gap as a number, even if it follows the explosion."""
        return DEFAULT_GAP * self.explosion if self.gap is None else self.gap


@dataclass(frozen=True)
class Film:
    """Keyframes, and cuts that stay the same throughout."""

    keyframes: tuple[Keyframe, ...]
    """At least two, sorted by time, the first at 0. A plane's normal turns by at most 90 degrees between neighbours."""
    cuts: tuple[Plane, ...] = ()
    """Planes that divide the object into pieces, which the explosion parts."""

    @property
    def seconds(self) -> float:
        """Length from the first keyframe to the last, seconds."""
        return self.keyframes[-1].time

    @property
    def closed(self) -> bool:
        """Whether it ends as it began, so that it can be played in a loop."""
        first, last = self.keyframes[0], self.keyframes[-1]
        turn = math.remainder(last.azimuth - first.azimuth, 360.0)
        same = replace(last, time=first.time, azimuth=first.azimuth, gap=last.parted) == replace(
            first, gap=first.parted
        )
        return abs(turn) < SAME and same


def frame_count(seconds: float, rate: float) -> int:
    """Number of frames of a film at `rate` frames a second; at least two."""
    return max(2, round(seconds * rate))


def frame_times(seconds: float, count: int, closed: bool) -> Iterator[float]:
    """The time of each of at least two frames.

    The frame after the last of a closed film would be its first again; an open one ends with its last keyframe.
    """
    return (seconds * index / (count if closed else count - 1) for index in range(count))


def frames(film: Film, count: int, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Iterator[Keyframe]:
    """What each of `count` frames (at least two) shows, at the times of `frame_times`."""
    shown = motion(film, centre)
    return map(shown, frame_times(film.seconds, count, film.closed))


def motion(film: Film, centre: ArrayLike = (0.0, 0.0, 0.0), closed: bool | None = None) -> Callable[[float], Keyframe]:
    """What a film shows, as a function of the time in [0, film.seconds].

    A plane turns about the foot of the perpendicular from `centre` (3,), so that one through the centre stays there.
    `closed`: whether the film is a loop; by default it is one if it ends as it began.
    """
    keys = film.keyframes
    middle = np.asarray(centre, np.float64)
    rows = np.array([_numbers(key, middle) for key in keys])
    rows[:, 0] = np.unwrap(rows[:, 0], period=360.0)
    times = np.array([key.time for key in keys])
    # An extra keyframe at each end gives the curves their slope there: that of the next round, or rest.
    before, after = times[0] - (times[-1] - times[-2]), times[-1] + (times[1] - times[0])
    first, last = rows[0], rows[-1]
    if film.closed if closed is None else closed:
        first, last = rows[-2] - rows[-1] + rows[0], rows[1] - rows[0] + rows[-1]
    curve = PchipInterpolator([before, *times, after], np.stack([first, *rows, last]))
    return lambda time: _keyframe(time, curve(time), middle)


def seen(eye: OrbitCamera, shown: Keyframe) -> OrbitCamera:
    """The camera of a frame; `eye` is the camera for a zoom of 1 and a target of 0."""
    target = vec3(np.add(eye.target, shown.target))
    return replace(
        eye, target=target, azimuth=shown.azimuth, elevation=shown.elevation, distance=eye.distance / shown.zoom
    )


def placed(film: Film, shown: Keyframe, solid: PointSample) -> list[Piece]:
    """The pieces of a frame: parted as in the window, without what the frame's planes hide."""
    cut = Document(gap=shown.parted, explode=shown.explosion)
    for plane in film.cuts:
        cut = cut.with_cut((Part(plane),))
    return [drawn for piece in pieces(cut, solid) for drawn in piece.drawn(shown.planes)]


def _numbers(key: Keyframe, centre: NDArray[np.float64]) -> NDArray[np.float64]:
    """(8 + 4 P,). Numbers to interpolate: the zoom by its logarithm, planes by normal and distance of the centre."""
    planes = [(*plane.normal, float(plane.distance(centre))) for plane in key.planes]
    view = [key.azimuth, key.elevation, np.log(key.zoom), *key.target]
    return np.concatenate([view, [key.explosion, key.parted], *planes])


def _keyframe(time: float, row: NDArray[np.float64], centre: NDArray[np.float64]) -> Keyframe:
    """The inverse of `_numbers`."""
    azimuth, elevation, zoom, x, y, z, explosion, gap = row[:8].tolist()
    planes = []
    for a, b, c, distance in row[8:].reshape(-1, 4).tolist():
        normal = np.array([a, b, c]) / np.linalg.norm([a, b, c])
        planes.append(Plane.of(normal, distance - float(normal @ centre)))
    return Keyframe(time, azimuth, elevation, float(np.exp(zoom)), tuple(planes), explosion, gap, (x, y, z))
