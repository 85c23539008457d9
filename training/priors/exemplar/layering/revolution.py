"""Turns a radial picture about the axis, where it is all there is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.layering.correction import radial_position
from training.priors.exemplar.layering.extrusion import SWING, triangle
from training.priors.exemplar.layering.places import Places, Shape
from training.priors.exemplar.layering.sheet import GROUND, STRUCTURE, TEXTURE, THROUGH, Sheet
from training.priors.exemplar.record import RecordReader, nested

__all__ = ["Revolution"]


@dataclass(frozen=True)
class Revolution:
    """The right half of a radial picture revolved about the axis; its texture drifts, or it would show rings."""

    shape: Shape
    sheet: Sheet
    times: int
    """Periods of the drift around the axis."""
    phases: NDArray[np.float64]
    """(4,). Turns."""

    @classmethod
    def of(cls, shape: Shape, sheet: Sheet, rim: float, rng: np.random.Generator) -> Revolution:
        """In a body whose skin is usually this far from the axis, cells."""
        # A whole number of periods around the axis; the drift is as fast as the texture is fine at half the radius.
        times = max(3, round(np.pi * rim / (4 * SWING * sheet.inradius * shape.inradius)))
        return cls(shape, sheet, times, rng.uniform(0, 1, 4))

    @property
    def sheets(self) -> list[Sheet]:
        """All that it reads."""
        return [self.sheet]

    def reduced(self, n: int) -> Revolution:
        """The same of a picture with pixels n times as large."""
        return replace(self, sheet=self.sheet.reduced(n))

    def read(self, places: Places) -> NDArray[np.float32]:
        """(M, 3). Colours. Range [0, 1]."""
        sheet, phases = self.sheet, self.phases.tolist()
        swing = SWING * sheet.inradius * self.shape.inradius
        x, y = radial_position(sheet, places, self.shape)
        turn = places.angle / (2 * np.pi)
        # Phases vary with height and radius, so that no face repeats itself.
        u = swing * triangle(self.times * turn + phases[0] + 0.3 * np.sin(places.height * 4 + phases[1]))
        v = swing * triangle((self.times + 1) * turn + phases[2] + 0.3 * np.sin(places.radius / swing + phases[3]))
        straight = sheet.read(x, y, slice(0, THROUGH.stop))
        bare = straight[:, GROUND] + sheet.read(x + u, y + v, TEXTURE)
        return np.clip(bare + straight[:, STRUCTURE] * (straight[:, THROUGH] - bare), 0, 1)

    def record(self) -> InsideRecord:
        """Arrays and facts from which `restored` makes the same."""
        arrays, facts = nested({"sheet": self.sheet.record()})
        return arrays | {"phases": self.phases}, facts | {"times": self.times}

    @classmethod
    def restored(cls, record: RecordReader, shape: Shape) -> Revolution:
        """That of a `record`. Raises ValueError if it is none."""
        sheet = Sheet.restored(record.part("sheet"))
        return cls(shape, sheet, record.count("times", 10_000), record.array("phases", np.float64, (4,)))
