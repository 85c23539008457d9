"""A core that runs along the axis, such as the pith of an orange or the hollow of a papaya.

It is the shape of the horizontal picture, carried along the axis and as wide at every height as radial pictures show it
there, over how wide they show it beside the horizontal picture. So are the colours of the horizontal picture, without
what is small in it and closes, plus how they change along the axis in radial ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    PIXEL,
    Disc,
    Medians,
    disc_grid,
    disc_radius,
    enlarged,
    filled_in,
    read_map,
    to_pixels,
)
from training.priors.exemplar.quilting.things.core import MARGIN, SMOOTH
from training.priors.exemplar.quilting.things.forms import depth_of
from training.priors.exemplar.quilting.things.widths import MOST, shown_along, widths_along
from training.priors.exemplar.sampling import read_bilinear

__all__ = ["Column"]

LEVEL = 0.15
"""Distance in radii from the horizontal picture over which widths are averaged that count as one: a crack or a seed at
its height is not how wide the column is."""

LEAST = 0.05
"""Least such width: less is its end."""

CALM = 0.04
"""Standard deviation in radii of the blur of widths along the axis: fibres that a radial picture shows beside a column
would be rings around it."""

SMALL = 0.07
"""Radius in radii of the medians that leave what runs along the axis: nothing as small as a seed is left."""

WANDER = 0.2
"""Half of the largest distance in radii by which directions show a radial picture at heights of their own: more than
the width of a column, over which its fibres change."""

CLOSE = 0.03
"""Distance in radii from the horizontal picture's plane within which what is small ends."""

FADE = 0.1
"""Distance in radii from that plane over which the colours of radial pictures fade: over CLOSE, the plane shows as a
bar across the column. With twice as much, the middle of an orange's pith is pale."""


