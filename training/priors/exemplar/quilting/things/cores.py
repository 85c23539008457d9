"""The cores of pictures in their own planes, laid as solids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import OWN_AZIMUTHS, Ball, OwnHeight
from training.priors.exemplar.quilting.labels import Label, Source
from training.priors.exemplar.quilting.relief import BLEND

__all__ = ["Cores"]

ALONE = 0.015
"""Distance in radii from a picture's own plane within which other pictures' cores fade: the plane shows its picture."""


@dataclass(frozen=True)
class Cores:
    """The core of the horizontal picture, and what radial ones show of it."""

    height: float
    """Height of the horizontal picture in the ball."""
    across: Source
    along: Sequence[Source]
    """The radial pictures with own planes, evenly spread over half a turn."""

    @classmethod
    def of(cls, labels: Sequence[Label]) -> Cores | None:
        """The cores of a quilt with these labels; None if there are none."""
        own = {label.is_horizontal: label for label in labels if label.is_own}
        chunks = own[True].chunks if True in own else None
        if not isinstance(chunks, OwnHeight) or not own[True].sources[0].core.reach:
            return None
        along = own[False].sources[:OWN_AZIMUTHS] if False in own else []
        return cls(float(chunks.height), own[True].sources[0], along)

    def read(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of cores at points (M, 3) of the ball, multiplied by how much of the point they
        cover, and that cover. Range [0, 1]."""
        rgb, cover = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        rise = points[:, 2] - np.float32(self.height)
        rows = np.flatnonzero(self.across.core.holds(points[:, 0], points[:, 1], rise))
        if not len(rows):
            return rgb, cover
        (x, y, z), rise = points[rows].T, rise[rows]
        turns = np.arange(len(self.along))[:, None] * np.pi / max(len(self.along), 1)
        right, off = x * np.cos(turns) + y * np.sin(turns), y * np.cos(turns) - x * np.sin(turns)
        alone = np.stack([_seen(rise), *_seen(off)])
        u, v = Ball.of(points[rows]).level.T
        places = [(self.across, u, v, rise), *zip(self.along, right, [z] * len(right), off, strict=True)]
        depth, colours, covered = np.full(len(rows), -np.inf, np.float32), rgb[rows], cover[rows]
        for n, (source, u, v, away) in enumerate(places):
            shown, deep = source.core.read(source.disc, u, v, away)
            covers = _passed(deep) * np.delete(alone, n, 0).prod(0)
            deeper = _passed(deep - depth)  # where two meet, the one that a place is deeper in
            colours *= (1 - covers * deeper)[:, None]
            colours += (covers * (1 - covered * (1 - deeper)))[:, None] * shown
            covered += covers * (1 - covered)
            depth = np.maximum(depth, deep)
        rgb[rows], cover[rows] = colours, covered
        return rgb, cover


def _passed(depth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Rises from 0 outside of a core's surface to 1 inside, by the depth in radii."""
    return np.clip(depth / BLEND + 0.5, 0, 1)


def _seen(away: NDArray[np.floating]) -> NDArray[np.floating]:
    """How much of a core is seen at these distances in radii from other pictures' planes."""
    return 1 - np.exp(-np.square(away / ALONE))
