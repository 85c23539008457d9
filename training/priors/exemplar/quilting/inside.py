"""A quilt in the space of the object it was made for: read at any place, stored in a file and restored from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from engine.threads import side_by_side
from training.priors.exemplar.frames import Space
from training.priors.exemplar.quilting.disc import DISC_PIXELS, PIXEL, BallMap, Disc
from training.priors.exemplar.quilting.kinds import QuiltKinds
from training.priors.exemplar.quilting.quilt import BLOCK, Quilt, restore_quilt
from training.priors.exemplar.record import MOST_SEED, MOST_SHEETS, RecordReader

__all__ = ["FILM", "QUILT", "QuiltInside"]

QUILT = "quilt 11"
"""Kind of the record. Earlier kinds had the same arrays but were other insides, from which their atoms were made."""

COARSEST = 16
"""How many times larger than a disc's pixels those of its coarsest version are: a power of two that divides
DISC_PIXELS."""

FILM = 0.75
"""Cells by which own planes are thicker than the footprint where they show what is not beside them: half way up an
object is known within half a cell. Of two pairs of pomegranates, cuts half a cell beside the horizontal picture's plane
have an SSIM with it of 0.80 and 0.84 with 0 cells, 0.92 and 0.96 with half a cell, 0.93 and 0.97 from 0.75 on; and in
cuts across it, what is thicker is a line."""

FAMILIES = "horizontal", "radial"
"""Names of the arrays that hold the pictures."""


@dataclass(frozen=True)
class QuiltInside:
    """An inside that is quilted from photographs; its record has these, the layout of their chunks and a seed."""

    quilt: Quilt
    horizontal: Sequence[Disc]
    radial: Sequence[Disc]
    seed: int
    ball: BallMap
    origin: NDArray[np.float64]
    """(3,). World point half way up the axis."""
    basis: NDArray[np.float64]
    """(3, 3). Rows e1, e2, up."""
    cell: float
    """Edge of a cell, world units."""
    _reduced: dict[int, Quilt] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def of(
        cls,
        space: Space,
        ball: BallMap,
        quilt: Quilt,
        horizontal: Sequence[Disc],
        radial: Sequence[Disc],
        seed: int,
    ) -> QuiltInside:
        """The quilt of these discs with this seed, in a body."""
        grid = space.body.grid
        origin = np.asarray(grid.origin) + (space.centre.astype(np.float64) + 0.5) * grid.cell
        return cls(quilt, horizontal, radial, seed, ball, origin, space.basis, float(grid.cell))

    @property
    def detail(self) -> float:
        """World units. See `engine.scene.inside.Inside`."""
        return PIXEL * self._radius

    @property
    def _radius(self) -> float:
        """World units. A radius of the ball, as far as the body is one."""
        return float(self.ball.skin.mean()) * self.cell

    def _film(self, footprint: float) -> float:
        """Radii. How thick own planes are where they show what is not beside them."""
        return (footprint + FILM * self.cell) / self._radius

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). See `engine.scene.inside.Inside`."""
        n = 1
        while n < COARSEST and 2 * n * self.detail <= footprint:
            n *= 2
        if n not in self._reduced:
            self._reduced[n] = self.quilt.reduced(n) if n > 1 else self.quilt
        return self._reduced[n].read(self.ball.to_ball(self._planar(points)), self._film(footprint))

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(N,). See `engine.scene.inside.Inside`."""
        kinds = self._kinds
        blocks = [points[start : start + BLOCK] for start in range(0, len(points), BLOCK)]
        found = side_by_side(lambda block: kinds.at(self.ball.to_ball(self._planar(block)), self._film(0)), blocks)
        return np.concatenate([np.empty(0, np.uint8), *found])

    @cached_property
    def _kinds(self) -> QuiltKinds:
        return QuiltKinds(self.quilt)

    def _planar(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(N, 3). World points (N, 3) along the rows of `basis` from `origin`, in cells."""
        # Not by `@`, whose threads keep looking for work for 30 ms, on cores that the reading needs.
        return (np.einsum("nk,ik->ni", points - self.origin, self.basis) / self.cell).astype(np.float32)

    def record(self) -> InsideRecord:
        """Arrays and JSON facts from which `restored` makes the same inside."""
        families = zip(FAMILIES, (self.horizontal, self.radial), strict=True)
        arrays: dict[str, NDArray[Any]] = {
            name: np.stack([disc.to_bytes() for disc in discs]) for name, discs in families if discs
        }
        arrays |= {"chosen": self.quilt.chosen.astype(np.uint8), "skin": self.ball.skin, "stretch": self.ball.stretch}
        arrays |= {"origin": self.origin, "basis": self.basis}
        return arrays, {"kind": QUILT, "seed": self.seed, "rise": self.ball.rise, "cell": self.cell}

    @classmethod
    def restored(cls, record: RecordReader) -> QuiltInside:
        """The inside in a `record`. Raises ValueError if the record is not valid."""
        skin = record.array("skin", np.float64, (None, None))
        if min(skin.shape) < 4 or max(skin.shape) > 1000 or skin.min() <= 0:
            raise ValueError("a wrong skin")
        shape = (None, DISC_PIXELS, DISC_PIXELS, 3)
        families = {name: record.array(name, np.uint8, shape) for name in FAMILIES if name in record.arrays}
        if not 0 < sum(len(family) for family in families.values()) <= MOST_SHEETS:
            raise ValueError("no pictures, or too many")
        horizontal, radial = ([Disc.of_bytes(rgb) for rgb in families.get(name, ())] for name in FAMILIES)
        chosen, seed = record.array("chosen", np.uint8, (None,)), record.count("seed", MOST_SEED)
        stretch = record.array("stretch", np.float64, (3,))
        if stretch.min() <= 0:
            raise ValueError("a wrong stretch")
        ball = BallMap(record.number("rise"), stretch, skin)
        origin, basis = record.array("origin", np.float64, (3,)), record.array("basis", np.float64, (3, 3))
        cell = record.number("cell", 1e-12)
        quilt = restore_quilt(horizontal, radial, seed, ball.height, chosen.astype(np.int32))
        return cls(quilt, horizontal, radial, seed, ball, origin, basis, cell)
