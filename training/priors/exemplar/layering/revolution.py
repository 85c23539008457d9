"""Turns a radial picture about the axis, where it is all there is."""

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
from training.priors.exemplar.strata import read_layers

__all__ = ["Revolution"]


@dataclass(frozen=True)
class Revolution:
    """The right half of a radial picture revolved about the axis, its texture in layers around it."""

    shape: Shape
    sheet: Sheet
    grain: Grain
    rim: float
    """Usual distance of the skin from the axis, cells."""
    seed: int
    """Of the layers."""

    @property
    def sheets(self) -> list[Sheet]:
        """All that it reads."""
        return [self.sheet]

    def reduced(self, n: int) -> Revolution:
        """The same of a picture with pixels n times as large."""
        return replace(self, sheet=self.sheet.reduced(n))

    @cached_property
    def _strata(self) -> Strata:
        # As thick as the grain is long at half the radius.
        count = max(int(np.pi * self.rim / self.grain.thickness), 3)
        return Strata(count, self.grain.thickness / self.shape.widest, self.seed)

    def read(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). Colours. Range [0, 1]."""
        x, y = radial_position(self.sheet, places, self.shape)
        straight = self.sheet.read(x, y, slice(0, THROUGH.stop))
        bare = straight[:, GROUND] + self._texture(places, x, y)
        return np.clip(bare + straight[:, STRUCTURE] * (straight[:, THROUGH] - bare), 0, 1)

    def _texture(self, places: Places, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M, 3). The texture of points that show the picture at x and y."""
        shape, strata = self.shape, self._strata
        swing = SWING * self.sheet.inradius * shape.inradius * np.array([self.grain.share_a, self.grain.share_b])
        points = np.concatenate([places.place / shape.widest, places.height[:, None]], axis=1)
        height = places.angle / (2 * np.pi) * strata.count + strata.waves.at(points)

        def read(layer: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.float32]:
            u, v = swing[:, None] * strata.draw(layer)
            return self.sheet.read(x[rows] + u, y[rows] + v, TEXTURE)

        return read_layers(height, read)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same."""
        arrays, facts = nested({"sheet": self.sheet.record()})
        return arrays, facts | {"grain": asdict(self.grain), "rim": self.rim, "seed": self.seed}

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Revolution:
        """That of a `record`. Raises ValueError if it is none."""
        return cls(
            shape,
            Sheet.restored(record.part("sheet")),
            Grain.restored(record.part("grain")),
            record.number("rim", 0, 1e5),
            record.count("seed", MOST_SEED),
        )
