"""The grain of a picture's texture, which sets how thin its layers are and how far each may shift it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.layering.decompose import Layers
from training.priors.exemplar.record import RecordReader
from training.priors.exemplar.strata import LAYER, Waves

__all__ = ["SWING", "Grain", "Strata"]

SWING = 0.12
"""Largest shift of a layer's texture to either side, in inradii of the picture."""

THINNEST = 1.0
"""Least thickness of a layer, in cells, that the grid resolves."""

MOST_LAYERS = 10_000


@dataclass(frozen=True)
class Grain:
    """How texture continues in the direction that its picture does not show."""

    thickness: float
    """Thickness of a layer, in cells."""
    share_a: float
    """Share of SWING along the picture's direction a, as `share_b` along b: rings and stripes are cut shells and
    sheets, which continue unchanged."""
    share_b: float

    @classmethod
    def of(cls, pictures: Sequence[Layers], across: Sequence[Layers], turns: bool) -> Grain:
        """The grain that pictures `across` show in that direction; without any, the pictures' own mean grain, but for
        rings the grain along them. `turns`: whether layers are turned, which is a swing along b."""
        deviation, a, b = np.mean([p.spread for p in pictures], axis=0)
        share_a = share_b = 1.0
        if across:
            deviation, _, slope = np.mean([p.spread for p in across], axis=0)
        else:
            share_a, share_b = min(b / a, 1.0), 1.0 if turns else min(a / b, 1.0)
            slope = np.hypot(share_a * a, share_b * b) / np.sqrt(2)
        thickness = LAYER * deviation / slope
        return cls(float(np.clip(thickness, THINNEST, 1e4)), float(share_a), float(share_b))

    @classmethod
    def restored(cls, record: RecordReader) -> Grain:
        """The grain in a `record`. Raises ValueError if the record is not valid."""
        numbers = (
            record.number("thickness", THINNEST, 1e4),
            record.number("share_a", 0, 1),
            record.number("share_b", 0, 1),
        )
        return cls(*numbers)


class Strata:
    """The layers of a body's texture, drawn at random."""

    def __init__(self, count: int, thickness: float, seed: int) -> None:
        """`thickness`: of each of the `count` layers, in radii of the body."""
        self.count = min(count, MOST_LAYERS)
        rng = np.random.default_rng(seed)
        self.phases: list[float] = rng.uniform(0, 2 * np.pi, 2).tolist()
        """Two random phases, in radians."""
        self.waves = Waves(thickness, rng)
        self._draws = rng.uniform(-1, 1, (self.count, 2))

    def draw(self, layer: NDArray[np.int64]) -> NDArray[np.float64]:
        """(2, R). Two random numbers for each layer (R,). Range [-1, 1]."""
        return self._draws[layer % self.count].T
