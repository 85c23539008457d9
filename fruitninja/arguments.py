"""Converts callers' arguments to the engine's types; raises Error where that is impossible."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Callable, Iterable, Sequence
from typing import cast, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.errors import InputError
from engine.io.fields import LARGEST_INTEGER
from engine.isolate.selection import Below, Box, Isolation, Sphere, keep_only
from engine.scene.plane import Plane
from training.cli import parse_axis
from training.settings import DetailName

__all__ = [
    "PathLike",
    "PlaneLike",
    "Progress",
    "Shape",
    "Shapes",
    "UpLike",
    "as_detail",
    "as_inks",
    "as_isolation",
    "as_plane",
    "as_points",
    "as_seed",
    "as_up",
    "check_view",
]

PathLike = str | os.PathLike[str]

PlaneLike = Plane | ArrayLike
"""A plane, or its four numbers a, b, c, d: the kept side is a x + b y + c z + d <= 0."""

UpLike = str | Sequence[float] | NDArray[np.floating]
"""x, y, z, -x, -y, -z, or a vector (3,) of any non-zero length."""

Shape = Box | Sphere | Below
"""A shape that the command's --keep can name."""

Shapes = Shape | Iterable[Shape | None]
"""Shapes, or a single one. None among them, as `Capture.middle` may be, is no shape."""

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the part of it that is done, range [0, 1]."""


def as_plane(given: PlaneLike) -> Plane:
    """The plane. Raises InputError unless it is a Plane or four finite numbers with a non-zero normal."""
    if isinstance(given, Plane):
        return given
    try:
        numbers = np.asarray(given, np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (4,):
        raise InputError(f"plane {given}: give four numbers a, b, c, d, or a Plane")
    return Plane.of(numbers[:3], float(numbers[3]))


def as_points(given: ArrayLike) -> NDArray[np.float64]:
    """(N, 3). The points as floats. Raises InputError for another shape, or numbers that are not finite."""
    try:
        points = np.asarray(given, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("points: give an array of numbers (N, 3)") from error
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"points of shape {points.shape}: give finite numbers (N, 3)")
    return points


def as_up(given: UpLike | None) -> tuple[float, float, float] | None:
    """The up axis as a unit vector; None (to be detected) stays None. Raises InputError for anything else."""
    if given is None:
        return None
    if isinstance(given, str):
        return parse_axis(given, "up")
    try:
        text = ",".join(repr(float(value)) for value in given)
    except (TypeError, ValueError) as error:
        raise InputError(f"up {given!r}: give x, y, z, -x, -y, -z or three numbers") from error
    return parse_axis(text, "up")


def as_seed(given: int) -> int:
    """The seed. Raises InputError unless it is a whole number from 0 to 2^53."""
    if isinstance(given, bool) or not isinstance(given, int | np.integer) or not 0 <= given <= LARGEST_INTEGER:
        raise InputError(f"seed {given!r}: give a whole number from 0 to {LARGEST_INTEGER}")
    return int(given)


def as_detail(given: str) -> DetailName:
    """The name of a level of detail. Raises InputError for any other word."""
    if given not in get_args(DetailName):
        raise InputError(f"detail '{given}': unknown; choose {', '.join(get_args(DetailName))}")
    return cast(DetailName, given)


def as_isolation(keep: Shapes) -> Isolation:
    """The isolation that keeps only what at least one of the shapes contains; without shapes it keeps everything.
    Raises InputError for anything else."""
    try:
        shapes = tuple(shape for shape in ((keep,) if isinstance(keep, Shape) else keep) if shape is not None)
    except TypeError:
        raise InputError(f"keep {keep!r}: give a list of shapes") from None
    for shape in shapes:
        if not isinstance(shape, Shape):
            raise InputError(f"keep {shape!r}: give shapes, such as fruitninja.Sphere(centre, radius)")
    return (keep_only(*shapes),) if shapes else ()


def as_inks(given: Iterable[Sequence[int]]) -> tuple[tuple[int, int, int], ...]:
    """Colours of a printer's materials. Raises InputError unless each is three whole numbers from 0 to 255."""
    inks = []
    for ink in given:
        try:
            red, green, blue = (operator.index(value) for value in ink)
        except (TypeError, ValueError):
            red = green = blue = -1
        if not all(0 <= value <= 255 for value in (red, green, blue)):
            raise InputError(f"ink {ink!r}: give three whole numbers from 0 to 255")
        inks.append((red, green, blue))
    return tuple(inks)


def check_view(azimuth: float | None, elevation: float | None, distance: float | None) -> None:
    """Raises InputError unless those that are given are angles and a distance."""
    for name, angle in (("azimuth", azimuth), ("elevation", elevation)):
        if angle is not None and not math.isfinite(angle):
            raise InputError(f"{name} {angle:g}: give an angle in degrees")
    if distance is not None and not 0 < distance < math.inf:
        raise InputError(f"distance {distance:g}: give a number above 0; 1 fits the object into the picture")
