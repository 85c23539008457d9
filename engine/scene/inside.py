"""The inside of an object as a function of the place, finer than the atoms that show it in motion."""

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
    """Anything in the body that is none of those below, or of which no more is known."""
    RIND = 2
    """The layers along the skin, as deep as a picture shows them to go all around."""
    THING = 3
    """Something that ends inside, such as a seed, a chamber or a pore."""
    STRUCTURE = 4
    """What runs through: a membrane, a core, a crack, a filling."""


KIND_NAMES = tuple(kind.name.lower() for kind in Kind)
"""Their names, by number."""

InsideRecord = tuple[dict[str, NDArray[Any]], dict[str, Any]]
"""Arrays and JSON facts from which an inside can be made again, for a file."""


class Inside(Protocol):
    """One colour for every place, whatever plane shows it."""

    @property
    def detail(self) -> float:
        """World units. Footprint from which all details are there: a pixel of the finest picture it is made of."""
        ...

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). Colours at points (N, 3) of object space, of details no finer than a footprint in world units.
        Range [0, 1]; outside the object those of its skin."""
        ...

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(N,). The `Kind` at points (N, 3) that are in the body, never OUTSIDE."""
        ...

    def record(self) -> InsideRecord:
        """All that it is made of."""
        ...
