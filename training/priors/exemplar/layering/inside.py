"""The inside of a body whose pictures show one thing: read at any place, stored in a file and restored from it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord, Kind
from engine.threads import side_by_side
from training.priors.exemplar.frames import Space
from training.priors.exemplar.layering.extrusion import Extrusion
from training.priors.exemplar.layering.morph import Slices
from training.priors.exemplar.layering.places import Shape
from training.priors.exemplar.layering.revolution import Revolution
from training.priors.exemplar.layering.stamps import Stamps
from training.priors.exemplar.patches import OVER
from training.priors.exemplar.record import RecordReader, nested

__all__ = ["LAYERS", "LayeredInside"]

LAYERS = "layers 2"
"""Kind of the record. The earlier kind had the same arrays but was another inside, from which its atoms were made."""

COARSEST = 16
"""How many times larger than a picture's pixels those of its coarsest version are."""

BLOCK = 25_000
"""Points that a thread reads at once: bounds the memory of intermediate results, and few enough that many cores share
a face."""

VISIBLE = 0.05
"""Least change of a colour by which a stamp shows: a seed's soft edge belongs to it up to a tenth of its contrast."""

SOLID = 0.5
"""Least opacity of a structure that is there."""

COURSES: dict[str, type[Extrusion] | type[Revolution] | type[Slices]] = {
    "extrusion": Extrusion,
    "revolution": Revolution,
    "slices": Slices,
}
"""Ways in which pictures continue through a body, by their names in a file."""


@dataclass(frozen=True)
class LayeredInside:
    """Layers of pictures that continue through a body, and the details that end in it."""

    shape: Shape
    course: Extrusion | Revolution | Slices
    stamps: Stamps | None
    origin: NDArray[np.float64]
    """(3,). World point of the body's centre."""
    grid_centre: NDArray[np.float64]
    """(3,). The same point in cells of the grid that the details were placed in."""
    cell: float
    """Edge of a cell of that grid, world units."""
    _reduced: dict[int, LayeredInside] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, space: Space, course: Extrusion | Revolution | Slices) -> LayeredInside:
        """The inside of a body through which pictures take this `course`, without details."""
        grid, centre = space.body.grid, space.centre.astype(np.float64)
        origin = np.asarray(grid.origin) + (centre + 0.5) * grid.cell
        return cls(course.shape, course, None, origin, centre, float(grid.cell))

    @property
    def detail(self) -> float:
        """World units. See `engine.scene.inside.Inside`."""
        return self.cell / OVER

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). See `engine.scene.inside.Inside`."""
        n = 1
        while n < COARSEST and 2 * n * self.detail <= footprint:
            n *= 2
        if n not in self._reduced:
            stamps = None if self.stamps is None else self.stamps.reduced(n)
            self._reduced[n] = self if n == 1 else replace(self, course=self.course.reduced(n), stamps=stamps)
        blocks = [points[start : start + BLOCK] for start in range(0, len(points), BLOCK)]
        return np.concatenate([np.empty((0, 3), np.float32), *side_by_side(self._reduced[n]._read, blocks)])

    def _read(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M, 3). Colours at world points."""
        cells = (points - self.origin) / self.cell
        rgb = np.asarray(self.course.read(self.shape.places(cells)), np.float32)
        if self.stamps is not None:
            self.stamps.paint(rgb, (cells + self.grid_centre).astype(np.float32))
        return np.clip(rgb, 0, 1)

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(N,). See `engine.scene.inside.Inside`. A thing is what a stamp paints visibly, or a structure that ends;
        pictures that morph into one another have no rind or structures of their own."""
        out = np.full(len(points), Kind.INSIDE, np.uint8)
        for start in range(0, len(points), BLOCK):
            cells = (points[start : start + BLOCK] - self.origin) / self.cell
            places, block = self.shape.places(cells), out[start : start + BLOCK]
            if not isinstance(self.course, Slices):
                opacity, ends = self.course.structures(places)
                block[opacity > SOLID] = Kind.STRUCTURE
                block[(opacity > SOLID) & ends] = Kind.THING
                block[places.depth <= self.course.sheet.rind] = Kind.RIND
            if self.stamps is not None:
                plain = np.asarray(self.course.read(places), np.float32)
                painted = plain.copy()
                self.stamps.paint(painted, (cells + self.grid_centre).astype(np.float32))
                block[np.abs(painted - plain).max(1) > VISIBLE] = Kind.THING
        return out

    def record(self) -> InsideRecord:
        """Arrays and JSON facts from which `restored` makes the same inside."""
        parts = {"shape": self.shape.record(), "course": self.course.record()}
        if self.stamps is not None and len(self.stamps.rows):
            parts["stamps"] = self.stamps.record()
        arrays, facts = nested(parts)
        way = next(name for name, kind in COURSES.items() if isinstance(self.course, kind))
        arrays |= {"origin": self.origin, "grid_centre": self.grid_centre}
        return arrays, facts | {"kind": LAYERS, "way": way, "cell": self.cell}

    @classmethod
    def restored(cls, record: RecordReader) -> LayeredInside:
        """The inside in a `record`. Raises ValueError if the record is not valid."""
        way = record.facts.get("way")
        if not isinstance(way, str) or way not in COURSES:
            raise ValueError("another way that pictures go on")
        shape = Shape.restored(record.part("shape"))
        return cls(
            shape,
            COURSES[way].restored(record.part("course"), shape),
            Stamps.restored(record.part("stamps")) if record.has("stamps") else None,
            record.array("origin", np.float64, (3,)),
            record.array("grid_centre", np.float64, (3,)),
            record.number("cell", 1e-12),
        )
