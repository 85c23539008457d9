"""Families of cut planes: the paper's cross-section types (section 3.2, figure 3, appendix A)."""

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
from training.faces.marks import UNMARKED, Marks

__all__ = ["COUNTS", "Family", "Kind"]

Kind = Literal["horizontal", "radial", "parallel", "custom"]

# The paper's appendix: 40 horizontal, 30 radial, 60 parallel slices (bread).
COUNTS: dict[Kind, int] = {"horizontal": 40, "radial": 30, "parallel": 60, "custom": 0}

MAX_PLANES = 10_000
"""Largest number of planes in a family: 10,000 are closer together than the finest atoms."""


MAX_TILT = np.radians(15)
"""Tilt in radians up to which a plane counts as level or upright: people do not cut more precisely."""

NEAR_AXIS = 0.05
"""Distance from the axis, as a fraction of the body's smallest extent, up to which an upright cut counts as radial."""


@dataclass(frozen=True)
class Family:
    """Cut planes of one kind, with exemplar pictures and a prompt for their cut faces."""

    kind: Kind
    count: int
    """Number of trained planes; not used by `custom`."""
    exemplars: tuple[Path, ...] = ()
    """Pictures of cut faces of this family; the up axis points upwards in radial and parallel ones."""
    prompt: str = ""
    axis: tuple[float, float, float] | None = None
    """Normal of a `parallel` family; None: the longest horizontal extent of the body."""
    custom: tuple[Plane, ...] = field(default=())
    """The planes of a `custom` family."""
    span: tuple[float, float] = (0.0, 1.0)
    """Part of the body's extent along the normal, or of the 180 degrees of a `radial` family, that the planes cover."""
    marks: tuple[tuple[Path, Marks], ...] = ()
    """The user's marks on the faces in some of the exemplars, by path."""

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

    def marks_of(self, exemplar: Path) -> Marks:
        """The user's marks on the face in one of the pictures."""
        return dict(self.marks).get(exemplar, UNMARKED)

    def with_marks(self, exemplar: Path, marks: Marks) -> Family:
        """A copy in which the marks of one picture are replaced."""
        others = {path: kept for path, kept in self.marks if path != exemplar and path in self.exemplars}
        if marks != UNMARKED:
            others[exemplar] = marks
        return replace(self, marks=tuple(sorted(others.items())))

    def normal(self, body: Body, up: NDArray[np.float64]) -> NDArray[np.float64]:
        """(3,). The common normal of a horizontal or parallel family."""
        if self.kind == "horizontal":
            return up
        if self.axis is not None:
            return np.asarray(self.axis, np.float64) / np.linalg.norm(self.axis)
        points, (e1, e2) = body.points, equator(up)
        return e1 if np.ptp(points @ e1) >= np.ptp(points @ e2) else e2

    def as_standard_kind(self, body: Body, up: NDArray[np.float64]) -> Family:
        """A custom family as the horizontal, radial or parallel one that fits its first plane; others unchanged.

        The kind decides how pictures are interpreted: an upright plane near the axis, for example, as a radial cut.
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
        """The planes to train: evenly spaced through the body, or by angle for a radial family, within `span`.

        Horizontal and parallel planes bisect `count` equal slabs, so that none is tangent to the body. Radial planes
        start each of `count` equal angles, as the plane at 180 degrees equals that at 0.
        """
        if self.kind == "custom":
            return list(self.custom)
        centre = body.bounds().mean(0)
        if self.kind == "radial":
            e1, e2 = equator(up)
            angles = np.pi * self._positions(0.0)
            return [Plane.through(centre, np.cross(np.cos(a) * e1 + np.sin(a) * e2, up)) for a in angles]
        normal = self.normal(body, up)
        along = body.points @ normal
        low, high = (float(along.min()), float(along.max())) if len(along) else (0.0, 0.0)
        steps = low + (high - low) * self._positions(0.5)
        return [Plane.of(normal, -float(s)) for s in steps]

    def _positions(self, offset: float) -> NDArray[np.float64]:
        """(count,). Positions of the planes in [0, 1]: at `offset` of each of `count` equal steps of `span`."""
        low, high = self.span
        return low + (high - low) * (np.arange(self.count) + offset) / self.count
