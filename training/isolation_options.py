"""The options that say which part of a capture is the object: --keep, --remove,
--no-surroundings, --no-floor, --body."""

from __future__ import annotations

from collections.abc import Sequence

from engine.command import parse_numbers
from engine.errors import InputError
from engine.isolate.selection import (
    NO_FLOOR,
    NO_SURROUNDINGS,
    Below,
    Box,
    Isolation,
    Selection,
    Shape,
    Sphere,
    Step,
    isolated,
    keep_only,
    split_bodies,
)
from engine.scene.gaussians import Gaussians
from engine.scene.plane import Plane

__all__ = ["parse_body", "parse_isolation", "select_bodies"]

FORMS = "box:x0,y0,z0,x1,y1,z1, sphere:x,y,z,radius or plane:a,b,c,d"


def parse_isolation(
    keep: Sequence[str], remove: Sequence[str], no_floor: bool, no_surroundings: bool = False
) -> Isolation:
    """What the options remove. Raises InputError for one that cannot be parsed.

    The surroundings go first, then everything outside the --keep shapes, then the --remove shapes, then the floor of
    what is left: searched for in a whole room, it would be the room's.
    """
    isolation: list[Selection] = [NO_SURROUNDINGS] if no_surroundings else []
    if keep:
        isolation.append(keep_only(*(parse_shape(text, "--keep") for text in keep)))
    if remove:
        isolation.append(tuple(Step("add", parse_shape(text, "--remove")) for text in remove))
    if no_floor:
        isolation.append(NO_FLOOR)
    return tuple(isolation)


def parse_shape(text: str, option: str) -> Shape:
    """The shape given as kind:numbers, in the coordinates of the scene as loaded."""
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


def parse_body(text: str) -> int | None:
    """The number of a body, from 1; None for all of them. Raises InputError for anything else."""
    if text == "all":
        return None
    if not text.isascii() or not text.isdigit() or len(text) > 9 or int(text) < 1:
        raise InputError(f"--body {text}: give a number from 1, or all")
    return int(text)


def select_bodies(gaussians: Gaussians, isolation: Isolation, body: int | None, name: str) -> dict[int, Isolation]:
    """For each body number, the isolation extended to leave only that one of the separate bodies; `body`: None for all.

    Raises InputError, its message beginning with `name`, if there is no such body, or if nothing is left.
    """
    rest, _ = isolated(gaussians, isolation, name)
    others: list[Isolation] = [(selection,) for selection in split_bodies(rest)] or [()]
    if body is not None and body > len(others):
        raise InputError(f"{name}: no body {body}; it has {len(others)}")
    return {n: (*isolation, *other) for n, other in enumerate(others, 1) if body in (None, n)}
