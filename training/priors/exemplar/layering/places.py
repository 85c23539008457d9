"""Points of a body in coordinates that follow its shape, which a few tables describe."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.frames import (
    DIRECTIONS,
    MIN_SLICE_SHARE,
    Space,
    View,
    read_reach,
    read_rims,
    rim_table,
    turn_of,
)
from training.priors.exemplar.outline import ANGLES
from training.priors.exemplar.patches import FIXED
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.sampling import read_trilinear

__all__ = ["Places", "Shape"]

DEPTH_STEP = 2
"""Cells of the space between two samples of the depth. A distance is nearly linear: between samples it errs by a
hundredth of a cell at a skin of any radius that cuts show, and by half a cell in the sharpest corner."""

FAR_OUTSIDE = -6.0
"""Least depth that is stored, in cells; it is negative outside the skin."""

FLAT_END_SHARE = 0.4
"""Least area of an end slice, over that of the widest slice, at which the end counts as cut off flat."""


@dataclass(frozen=True)
class Places:
    """Points (M,) of a body. Lengths are in cells, unless said otherwise."""

    depth: NDArray[np.float32]
    """(M,). Depth under the skin over the body's inradius, at least 0."""
    across: NDArray[np.float32]
    """(M,). Distance from the up axis over `Space.reach` in the point's direction."""
    height: NDArray[np.float32]
    """(M,). Height along the up axis, range [-1, 1] over the body."""
    place: NDArray[np.float32]
    """(M, 2). Position in a slice across the axis that a picture is carried along, from the slices' common centre; in
    the proportions of that picture."""
    away: NDArray[np.float32]
    """(M,). Distance from that centre."""
    rim: NDArray[np.float32]
    """(M,). Distance of the skin from that centre at the point's angle and level."""
    level: NDArray[np.float32]
    """(M,). Position along that axis, from the lowest point of the body."""

    def of(self, rows: NDArray[np.intp]) -> Places:
        """The points of some rows."""
        return Places(*(getattr(self, part.name)[rows] for part in fields(self)))

    @property
    def share(self) -> NDArray[np.float32]:
        """(M,). Distance from the centre over that of the skin. Range [0, 1]."""
        return np.minimum(self.away / self.rim, 1)

    @property
    def side(self) -> NDArray[np.int64]:
        """(M,). Side of a radial picture on its own plane: 1 right, -1 left."""
        return np.where(self.place[:, 0] < 0, -1, 1)

    @property
    def angle(self) -> NDArray[np.float32]:
        """(M,). Angle around the axis in radians."""
        return np.arctan2(self.place[:, 1], self.place[:, 0])


@dataclass(frozen=True)
class Shape:
    """The shape of a body, from which the places of points in it are found. Lengths are in cells."""

    inradius: float
    reach: NDArray[np.float32]
    """`Space.reach`."""
    half_height: float
    """Half the height of the body along the up axis."""
    up_basis: NDArray[np.float64]
    """(3, 3). Rows e1, e2, up."""
    basis: NDArray[np.float64]
    """(3, 3). Rows: two directions in a slice, scaled so that it has the proportions of the picture, and the direction
    of the axis that the picture is carried along."""
    is_round: bool
    """Whether slices may be rotated: a round outline does not fix the angle."""
    lowest: float
    """Position of the lowest point along that axis, from the centre."""
    rims: NDArray[np.float32]
    """`rim_table` around that axis."""
    has_flat_ends: bool
    """Whether the body is cut off across that axis, as a limb is, and its ends show the inside."""
    corner: NDArray[np.float64]
    """(3,). Position of the first sample of `depth`, from the centre."""
    depth: NDArray[np.float16]
    """(X, Y, Z). Depth under the skin at every DEPTH_STEP cells, negative outside."""

    @classmethod
    def of(cls, space: Space, view: View) -> Shape:
        """The shape of a space for pictures of a view."""
        basis = view.basis * np.array([[view.stretch], [1 / view.stretch], [1]])
        planar = ((space.cells - space.centre) @ basis.T).astype(np.float32)
        lowest = planar[:, 2].min()
        rims = rim_table(planar, np.hypot(planar[:, 0], planar[:, 1]))
        areas = np.bincount(np.round(planar[:, 2] - lowest).astype(int))
        ends = np.flatnonzero(areas > MIN_SLICE_SHARE * areas.max())
        inward = 1 + len(ends) // 50  # beyond an edge that the grid rounds off
        smaller = min(areas[ends[inward]], areas[ends[-1 - inward]]) if len(ends) > 8 else 0
        depth = space.body.depth[::DEPTH_STEP, ::DEPTH_STEP, ::DEPTH_STEP] / space.body.grid.cell
        return cls(
            float(space.inradius),
            space.reach,
            space.half_height,
            space.basis,
            basis,
            view.kind != FIXED,
            float(lowest),
            rims.astype(np.float32),
            bool(smaller > FLAT_END_SHARE * areas.max()),
            -space.centre.astype(np.float64),
            np.maximum(depth, FAR_OUTSIDE).astype(np.float16),
        )

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same shape."""
        arrays = {name: getattr(self, name) for name in ("reach", "up_basis", "basis", "rims", "corner", "depth")}
        names = "inradius", "half_height", "is_round", "lowest", "has_flat_ends"
        return arrays, {name: getattr(self, name) for name in names}

    @classmethod
    def restored(cls, record: RecordReader) -> Shape:
        """The shape in a `record`. Raises ValueError if the record is not valid."""
        reach = record.array("reach", np.float32, (DIRECTIONS,))
        if not 1e-3 <= reach.min() <= reach.max() <= 1e5:
            raise ValueError("a wrong reach")
        return cls(
            record.number("inradius", 1e-3, 1e5),
            reach,
            record.number("half_height", 1e-3, 1e5),
            record.array("up_basis", np.float64, (3, 3)),
            record.array("basis", np.float64, (3, 3)),
            record.flag("is_round"),
            record.number("lowest", -1e5, 1e5),
            record.array("rims", np.float32, (None, ANGLES + 2)),
            record.flag("has_flat_ends"),
            record.array("corner", np.float64, (3,)),
            record.array("depth", np.float16, (None, None, None)),
        )

    @property
    def widest(self) -> float:
        """Largest distance of the skin from the up axis."""
        return float(self.reach.max())

    @cached_property
    def _samples(self) -> NDArray[np.float32]:
        """(X, Y, Z, 1). The depth in the data type of the kernels."""
        return self.depth.astype(np.float32)[..., None]

    def places(self, points: NDArray[np.float64]) -> Places:
        """The places of points (M, 3) in cells from the body's centre, along the axes of its grid."""
        depth = read_trilinear(self._samples, ((points - self.corner) / DEPTH_STEP).astype(np.float32))
        upright = (points @ self.up_basis.T).astype(np.float32)
        planar = (points @ self.basis.T).astype(np.float32)
        away = np.hypot(planar[:, 0], planar[:, 1])
        level = planar[:, 2] - np.float32(self.lowest)
        return Places(
            np.maximum(depth[:, 0] / np.float32(self.inradius), 0),
            (np.hypot(upright[:, 0], upright[:, 1]) / read_reach(self.reach, turn_of(upright))).astype(np.float32),
            np.clip(upright[:, 2] / np.float32(self.half_height), -1, 1),
            planar[:, :2],
            away,
            read_rims(self.rims, level, turn_of(planar), away),
            level,
        )
