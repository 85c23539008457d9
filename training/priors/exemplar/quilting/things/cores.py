"""The cores of pictures: found, and laid as solids in their own planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import OWN_AZIMUTHS, Ball, OwnHeight
from training.priors.exemplar.quilting.disc import disc_radius
from training.priors.exemplar.quilting.labels import Label, Source
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.things.column import Column
from training.priors.exemplar.quilting.things.core import MARGIN, Core, find_shape, seen_along

__all__ = ["Cores", "find_cores"]

ALONE = 0.015
"""Distance in radii from a picture's own plane within which other pictures' cores fade: the plane shows its picture."""

COLUMN_ALONE = 0.008
"""The same for a column, which passes through all planes: of half a film."""


@dataclass(frozen=True)
class Cores:
    """The core of the horizontal picture, and what radial ones show of it."""

    height: float
    """Height of the horizontal picture in the ball."""
    across: Source
    along: Sequence[Source]
    """The radial pictures with own planes, evenly spread over half a turn. A column is shown by their planes alone."""

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
        is_column = isinstance(self.across.core, Column)
        alone = _seen(np.stack([rise, *off]), COLUMN_ALONE if is_column else ALONE)
        if is_column:
            stretch = np.float32(1 / np.sqrt(max(1 - self.height**2, 0.1)))  # as `Ball.level` at the picture's height
            places = [(self.across, stretch * x, stretch * y, rise)]
            change = self._change(right, off, z)
        else:
            u, v = Ball.of(points[rows]).level.T
            places = [(self.across, u, v, rise), *zip(self.along, right, [z] * len(right), off, strict=True)]
            change = np.float32(0)
        depth, colours, covered = np.full(len(rows), -np.inf, np.float32), rgb[rows], cover[rows]
        for n, (source, u, v, away) in enumerate(places):
            shown, deep = source.core.read(source.disc, u, v, away)
            shown += change
            covers = _passed(deep) * np.delete(alone, n, 0).prod(0)
            deeper = _passed(deep - depth)  # where two meet, the one that a place is deeper in
            colours *= (1 - covers * deeper)[:, None]
            colours += (covers * (1 - covered * (1 - deeper)))[:, None] * shown
            covered += covers * (1 - covered)
            depth = np.maximum(depth, deep)
        rgb[rows], cover[rows] = colours, covered
        return rgb, cover

    def _change(
        self, right: NDArray[np.floating], off: NDArray[np.floating], z: NDArray[np.floating]
    ) -> NDArray[np.float32] | np.float32:
        """(M, 3). How far a column's colours at heights (M,) are from usual ones, as the mean of radial pictures; their
        places along each one's plane and off it are (N, M)."""
        columns = [(one.core, *at) for one, *at in zip(self.along, right, off, strict=True)]
        changes = [core.change(u, v, z) for core, u, v in columns if isinstance(core, Column)]
        return np.mean(changes, axis=0) if changes else np.float32(0)


def find_cores(
    across: Sequence[Source], along: Sequence[Source], height: float
) -> tuple[list[Core | Column], list[Core | Column]]:
    """The cores of horizontal pictures, and of radial ones what they show of the first one's, which is at a height in
    the ball."""
    faces = [source.even for source in along]

    def found(source: Source) -> Core | Column:
        shape = find_shape(source.even, source.rind)
        if shape is None:
            return Core.none()
        reach = float(disc_radius()[shape].max()) + MARGIN
        seen = [shown for one in faces if (shown := seen_along(one, reach, height))]
        if sum(shown.is_column for shown in seen) > len(seen) / 2:
            return Column.across(source.disc, shape, faces, max(one.rind for one in along), height)
        return Core.across(shape, seen)

    cores = [found(source) for source in across]
    first = cores[0]
    if isinstance(first, Column):
        return cores, [first.along(source.bare.even) for source in along]  # its seeds are laid apart
    return cores, [Core.along(face, first, height) for face in faces]


def _passed(depth: NDArray[np.floating]) -> NDArray[np.floating]:
    """Rises from 0 outside of a core's surface to 1 inside, by the depth in radii."""
    return np.clip(depth / BLEND + 0.5, 0, 1)


def _seen(away: NDArray[np.floating], alone: float) -> NDArray[np.floating]:
    """How much of a core is seen at these distances in radii from other pictures' planes."""
    return 1 - np.exp(-np.square(away / alone))
