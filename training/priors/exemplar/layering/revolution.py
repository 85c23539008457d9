"""Turns a radial picture about the axis, if all pictures are radial."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.correction import radial_position
from training.priors.exemplar.layering.grain import SWING, Grain, Strata
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.layering.sheet import GROUND, STRUCTURE, TEXTURE, THROUGH, Sheet
from training.priors.exemplar.record import MOST_SEED, RecordReader, nested
from training.priors.exemplar.sampling import smoothstep
from training.priors.exemplar.strata import Fan, Rows, beside_own

__all__ = ["Revolution"]

OVERLAP = 0.3
"""Sine of the angle, to either side of the plane between the halves, over which they blend."""


@dataclass(frozen=True)
class Revolution:
    """The halves of a radial picture, each revolved about the axis by half a turn, with texture in layers around it."""

    shape: Shape
    sheet: Sheet
    grain: Grain
    seed: int
    """Seed of the texture's layers."""

    def reduced(self, n: int) -> Revolution:
        """The same revolution with pixels n times as large in its picture."""
        return replace(self, sheet=self.sheet.reduced(n))

    @cached_property
    def _fan(self) -> Fan:
        return Fan(self.grain.thickness, self.shape.widest)

    @cached_property
    def _strata(self) -> Strata:
        return Strata(self._fan.count, self.grain.thickness / self.shape.widest, self.seed)

    @property
    def own_normal(self) -> NDArray[np.float64]:
        """(3,). Normal of the own plane: the one through the axis in which the picture is shown as it is."""
        return self.shape.basis[1]

    def position(self, places: Places) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,), (M,). Place in the picture, cells, of points in the own plane."""
        return radial_position(self.sheet, self.sheet.rind, places, self.shape, places.side)

    def read(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). Colours. Range [0, 1]."""
        rgb = np.zeros((len(places.angle), 3), np.float32)
        for side, share in self._halves(places):
            rows = np.flatnonzero(share)
            rgb[rows] += share[rows, None] * self._half(places.of(rows), side)
        return np.clip(rgb, 0, 1)

    def structures(self, places: Places) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """(M,) and (M,). Opacity of the structures at points, and whether they end in the body."""
        opacity = np.zeros(len(places.angle), np.float32)
        for side, share in self._halves(places):
            x, y = radial_position(self.sheet, self.sheet.rind, places, self.shape, side)
            opacity += share * self.sheet.read(x, y, STRUCTURE)[:, 0]
        return opacity, np.zeros(len(opacity), bool)

    def _halves(self, places: Places) -> tuple[tuple[int, NDArray[np.floating]], ...]:
        """The right half (1) and the left one (-1), each with its share (M,) in what the points show."""
        right = smoothstep(np.cos(places.angle), -OVERLAP, OVERLAP)
        return (1, right), (-1, 1 - right)

    def _half(self, places: Places, side: int) -> NDArray[np.float32]:
        """(M, 3). Colours of the right (side 1) or left (-1) half at points."""
        x, y = radial_position(self.sheet, self.sheet.rind, places, self.shape, side)
        straight = self.sheet.read(x, y, slice(0, THROUGH.stop))
        bare = straight[:, GROUND] + self._texture(places, x, y)
        return bare + straight[:, STRUCTURE] * (straight[:, THROUGH] - bare)

    def _texture(self, places: Places, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M, 3). The texture of points that show the picture at x and y."""
        shape, strata, grain = self.shape, self._strata, self.grain
        swing = SWING * self.sheet.inradius * shape.inradius * np.array([grain.share_a, grain.share_b])
        points = np.concatenate([places.place / shape.widest, places.height[:, None]], axis=1)
        waves, turn = strata.waves.at(points), places.angle / (2 * np.pi)

        def read(layer: NDArray[np.int64], rows: Rows) -> NDArray[np.float32]:
            u, v = swing[:, None] * strata.draw(layer)
            return self.sheet.read(x[rows] + u, y[rows] + v, TEXTURE)

        own = self.sheet.read(x, y, TEXTURE)
        return beside_own(self._fan.read(places.away, turn, waves, read), own, places.place[:, 1] / grain.thickness)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same revolution."""
        arrays, facts = nested({"sheet": self.sheet.record()})
        return arrays, facts | {"grain": asdict(self.grain), "seed": self.seed}

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Revolution:
        """The revolution in a `record`. Raises ValueError if the record is not valid."""
        return cls(
            shape,
            Sheet.restored(record.part("sheet")),
            Grain.restored(record.part("grain")),
            record.count("seed", MOST_SEED),
        )
