"""Options of the opaque renderers: what to draw, and how finely."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["DrawOptions", "Mode", "SplatLook"]

Mode = Literal["opaque", "classic", "interior"]
"""The solid; the unchanged capture; the solid without its skin."""

SLACK = 1.15
"""Enlargement beyond what keeps the mean coverage: a random subset of the atoms has gaps."""


@dataclass(frozen=True)
class SplatLook:
    """Changes to how splats look, to see how a scene is made."""

    size: float = 1.0
    """Factor on all standard deviations. Greater than 0."""
    opacity: float = 1.0
    """Factor on the opacities of a capture; atoms stay opaque. Range [0, 1]."""


@dataclass(frozen=True)
class DrawOptions:
    """How the solid is drawn in one frame."""

    interior_only: bool
    """Without the skin."""
    light: bool
    """Shade cut faces slightly by their slant to the eye."""
    exact: bool
    """Compute faces pixel by pixel, not from grids that are cached while a plane stays in place."""
    level: int
    """0 draws all atoms; each further level draws half as many, enlarged."""
    cull: bool
    """Leave out what cannot be seen."""
    size: float = 1.0
    """As in SplatLook."""

    @property
    def disc_scale(self) -> float:
        """Factor by which skin atoms are enlarged, so that fewer of them still cover the solid."""
        return self.size * 2.0 ** (self.level / 2) * (SLACK if self.level else 1.0)

    @property
    def ball_scale(self) -> float:
        """Factor by which interior atoms are enlarged, so that fewer of them still fill the solid."""
        return self.size * 2.0 ** (self.level / 3) * (SLACK if self.level else 1.0)
