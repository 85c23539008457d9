"""Families of cut planes: what the paper calls cross-section types (section 3.2, figure 3, appendix A)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.scene.camera import equator
from engine.scene.grid import Body
from engine.scene.plane import Plane

__all__ = ["COUNTS", "Family", "Kind"]

Kind = Literal["horizontal", "radial", "parallel", "custom"]

# The paper's appendix: 40 horizontal, 30 radial, 60 parallel slices (bread).
COUNTS: dict[Kind, int] = {"horizontal": 40, "radial": 30, "parallel": 60, "custom": 0}

MAX_PLANES = 10_000
"""Planes of a family. At 10,000 they stand closer than any atom is small, and each costs a label picture."""


MAX_TILT = np.radians(15)
"""Angle up to which a plane counts as level or upright: people do not cut straighter."""

NEAR_AXIS = 0.05
"""Distance from the axis, over the body's least extent, up to which an upright cut is one through it."""


@dataclass(frozen=True)
class Family:
    """Cut planes of one kind, with the pictures and the words that say what they show."""

    kind: Kind
    count: int
    """How many planes are trained; not used by `custom`."""
    exemplars: tuple[Path, ...] = ()
    """Pictures of cut faces of this family; the up axis stands upwards in radial and parallel ones."""
    prompt: str = ""
    axis: tuple[float, float, float] | None = None
    """Normal of a `parallel` family; None: the longest horizontal extent of the body."""
    custom: tuple[Plane, ...] = field(default=())
    """The planes of a `custom` family."""
    span: tuple[float, float] = (0.0, 1.0)
    """Part of the body's extent along the normal, or of the 180 degrees of a `radial` family, in which planes stand."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InputError(f"family '{self.kind}': unknown; choose {', '.join(get_args(Kind))}")
        if self.kind != "custom" and self.count < 1:
            raise InputError(f"family '{self.kind}': {self.count} planes; give at least 1")
        if self.count > MAX_PLANES:
            raise InputError(f"family '{self.kind}': {self.count:,} planes; give at most {MAX_PLANES:,}")
        if not 0 <= self.span[0] < self.span[1] <= 1:
            low, high = self.span
            raise InputError(f"family '{self.kind}': range {low:g}..{high:g}; give parts of the whole, as in 0.2..0.8")
        if self.kind == "custom" and not self.custom:
            raise InputError("family 'custom': no planes; give each as custom:a,b,c,d")

    def normal(self, body: Body, up: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,). The common normal of a horizontal or parallel family."""
        if self.kind == "horizontal":
            return up
        if self.axis is not None:
            return np.asarray(self.axis, np.float64) / np.linalg.norm(self.axis)
        low, high = body.bounds()
        e1, e2 = equator(up)
        return e1 if abs((high - low) @ e1) >= abs((high - low) @ e2) else e2

    def as_standard_kind(self, body: Body, up: NDArray[np.float64]) -> Family:
        """A custom family as the horizontal, radial or parallel one whose planes are like its first; others unchanged.

        That tells how its pictures are to be read: of a plane along the axis and near it, as a radial cut.
        """
        if self.kind != "custom":
            return self
        plane = self.custom[0]
        along_up = abs(float(plane.normal @ up))
        low, high = body.bounds()
        axis_distance = abs(float(plane.normal @ (low + high) / 2 + plane.offset))
        kind: Kind = "parallel"
        if along_up > np.cos(MAX_TILT):
            kind = "horizontal"
        elif along_up < np.sin(MAX_TILT) and axis_distance < NEAR_AXIS * float((high - low).min()):
            kind = "radial"
        x, y, z = map(float, plane.normal)
        return replace(
            self, kind=kind, count=len(self.custom), custom=(), axis=(x, y, z) if kind == "parallel" else None
        )

    def planes(self, body: Body, up: NDArray[np.float64]) -> list[Plane]:
        """The planes to train. Stacks are spaced evenly through the body, radial ones evenly over 180 degrees, or over
        the part of it that `span` says.

        A stack's planes stand in the middle of `count` equal slabs, so none is tangent to the body; radial planes stand
        at the beginning of `count` equal angles, for the end of 180 degrees is their beginning.
        """
        if self.kind == "custom":
            return list(self.custom)
        centre = body.bounds().mean(0)
        if self.kind == "radial":
            e1, e2 = equator(up)
            angles = np.pi * self._positions(0.0)
            return [Plane.through(centre, np.cross(np.cos(a) * e1 + np.sin(a) * e2, up)) for a in angles]
        normal = self.normal(body, up)
        along = body.centres()[body.inside] @ normal
        low, high = (float(along.min()), float(along.max())) if len(along) else (0.0, 0.0)
        steps = low + (high - low) * self._positions(0.5)
        return [Plane.of(normal, -float(s)) for s in steps]

    def _positions(self, offset: float) -> NDArray[np.float64]:
        """(count,). Where in [0, 1] the planes stand: in each of `count` equal steps of `span`, `offset` of the way."""
        low, high = self.span
        return low + (high - low) * (np.arange(self.count) + offset) / self.count
