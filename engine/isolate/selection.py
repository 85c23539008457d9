"""Selections of a capture's Gaussians, described by shapes: what part of a capture is the object.

A selection is a list of steps, an isolation a list of selections that are removed one after another. Both are a few
numbers, and the rows that they select are a pure function of them and the capture: the window, the trainer and a
reopened project agree on every Gaussian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.isolate.bodies import find_bodies
from engine.isolate.floor import find_floor
from engine.isolate.surroundings import object_ball
from engine.isolate.touching import grow
from engine.scene.gaussians import Gaussians
from engine.scene.plane import Plane
from engine.scene.rotations import rotation_matrices
from engine.solid.denoise_capture import haze_and_fragments

__all__ = [
    "DETECTED",
    "INVERT",
    "MOST_CORNERS",
    "MOST_STEPS",
    "NO_FLOOR",
    "NO_SURROUNDINGS",
    "Below",
    "BodyAt",
    "Box",
    "Detected",
    "DetectedKind",
    "Isolation",
    "Lasso",
    "Operation",
    "Selection",
    "Shape",
    "Sphere",
    "Step",
    "View",
    "isolated",
    "keep_only",
    "removed",
    "split_bodies",
    "take_step",
    "without_surroundings",
]

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]

MOST_STEPS = 1000
"""Most steps of a selection, and most selections of an isolation: more than a day of clicking."""

MOST_CORNERS = 1000
"""Most corners of a lasso: one in each pixel of a stroke across the picture."""


@dataclass(frozen=True)
class Box:
    """Everything between two corners, edges included."""

    low: Vec3
    high: Vec3
    """Corners in the box's own axes, whose origin is the capture's, world units. `high` is no less than `low`."""
    turn: Quat = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion, wxyz, the box's axes to world."""

    def contains(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,). Which of the points (N, 3) lie in it."""
        (axes,) = rotation_matrices(np.array([self.turn], np.float64))
        local = np.asarray(points, np.float64) @ axes
        return np.asarray(((local >= self.low) & (local <= self.high)).all(1))


@dataclass(frozen=True)
class Sphere:
    """Everything within a radius."""

    centre: Vec3
    radius: float
    """World units. Range [0, inf)."""

    def contains(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,). Which of the points (N, 3) lie in it."""
        offset = np.asarray(points, np.float64) - self.centre
        return np.asarray((offset**2).sum(1) <= self.radius**2)


