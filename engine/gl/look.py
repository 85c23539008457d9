"""How a frame is drawn."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Look"]


@dataclass(frozen=True)
class Look:
    """How a frame is drawn."""

    light: bool
    """Shade cut faces a little."""
    level: int
    """0: all atoms; each further one: half as many, enlarged."""
    cull: bool
    """Leave out what cannot be seen."""
