"""How a frame is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Look", "Mode"]

Mode = Literal["opaque", "classic", "interior"]
"""The solid; the capture as it came; the solid without its skin."""

SLACK = 1.15
"""Beyond what keeps the coverage on average: a part of the atoms chosen by chance leaves gaps between them."""


@dataclass(frozen=True)
class Look:
    """How the solid is drawn."""

    interior_only: bool
    """Without the skin."""
    light: bool
    """Shade cut faces a little."""
    exact: bool
    """Faces pixel by pixel, instead of from grids that are kept as long as a plane stays."""
    level: int
    """0: all atoms; each further one: half as many, enlarged."""
    cull: bool
    """Leave out what cannot be seen."""

    @property
    def disc_scale(self) -> float:
        """How much larger the atoms of a skin are drawn, so that fewer of them cover it."""
        return 2.0 ** (self.level / 2) * (SLACK if self.level else 1.0)

    @property
    def ball_scale(self) -> float:
        """How much larger interior atoms are drawn, so that fewer of them fill the solid."""
        return 2.0 ** (self.level / 3) * (SLACK if self.level else 1.0)