@dataclass(frozen=True)
class View:
    """The view in which a lasso was drawn. Camera axes as in engine.scene.camera: x right, y down, z forward."""

    eye: Vec3
    """World units."""
    turn: Quat
    """Unit quaternion, wxyz, camera axes to world."""
    half: Vec2
    """Half the width and height of the picture: at depth 1 for a perspective view, in world units for an orthographic
    one. Range (0, inf)."""
    orthographic: bool = False

    def project(self, points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Places (N, 2) of points (N, 3) in the picture, whose edges are at -1 and 1, and whether each is ahead (N,).

        Places of points behind the eye of a perspective view mean nothing. An orthographic view sees behind its eye.
        """
        (axes,) = rotation_matrices(np.array([self.turn], np.float64))
        local = (np.asarray(points, np.float64) - self.eye) @ axes
        ahead = np.ones(len(local), bool) if self.orthographic else local[:, 2] > 0
        depth = 1.0 if self.orthographic else np.where(ahead, local[:, 2], 1.0)[:, None]
        with np.errstate(over="ignore"):
            return local[:, :2] / depth / self.half, ahead


@dataclass(frozen=True)
class Lasso:
    """Everything that a line drawn around it in a picture encloses, through the whole depth."""

    view: View
    corners: tuple[Vec2, ...]
    """Corners of the closed line, in the picture whose edges are at -1 and 1: x right, y down. At least three. If the
    line crosses itself, areas that it encircles an odd number of times are enclosed."""

    def contains(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,). Which of the points (N, 3) lie in it."""
        places, ahead = self.view.project(points)
        corners = np.array(self.corners)
        near = ahead & ((places >= corners.min(0)) & (places <= corners.max(0))).all(1)
        inside = np.zeros(len(points), bool)
        x, y = places[near].T
        odd = np.zeros(len(x), bool)
        for (x0, y0), (x1, y1) in zip(self.corners, (*self.corners[1:], self.corners[0]), strict=True):
            crosses = (y0 > y) != (y1 > y)  # half open: a corner belongs to one of its two edges
            if y0 != y1:
                odd ^= crosses & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
        inside[near] = odd
        return inside


@dataclass(frozen=True)
class Below:
    """Everything on a plane and below it: where n.x + d <= 0."""

    plane: Plane

    def contains(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,). Which of the points (N, 3) lie in it."""
        return np.asarray(self.plane.distance(np.asarray(points, np.float64)) <= 0)


DetectedKind = Literal["surroundings", "floor", "fragments", "haze"]
DETECTED: tuple[DetectedKind, ...] = ("surroundings", "floor", "fragments", "haze")


@dataclass(frozen=True)
class Detected:
    """What is detected in the capture itself: the room or view around the object, the floor and what lies below it,
    small pieces apart from the object, or Gaussians too large and faint to be a surface."""

    kind: DetectedKind


@dataclass(frozen=True)
class BodyAt:
    """The separate body (engine.isolate.bodies) to which the Gaussian nearest to a point belongs; everything if there
    is only one body."""

    point: Vec3
    """World units."""


Shape = Box | Sphere | Lasso | Below | Detected | BodyAt

Operation = Literal["add", "subtract", "invert", "grow"]
"""`grow` adds what touches the selected Gaussians, and what touches that."""


@dataclass(frozen=True)
class Step:
    """One change of a selection."""

    operation: Operation
    shape: Shape | None = None
    """What is added or subtracted; None for the other operations."""

    def __post_init__(self) -> None:
        assert (self.shape is not None) == (self.operation in ("add", "subtract")), self


Selection = tuple[Step, ...]
"""Steps in order, from an empty selection."""

INVERT = Step("invert")

NO_SURROUNDINGS: Selection = (Step("add", Detected("surroundings")),)
NO_FLOOR: Selection = (Step("add", Detected("floor")),)
"""Selections of what stands or lies around the object."""


NOTHING_TO_LEAVE_OUT: dict[Selection, str] = {
    NO_SURROUNDINGS: "it has no surroundings to leave out",
    NO_FLOOR: "it has no floor to leave out",
}

Isolation = tuple[Selection, ...]
"""What is removed, one selection after another: each looks only at what the ones before it have left."""


def keep_only(*shapes: Shape) -> Selection:
    """The selection of everything outside the shapes: removing it leaves only what lies in one of them."""
    return (*(Step("add", shape) for shape in shapes), INVERT)


def split_bodies(gaussians: Gaussians) -> tuple[Selection, ...]:
    """For each separate body of a capture, the selection of everything else; bodies with the most Gaussians first.

    Empty if there are fewer than two bodies: there is nothing to remove.
    """
    return tuple(keep_only(BodyAt(point)) for point in find_bodies(gaussians).points)


def take_step(gaussians: Gaussians, selected: NDArray[np.bool_], step: Step) -> NDArray[np.bool_]:
    """(N,). What is selected after one more step; `selected` (N,) stays as it is."""
    if step.operation == "invert":
        return ~selected
    if step.operation == "grow":
        return grow(gaussians, selected)
    assert step.shape is not None
    inside = _contained(gaussians, step.shape)
    return selected | inside if step.operation == "add" else selected & ~inside


def removed(gaussians: Gaussians, isolation: Isolation) -> NDArray[np.bool_]:
    """(N,). Which Gaussians of the whole capture the isolation takes away."""
    result = np.zeros(len(gaussians), bool)
    for rows in _removed_in_turn(gaussians, isolation):
        result[rows] = True
    return result


def without_surroundings(gaussians: Gaussians) -> Gaussians:
    """The object and its floor: they tell which way is up, whatever else of the capture is left out."""
    around = removed(gaussians, (NO_SURROUNDINGS,))
    return gaussians[~around] if around.any() else gaussians


def isolated(gaussians: Gaussians, isolation: Isolation, name: str) -> tuple[Gaussians, list[str]]:
    """What the isolation leaves of a capture, and a sentence on what it took and on each selection that took nothing.

    Raises InputError, which begins with `name`, if nothing is left.
    """
    gone, notes = np.zeros(len(gaussians), bool), []
    for number, rows in enumerate(_removed_in_turn(gaussians, isolation)):
        gone[rows] = True
        if not len(rows):
            notes.append(NOTHING_TO_LEAVE_OUT.get(isolation[number], "a part to leave out holds nothing of it"))
    if gone.all():
        raise InputError(f"{name}: nothing is left of its {len(gaussians)} Gaussians; keep more, or remove less")
    if gone.any():
        notes.append(f"{int(gone.sum())} of {len(gone)} Gaussians are no part of the object")
    return gaussians[~gone] if gone.any() else gaussians, notes


def _removed_in_turn(gaussians: Gaussians, isolation: Isolation) -> Iterator[NDArray[np.intp]]:
    """The rows that each selection takes from what the ones before it have left."""
    left = np.arange(len(gaussians))
    for selection in isolation:
        rest = gaussians[left]
        selected = np.zeros(len(rest), bool)
        for step in selection:
            selected = take_step(rest, selected, step)
        yield left[selected]
        left = left[~selected]


def _contained(gaussians: Gaussians, shape: Shape) -> NDArray[np.bool_]:
    """(N,). Which Gaussians have their centres in a shape."""
    if isinstance(shape, BodyAt):
        return _body_at(gaussians, shape.point)
    if not isinstance(shape, Detected):
        return shape.contains(gaussians.means)
    if shape.kind == "surroundings":
        middle = object_ball(gaussians)
        return np.zeros(len(gaussians), bool) if middle is None else ~Sphere(*middle).contains(gaussians.means)
    if shape.kind == "floor":
        floor = find_floor(gaussians)
        return np.zeros(len(gaussians), bool) if floor is None else Below(floor).contains(gaussians.means)
    haze, fragments = haze_and_fragments(gaussians)
    return haze if shape.kind == "haze" else fragments


def _body_at(gaussians: Gaussians, point: Vec3) -> NDArray[np.bool_]:
    """(N,). Which Gaussians belong to the same separate body as the one nearest to a point."""
    labels = find_bodies(gaussians).labels
    if not labels.any():
        return np.ones(len(gaussians), bool)
    squares = ((gaussians.means.astype(np.float64) - point) ** 2).sum(1)
    return labels == labels[np.where(np.isfinite(squares), squares, np.inf).argmin()]
