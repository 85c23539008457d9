"""Selections and isolations as JSON: one form for project files, requests and trained objects."""

from __future__ import annotations

import math
from typing import Any, get_args

from engine.io.fields import UNIT_TOLERANCE, Fields
from engine.isolate.selection import (
    DETECTED,
    MOST_CORNERS,
    MOST_STEPS,
    Below,
    BodyAt,
    Box,
    Detected,
    Isolation,
    Lasso,
    Operation,
    Selection,
    Shape,
    Sphere,
    Step,
    View,
)
from engine.scene.plane import Plane

__all__ = ["isolation_record", "read_isolation", "read_selection", "selection_record"]


def isolation_record(isolation: Isolation) -> list[Any]:
    """An isolation as lists, tables, texts and numbers, which equal themselves after a round trip through JSON."""
    return [selection_record(selection) for selection in isolation]


def selection_record(selection: Selection) -> list[Any]:
    """A selection as lists, tables, texts and numbers, which equal themselves after a round trip through JSON."""
    return [
        {"operation": step.operation} | ({} if step.shape is None else _shape_record(step.shape)) for step in selection
    ]


def read_isolation(reader: Fields, value: Any) -> Isolation:
    """The isolation of an `isolation_record`. Raises InputError if it is not one."""
    reader.require(isinstance(value, list) and len(value) <= MOST_STEPS, "'isolation' is no list of selections")
    return tuple(read_selection(reader, selection) for selection in value)


def read_selection(reader: Fields, value: Any) -> Selection:
    """The selection of a `selection_record`. Raises InputError if it is not one."""
    reader.require(isinstance(value, list) and len(value) <= MOST_STEPS, "a selection is no list of steps")
    return tuple(_read_step(reader, step) for step in value)


def _shape_record(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Box):
        return {"shape": "box", "low": list(shape.low), "high": list(shape.high), "turn": list(shape.turn)}
    if isinstance(shape, Sphere):
        return {"shape": "sphere", "centre": list(shape.centre), "radius": shape.radius}
    if isinstance(shape, Below):
        return {"shape": "below", "plane": [*shape.plane.normal, shape.plane.offset]}
    if isinstance(shape, BodyAt):
        return {"shape": "body", "point": list(shape.point)}
    if isinstance(shape, Detected):
        return {"shape": shape.kind}
    view = shape.view
    return {
        "shape": "lasso",
        "corners": [list(corner) for corner in shape.corners],
        "eye": list(view.eye),
        "turn": list(view.turn),
        "half": list(view.half),
        "orthographic": view.orthographic,
    }


def _read_step(reader: Fields, value: Any) -> Step:
    record = reader.table(value, "a step of a selection")
    operation: Operation = reader.choice(record, "operation", get_args(Operation))
    shapeless = operation in ("invert", "grow")
    return Step(operation) if shapeless else Step(operation, _read_shape(reader, record))


def _read_shape(reader: Fields, record: dict[str, Any]) -> Shape:
    kind = reader.choice(record, "shape", ("box", "sphere", "lasso", "below", "body", *DETECTED))
    if kind == "box":
        low, high = (_vector(reader, record, key) for key in ("low", "high"))
        reader.require(all(a <= b for a, b in zip(low, high, strict=True)), "'low' of a box is above its 'high'")
        return Box(low, high, _turn(reader, record))
    if kind == "sphere":
        return Sphere(_vector(reader, record, "centre"), reader.number(record, "radius", 0))
    if kind == "below":
        a, b, c, d = reader.numbers(record.get("plane"), 4, "'plane'")
        reader.require(abs(math.hypot(a, b, c) - 1) < UNIT_TOLERANCE, "the normal of a plane has not length 1")
        return Below(Plane((a, b, c), d))
    if kind == "body":
        return BodyAt(_vector(reader, record, "point"))
    if kind != "lasso":
        return Detected(kind)
    corners = reader.each(record, "corners", lambda corner: _pair(reader, corner, "a corner of a lasso"))
    reader.require(3 <= len(corners) <= MOST_CORNERS, f"a lasso has not 3 to {MOST_CORNERS} corners")
    half = _pair(reader, record.get("half"), "'half'")
    reader.require(min(half) > 0, "'half' of a lasso is not above 0")
    eye, turn = _vector(reader, record, "eye"), _turn(reader, record)
    return Lasso(View(eye, turn, half, reader.flag(record, "orthographic")), corners)


def _pair(reader: Fields, value: Any, what: str) -> tuple[float, float]:
    x, y = reader.numbers(value, 2, what)
    return x, y


def _vector(reader: Fields, record: dict[str, Any], key: str) -> tuple[float, float, float]:
    x, y, z = reader.numbers(record.get(key), 3, f"'{key}'")
    return x, y, z


def _turn(reader: Fields, record: dict[str, Any]) -> tuple[float, float, float, float]:
    w, x, y, z = reader.numbers(record.get("turn"), 4, "'turn'")
    reader.require(abs(math.hypot(w, x, y, z) - 1) < UNIT_TOLERANCE, "'turn' of a selection has not length 1")
    return w, x, y, z