@dataclass(frozen=True)
class Column:
    """A core that runs along the axis, as a solid."""

    region: NDArray[np.bool_]
    """(P, P). Where it is in the horizontal picture, with what lies between its parts."""
    depth: NDArray[np.float32]
    """(P, P). How deep each pixel is in its shape, in radii; negative outside."""
    colours: Disc
    """The picture's colours in it: without what is small in a horizontal picture, as they are in a radial one."""
    widths: NDArray[np.float64]
    """(P,). Its width at the heights of a disc's pixels, over that at the horizontal picture's."""
    height: float
    """Height of the horizontal picture in the ball."""
    reach: float
    """How far it reaches from the axis at that height, in radii."""

    @classmethod
    def across(cls, disc: Disc, shape: NDArray[np.bool_], along: Sequence[Disc], rind: float, height: float) -> Column:
        """The column of this shape (P, P) in a horizontal face at a height in the ball, as radial faces of even tones,
        cut `along` the axis, show it. Their rinds have this depth in radii."""
        reach = float(disc_radius()[shape].max()) + MARGIN
        level = disc_grid()[1][0]
        calm = ndimage.gaussian_filter1d(widths_along(along, reach, height), CALM / PIXEL)
        wide = _without_flares(calm, rind)
        widths = np.minimum(wide / max(float(wide[np.abs(level - height) < LEVEL].mean()), 1.0), MOST)
        here = max(float(np.interp(height, level, widths)), LEAST)
        widths = widths / here ** np.exp(-np.square((level - height) / LEVEL))
        return cls(disc_radius() < reach, _depth(shape), _without_small(disc, shape), widths, height, reach)

    def along(self, disc: Disc, rind: float) -> Column:
        """The same column, as a radial face of even tones with a rind of this depth in radii shows it. At the poles it
        may widen into the rind, which is no part of it."""
        shown = shown_along(disc, self.reach, self.height)
        away = np.abs(disc_grid()[0])
        for side in (slice(DISC_PIXELS // 2), slice(DISC_PIXELS // 2, None)):
            widths = np.where(shown[side], away[side], 0).max(0)
            shown[side] &= away[side] <= _without_flares(widths, rind)
        depth = _depth(shown)
        region = (depth > -MARGIN) & (disc_radius() < 1 - rind)
        return replace(self, region=region, depth=depth, colours=Disc(filled_in(disc.rgb, ~shown)))

    @property
    def shape(self) -> NDArray[np.bool_]:
        """(P, P). Where the picture shows it."""
        return self.depth > 0

    def holds(self, x: NDArray[np.floating], y: NDArray[np.floating], rise: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(...). Whether the column may be at places (...), (...) of the ball and signed distances (...) from the
        horizontal picture's plane."""
        return np.hypot(x, y) < MOST * self.reach * self._widths(rise)  # radial pictures show it that wide

    def depth_at(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). How deep places (M,), (M,) of the picture are in the column, in radii; negative outside."""
        return read_map(self.depth, x, y)

    def read(
        self, disc: Disc, x: NDArray[np.floating], y: NDArray[np.floating], rise: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of the column, which `disc` shows, at places (M,), (M,) at distances (M,) from its
        plane, and how deep in it they are, in radii; negative outside."""
        wide = self._widths(rise)
        x, y = x / np.maximum(wide, LEAST), y / np.maximum(wide, LEAST)
        depth = np.where(wide > LEAST, read_map(self.depth, x, y) * wide, -1).astype(np.float32)
        colours = self.colours.read(x, y)
        return colours + _beside(rise, CLOSE)[:, None] * (disc.read(x, y) - colours), depth

    def change(
        self, right: NDArray[np.floating], off: NDArray[np.floating], z: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(M, 3). How far this radial picture's colours at these heights (M,) are from its usual ones, at distances
        (M,) from the axis along its plane and (M,) across it. Turned around the axis, what it shows beside the axis
        would be rings in horizontal cuts, so each direction shows it at heights of its own, and the opposite one at the
        same ones."""
        if not self.shape.any():
            return np.zeros((len(z), 3), np.float32)
        radius, angle = np.hypot(right, off), np.arctan2(off, right)
        there = z + WANDER * np.abs(np.sin(angle)) * (np.sin(2 * angle + 1) + np.sin(6 * angle + 2))
        sides = [self.colours.read(side * radius, there) for side in (1, -1)]
        part = (0.5 + 0.5 * right / np.maximum(radius, 1e-6))[:, None]
        change = part * sides[0] + (1 - part) * sides[1] - self._usual_at(there) + self._usual_at(z)
        change -= np.median(self.colours.rgb[self.shape], axis=0)
        return np.asarray((1 - _beside(z - self.height, FADE))[:, None] * change, np.float32)

    def _usual_at(self, z: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M, 3). The usual colours at heights (M,)."""
        return read_bilinear(self._course, np.zeros_like(z), to_pixels(z, z, DISC_PIXELS)[0])

    @cached_property
    def _course(self) -> NDArray[np.float32]:
        """(2, P, 3), both rows alike. Median colours of the shape at the heights of a disc's pixels; of all of it where
        it is not."""
        shape = self.shape
        course = np.tile(np.median(self.colours.rgb[shape], axis=0).astype(np.float64), (DISC_PIXELS, 1))
        for row in np.flatnonzero(shape.any(0)):
            course[row] = np.median(self.colours.rgb[shape[:, row], row], axis=0)
        return np.stack([ndimage.gaussian_filter1d(course, SMOOTH / PIXEL, axis=0)] * 2).astype(np.float32)

    def _widths(self, rise: NDArray[np.floating]) -> NDArray[np.float32]:
        return np.interp(rise + self.height, disc_grid()[1][0], self.widths).astype(np.float32)


def _without_flares(wide: NDArray[np.floating], rind: float) -> NDArray[np.floating]:
    """(P,). Widths at the heights of a disc's pixels, without what they grow by towards a rind of this depth, as that
    is part of it. They end there."""
    out = np.zeros_like(wide)
    within = int((disc_grid()[0][DISC_PIXELS // 2 :, 0] < 1 - rind - SMOOTH).sum())
    for half in (slice(DISC_PIXELS // 2, None), slice(DISC_PIXELS // 2 - 1, None, -1)):  # from the middle to a pole
        side = wide[half][:within]
        narrowest = within // 2 + int(side[within // 2 :].argmin())
        out[half][:within] = np.where(np.arange(within) < narrowest, side, side[narrowest])
    return out


def _beside(rise: NDArray[np.floating], fades: float) -> NDArray[np.floating]:
    """(M,). How much of a horizontal picture that `fades` over so many radii is left at distances (M,) from its
    plane."""
    return np.exp(-np.square(rise / fades))


def _without_small(disc: Disc, shape: NDArray[np.bool_]) -> Disc:
    """The colours of a shape (P, P) in a face, and of nothing beside it, without what is small in it."""
    return Disc(enlarged(Medians(filled_in(disc.rgb, ~shape)).over(SMALL)))


def _depth(shape: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(P, P). Distance in radii of each pixel from the edge of a shape, negative outside of it."""
    if not shape.any():
        return np.full(shape.shape, -1, np.float32)
    return depth_of(shape).astype(np.float32)
