"""How a frame is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Look", "Mode"]

Mode = Literal["opaque", "classic", "interior"]
"""The solid; the capture as it came; the solid without its skin."""


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
