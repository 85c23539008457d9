"""The inside of an object as a function of position, finer than the atoms that show it in motion."""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["KIND_NAMES", "Inside", "InsideRecord", "Kind"]


class Kind(IntEnum):
    """What there is at a place, as far as an inside can tell without guessing."""

    OUTSIDE = 0
    INSIDE = 1
    """Anything in the body that is none of the kinds below, or of which nothing more is known."""
    RIND = 2
    """The layers along the skin, as deep as a picture shows them all around."""
    THING = 3
    """Something that ends inside, such as a seed, a chamber or a pore."""
    STRUCTURE = 4
    """What runs through: a membrane, a core, a crack, a filling."""


KIND_NAMES = tuple(kind.name.lower() for kind in Kind)
"""Names of the kinds, by number."""

InsideRecord = tuple[dict[str, NDArray[Any]], dict[str, Any]]
"""Arrays and JSON facts, for a file, from which an inside can be rebuilt."""


class Inside(Protocol):
    """One colour for every place, whatever plane shows it."""

    @property
    def detail(self) -> float:
        """World units. Footprint at which all details show: a pixel of the finest picture it is made of."""
        ...

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). Colours at points (N, 3) in object space, without details finer than the footprint, world units.
        Range [0, 1]; outside the object, the colours of its skin."""
        ...

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(N,). The `Kind` at points (N, 3) that are in the body, never OUTSIDE."""
        ...

    def record(self) -> InsideRecord:
        """Everything it is made of."""
        ...
