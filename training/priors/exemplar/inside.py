"""A quilt in the space of the object it was made for: read at any place, kept in a file and read from it again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import InsideRecord
from training.priors.exemplar.frames import Space
from training.priors.exemplar.quilting.disc import DISC_PIXELS, REACH, BallMap, Disc
from training.priors.exemplar.quilting.quilt import Quilt, restore_quilt

__all__ = ["QuiltInside"]

COARSEST = 16
"""Times as large as a photograph's pixels are those of its coarsest version: a power of two that divides it."""

MOST_PICTURES = 40
"""Pictures of a file: 20 of each family."""


@dataclass(frozen=True)
class QuiltInside:
    """An inside that is quilted of photographs; its record has these, the layout of their chunks and a seed."""

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
    """World units."""
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

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). See `engine.scene.inside.Inside`."""
        planar = ((points - self.origin) @ self.basis.T / self.cell).astype(np.float32)
        pixel = 2 * REACH / DISC_PIXELS * float(self.ball.skin.mean()) * self.cell
        n = 1
        while n < COARSEST and 2 * n * pixel <= footprint:
            n *= 2
        if n not in self._reduced:
            self._reduced[n] = self.quilt.reduced(n) if n > 1 else self.quilt
        return self._reduced[n].read(self.ball.to_ball(planar))

    def record(self) -> InsideRecord:
        """Arrays and JSON facts from which `restored` makes the same inside."""
        families = {"horizontal": self.horizontal, "radial": self.radial}
        empty = np.zeros((0, DISC_PIXELS, DISC_PIXELS, 3), np.uint8)
        arrays: dict[str, NDArray[Any]] = {
            name: np.stack([disc.to_bytes() for disc in discs]) if discs else empty for name, discs in families.items()
        }
        arrays |= {"chosen": self.quilt.chosen.astype(np.uint8), "skin": self.ball.skin}
        arrays |= {"origin": self.origin, "basis": self.basis}
        return arrays, {"kind": "quilt", "seed": self.seed, "rise": self.ball.rise, "cell": self.cell}

    @classmethod
    def restored(cls, arrays: dict[str, NDArray[Any]], facts: dict[str, Any]) -> QuiltInside:
        """The inside of a `record`. Raises ValueError if it is none."""
        if facts.get("kind") != "quilt":
            raise ValueError("another kind of inside")
        seed, rise, cell = facts.get("seed"), _number(facts, "rise"), _number(facts, "cell")
        if type(seed) is not int or seed < 0 or cell <= 0:
            raise ValueError("a wrong number")
        shapes = {"skin": (None, None), "origin": (3,), "basis": (3, 3)}
        skin, origin, basis = (_finite(arrays, name, shape) for name, shape in shapes.items())
        if min(skin.shape) < 4 or max(skin.shape) > 1000 or skin.min() <= 0:
            raise ValueError("a wrong skin")
        families = []
        for name in ("horizontal", "radial"):
            pictures = arrays.get(name)
            if pictures is None or pictures.dtype != np.uint8 or pictures.shape[1:] != (DISC_PIXELS, DISC_PIXELS, 3):
                raise ValueError("a wrong picture")
            families.append([Disc.of_bytes(rgb) for rgb in pictures])
        horizontal, radial = families
        chosen = arrays.get("chosen")
        if chosen is None or chosen.dtype != np.uint8 or not 0 < len(horizontal) + len(radial) <= MOST_PICTURES:
            raise ValueError("no layout, or no picture")
        ball = BallMap(rise, skin)
        quilt = restore_quilt(horizontal, radial, seed, ball.height, chosen.astype(np.int32))
        return cls(quilt, horizontal, radial, seed, ball, origin, basis, cell)


def _number(facts: dict[str, Any], name: str) -> float:
    value: Any = facts.get(name)
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(f"no {name}")
    return float(value)


def _finite(arrays: dict[str, NDArray[Any]], name: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """An array of numbers of this shape; None is any length."""
    array = arrays.get(name)
    if array is None or array.dtype != np.float64 or len(array.shape) != len(shape):
        raise ValueError(f"no {name}")
    if any(wanted not in (None, side) for wanted, side in zip(shape, array.shape, strict=True)):
        raise ValueError(f"a wrong {name}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")
    return array
