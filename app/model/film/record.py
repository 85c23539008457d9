"""Films as JSON files, which people write by hand.

    {"fruitninja_film": 1,
     "cuts": [[1, 0, 0, 0]],
     "keyframes": [{"time": 0, "azimuth": 30, "elevation": 20},
                   {"time": 4, "azimuth": 90, "elevation": 35, "zoom": 1.2, "explosion": 0.5}]}

A keyframe may also have "planes", [a, b, c, d] each, a "gap" and a "target", [x, y, z]. The defaults are a zoom of 1,
no planes, no explosion, a gap that follows the explosion, the middle of the object as the target, and no cuts.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from app.model.film.motion import Film, Keyframe
from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.files import read_file
from engine.io.strict_json import parse
from engine.scene.plane import Plane

__all__ = ["LONGEST", "MOST_KEYFRAMES", "MOST_PLANES", "film_record", "read_film"]

VERSION = 1
"""Version of the file format; it grows with every change of meaning."""

LIMIT = 1 << 20
"""Bytes of the largest file that is read: thousands of keyframes."""

LONGEST = 3600.0
"""Longest film, seconds: 90,000 frames at 25 a second."""

MOST_KEYFRAMES, MOST_PLANES = 1000, 16
"""Most keyframes of a film, and most planes of a keyframe: more than anybody writes by hand."""

REQUIRED = {"time", "azimuth", "elevation"}
OPTIONAL: dict[str, Any] = {"zoom": 1.0, "planes": [], "explosion": 0.0, "gap": None, "target": [0, 0, 0]}


def read_film(path: Path) -> Film:
    """The film in a file. Raises InputError, one line that begins with the path, if the file is not a film."""
    fields = Fields(path, "film")
    try:
        record = parse(read_file(path, LIMIT))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: not a film: no JSON ({error})") from error
    table = fields.table(record, "the content")
    unknown = sorted(table.keys() - {"fruitninja_film", "cuts", "keyframes"})
    fields.require(not unknown, f"unknown field {unknown[:1]}")
    fields.require(table.get("fruitninja_film") == VERSION, f"'fruitninja_film' is not {VERSION}")
    keys = fields.each(table, "keyframes", lambda value: _keyframe(fields, value))
    fields.require(2 <= len(keys) <= MOST_KEYFRAMES, f"it has {len(keys)} keyframes, not 2 to {MOST_KEYFRAMES}")
    fields.require(keys[0].time == 0, "the first keyframe's 'time' is not 0")
    for before, after in pairwise(keys):
        where = f"the keyframe at {after.time:g} s"
        fields.require(after.time > before.time, f"{where} is not after the one before it")
        fields.require(len(after.planes) == len(before.planes), f"{where} has another number of 'planes'")
        for a, b in zip(before.planes, after.planes, strict=True):
            turned = float(np.dot(a.normal, b.normal)) < -1e-9
            fields.require(not turned, f"{where} turns a plane by more than 90 degrees; put a keyframe between")
    return Film(keys, _planes(fields, {"cuts": [], **table}, "cuts"))


def film_record(film: Film) -> dict[str, Any]:
    """The content of a file from which `read_film` makes an equal film."""

    def numbers(planes: tuple[Plane, ...]) -> list[list[float]]:
        return [[*plane.normal, plane.offset] for plane in planes]

    keys = [asdict(key) | {"planes": numbers(key.planes), "target": list(key.target)} for key in film.keyframes]
    return {"fruitninja_film": VERSION, "cuts": numbers(film.cuts), "keyframes": keys}


def _keyframe(fields: Fields, value: Any) -> Keyframe:
    table = fields.table(value, "a keyframe")
    wrong = sorted(table.keys() - REQUIRED - OPTIONAL.keys())
    fields.require(not wrong, f"a keyframe has the unknown field {wrong[:1]}")
    full = OPTIONAL | table
    number: Callable[..., float] = fields.number
    x, y, z = fields.numbers(full["target"], 3, "'target'")
    return Keyframe(
        number(full, "time", 0.0, LONGEST),
        number(full, "azimuth", -36000.0, 36000.0),
        number(full, "elevation", -90.0, 90.0),
        number(full, "zoom", 0.01, 100.0),
        _planes(fields, full, "planes"),
        number(full, "explosion", 0.0, 2.0),
        None if full["gap"] is None else number(full, "gap", 0.0, 2.0),
        (x, y, z),
    )


def _planes(fields: Fields, table: dict[str, Any], key: str) -> tuple[Plane, ...]:
    """The planes in the field `key`, four numbers each."""

    def plane(value: Any) -> Plane:
        a, b, c, d = fields.numbers(value, 4, f"an entry of '{key}'")
        try:
            return Plane.of((a, b, c), d)
        except InputError as error:
            raise InputError(f"{fields.path}: not a film: {error}") from error

    found = fields.each(table, key, plane)
    fields.require(len(found) <= MOST_PLANES, f"more than {MOST_PLANES} '{key}'")
    return found
