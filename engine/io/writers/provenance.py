"""What a written file says about itself besides its Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Provenance"]


@dataclass(frozen=True)
class Provenance:
    """The facts about one object."""

    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector: formats whose axes are fixed get the object upright."""
    lines: tuple[str, ...] = ()
    """What it was made from, for people to read."""
