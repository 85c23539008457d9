"""The options that say which part of a capture is the object: --keep, --remove, --no-floor."""

from __future__ import annotations

from collections.abc import Sequence

from engine.command import parse_numbers
from engine.errors import InputError
from engine.isolate.selection import Below, Box, Detected, Isolation, Selection, Shape, Sphere, Step, keep_only
from engine.scene.plane import Plane

__all__ = ["parse_isolation"]

FORMS = "box:x0,y0,z0,x1,y1,z1, sphere:x,y,z,radius or plane:a,b,c,d"


def parse_isolation(keep: Sequence[str], remove: Sequence[str], no_floor: bool) -> Isolation:
    """What the options take away. Raises InputError for one that cannot be parsed.

    First all outside of what --keep names goes, then what --remove names, then the floor of what is left: a floor that
    is searched for in a whole room would be the room's.
    """
    isolation: list[Selection] = []
    if keep:
        isolation.append(keep_only(*(parse_shape(text, "--keep") for text in keep)))
    if remove:
        isolation.append(tuple(Step("add", parse_shape(text, "--remove")) for text in remove))
    if no_floor:
        isolation.append((Step("add", Detected("floor")),))
    return tuple(isolation)


def parse_shape(text: str, option: str) -> Shape:
    """The shape kind:numbers, in the coordinates of the scene as it is loaded."""
    kind, _, numbers = text.partition(":")
    complaint = f"{option} {text}: give {FORMS}"
    if kind == "box":
        values = parse_numbers(numbers, 6, complaint)
        (x0, x1), (y0, y1), (z0, z1) = (sorted(pair) for pair in zip(values[:3], values[3:], strict=True))
        return Box((x0, y0, z0), (x1, y1, z1))
    if kind == "sphere":
        x, y, z, radius = parse_numbers(numbers, 4, complaint)
        if radius <= 0:
            raise InputError(f"{option} {text}: the radius must be above 0")
        return Sphere((x, y, z), radius)
    if kind == "plane":
        a, b, c, d = parse_numbers(numbers, 4, complaint)
        return Below(Plane.of((a, b, c), d))
    raise InputError(complaint)
