"""The inside of an object as a function of the place, finer than the atoms that show it in motion."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Inside", "InsideRecord"]

InsideRecord = tuple[dict[str, NDArray[Any]], dict[str, Any]]
"""Arrays and JSON facts from which an inside can be made again, for a file."""


class Inside(Protocol):
    """One colour for every place, whatever plane shows it."""

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        """(N, 3). Colours at points (N, 3) of object space, of details no finer than a footprint in world units.
        Range [0, 1]; outside the object those of its skin."""
        ...

    def record(self) -> InsideRecord:
        """All that it is made of."""
        ...
