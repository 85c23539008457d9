"""What there is at places of a quilt, as far as the picture that is shown there tells it.

A place in a picture's rind is rind, wherever the picture is shown; one in a sheet is a structure that runs through. A
thing stands out of the picture and ends, as the law of shape has it (`relief`), with the distance from the picture's
plane; so do grains, in their pictures and as they are laid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.inside import Kind
from training.priors.exemplar.quilting.chunks import Ball
from training.priors.exemplar.quilting.disc import DISC_PIXELS, REACH, Disc, disc_grid, to_pixels
from training.priors.exemplar.quilting.labels import Source
from training.priors.exemplar.quilting.quilt import Quilt
from training.priors.exemplar.quilting.relief import Relief

__all__ = ["QuiltKinds"]

CLOSED = 0.5
"""Height in radii up to which what stands out is closed: the widest closed thing has a half width of 0.22."""

LEAST_CONTRAST, TYPICAL = 0.08, 3.5
"""RGB distance from what is there farther on from which a thing stands out, and times the median distance in the same
picture: as for the details of layers. Below, an orange's juice sacs are things."""

NARROWEST = 0.01
"""Half width in radii of a thing: what is narrower is texture."""

LEAST_SHEET = 0.3
"""Surety of a sheet from which a place belongs to it, as for layers."""

GRAIN = 0.5
"""Part of a place that a grain covers from which it belongs to it."""


@dataclass(frozen=True)
class _Face:
    """The kinds in a picture."""

    rind: float
    """Depth in radii."""
    sheets: Disc
    until: NDArray[np.float32]
    """(P, P). Distance in radii from its plane up to which each pixel shows a thing; below 0 where there is none."""

    @classmethod
    def of(cls, source: Source) -> _Face:
        until = _things(source.relief, source.rind)
        grains = source.grains
        x, y = disc_grid()
        for (u, v), radius in zip(grains.places, grains.radii, strict=True):
            away = np.square(x - u) + np.square(y - v)
            until = np.maximum(until, np.sqrt(np.maximum(radius * radius - away, 0)) - (away >= radius * radius))
        return cls(source.rind, source.sheets, until.astype(np.float32))

    def at(self, x: NDArray[np.floating], y: NDArray[np.floating], distance: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(M,). The kinds at places (M,), (M,) and distances (M,) from the plane."""
        at = np.clip(np.round(to_pixels(x, y, DISC_PIXELS)), 0, DISC_PIXELS - 1).astype(int)
        out = np.where(distance <= self.until[at[0], at[1]], Kind.THING, Kind.INSIDE).astype(np.uint8)
        out[self.sheets.read(x, y)[:, 0] > LEAST_SHEET] = Kind.STRUCTURE
        out[np.hypot(x, y) > 1 - self.rind] = Kind.RIND
        return out


class QuiltKinds:
    """The kinds of a quilt."""

    def __init__(self, quilt: Quilt) -> None:
        self._quilt = quilt
        shown = {id(source): source for label in quilt.labels for source in label.sources}
        self._faces = {key: _Face.of(source) for key, source in shown.items()}

    def at(self, points: NDArray[np.float32]) -> NDArray[np.uint8]:
        """(M,). The `Kind` at points (M, 3) of the unit ball, never OUTSIDE."""
        quilt = self._quilt
        nearest = quilt.nearest(points)[0][:, 0]
        out = np.full(len(points), Kind.INSIDE, np.uint8)
        for n, label in enumerate(quilt.labels):
            rows = np.flatnonzero(nearest == n)
            places = label.chunks.places(Ball.of(points[rows]))
            for m, source in enumerate(label.sources):
                face, of_it = self._faces[id(source)], places.picture == m
                out[rows[of_it]] = face.at(places.x[of_it], places.y[of_it], places.distance[of_it])
        if quilt.packing is not None:
            _, cover = quilt.packing.read(points)
            out[cover > GRAIN] = Kind.THING
        return out


def _things(relief: Relief, rind: float) -> NDArray[np.floating]:
    """(P, P). Distance in radii up to which each pixel shows a closed thing; -1 where there is none. What touches a
    rind of this depth is none: flesh stands out there from the colours of both."""
    apart = np.linalg.norm(relief.levels[:-1, ..., :3] - relief.levels[-1, ..., :3], axis=-1)
    face = np.hypot(*disc_grid()) < 1
    stands_out = apart > np.maximum(LEAST_CONTRAST, TYPICAL * np.median(apart[:, face], axis=1))[:, None, None]
    heights = np.moveaxis(relief.heights, -1, 0)
    until = np.where(stands_out & (heights < CLOSED), heights, -1).max(0)
    pixels = round(NARROWEST * DISC_PIXELS / (2 * REACH))
    y, x = np.ogrid[-pixels : pixels + 1, -pixels : pixels + 1]
    parts, _ = ndimage.label(ndimage.binary_opening(until > 0, x * x + y * y <= pixels * pixels))
    ends = (parts > 0) & ~np.isin(parts, parts[np.hypot(*disc_grid()) > 1 - rind])
    return np.where(ends, until, -1)
