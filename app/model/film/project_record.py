"""The film of a project, and how it is saved, as JSON in the project file."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from app.model.camera_control import OrbitCamera
from app.model.film.record import LONGEST, MOST_KEYFRAMES, MOST_PLANES
from app.model.film.timeline import BACKGROUNDS, FilmLook, Opened, SceneKeyframe, Timeline
from engine.io.fields import Fields
from engine.scene.plane import Plane
from training.request import read_plane

__all__ = ["eye_record", "look_record", "read_eye", "read_look", "read_timeline", "timeline_record"]

MOST_PIXELS = 8192
"""Most pixels along a side: OpenGL drivers without a larger limit are common."""

SLOWEST, FASTEST = 1.0, 60.0
"""Least and most frames a second that the window offers."""


def timeline_record(timeline: Timeline) -> list[dict[str, Any]]:
    """The keyframes, from which `read_timeline` makes an equal film."""
    return [
        {"time": one.time, "view": eye_record(one.eye), "objects": [_opened_record(o) for o in one.objects]}
        for one in timeline.keyframes
    ]


def read_timeline(fields: Fields, table: dict[str, Any]) -> Timeline:
    """The film in the field 'film' of a project. Raises InputError if there is no valid one."""

    def read_keyframe(raw: Any) -> SceneKeyframe:
        entry = fields.table(raw, "a keyframe")
        view = read_eye(fields, fields.table(entry.get("view"), "'view' of a keyframe"))
        objects = fields.each(entry, "objects", lambda one: _read_opened(fields, one))
        fields.require(len({one.number for one in objects}) == len(objects), "a keyframe has an object twice")
        return SceneKeyframe(fields.number(entry, "time", 0.0, LONGEST), view, objects)

    keyframes = fields.each(table, "film", read_keyframe)
    fields.require(len(keyframes) <= MOST_KEYFRAMES, f"it has more than {MOST_KEYFRAMES} keyframes")
    fields.require(
        all(a.time < b.time for a, b in pairwise(keyframes)), "keyframes are not in the order of their times"
    )
    return Timeline(keyframes)


def look_record(look: FilmLook) -> dict[str, Any]:
    """How a film is saved, as JSON."""
    return {"size": list(look.size), "rate": look.rate, "background": look.background, "colour": list(look.colour)}


def read_look(fields: Fields, raw: Any) -> FilmLook:
    """The inverse of `look_record`."""
    table = fields.table(raw, "'film_look'")
    width, height = fields.numbers(table.get("size"), 2, "'size'")
    fits = all(side == int(side) and 16 <= side <= MOST_PIXELS for side in (width, height))
    fields.require(fits, f"'size' is not in whole pixels from 16 to {MOST_PIXELS}")
    r, g, b = fields.numbers(table.get("colour"), 3, "'colour'")
    fields.require(min(r, g, b) >= 0 and max(r, g, b) <= 1, "'colour' is outside [0, 1]")
    rate = fields.number(table, "rate", SLOWEST, FASTEST)
    return FilmLook((int(width), int(height)), rate, fields.choice(table, "background", BACKGROUNDS), (r, g, b))


def eye_record(eye: OrbitCamera) -> dict[str, Any]:
    """A camera as JSON."""
    return {
        "target": eye.target,
        "azimuth": eye.azimuth,
        "elevation": eye.elevation,
        "distance": eye.distance,
        "fov": eye.fov,
        "orthographic": eye.orthographic,
    }


def read_eye(fields: Fields, table: dict[str, Any]) -> OrbitCamera:
    """The inverse of `eye_record`."""
    x, y, z = fields.numbers(table.get("target"), 3, "'target'")
    distance = fields.number(table, "distance")
    fields.require(distance > 0, "'distance' is not above 0")
    return OrbitCamera(
        (x, y, z),
        fields.number(table, "azimuth"),
        fields.number(table, "elevation", -90, 90),
        distance,
        fields.number(table, "fov", 5, 120),
        fields.flag(table, "orthographic"),
    )


def _opened_record(one: Opened) -> dict[str, Any]:
    planes: list[dict[str, Any]] = [{"cut": id_, "plane": [*plane.normal, plane.offset]} for id_, plane in one.planes]
    return {"number": one.number, "gap": one.gap, "explode": one.explode, "planes": planes}


def _read_opened(fields: Fields, raw: Any) -> Opened:
    table = fields.table(raw, "an object of a keyframe")

    def pair(value: Any) -> tuple[int, Plane]:
        entry = fields.table(value, "a plane of a keyframe")
        return fields.integer(entry, "cut", 1), read_plane(fields, entry.get("plane"))

    planes = fields.each(table, "planes", pair)
    fields.require(len(planes) <= MOST_PLANES, f"a keyframe has more than {MOST_PLANES} planes")
    fields.require(len(dict(planes)) == len(planes), "a keyframe has a plane twice")
    gap, explode = fields.number(table, "gap", 0, 2), fields.number(table, "explode", 0, 2)
    return Opened(fields.integer(table, "number", 0), gap, explode, planes)
