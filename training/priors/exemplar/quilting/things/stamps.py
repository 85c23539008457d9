"""Things cut out of pictures, each an ellipse that can be laid anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import PIXEL, Disc, to_pixels

__all__ = ["EXTENT", "STAMP_PIXELS", "Things"]

STAMP_PIXELS = 64
"""Pixels along a side of a stamp: as fine as the disc for things with a half width of a tenth of a radius."""

EXTENT = 1.25
"""Half a side of a stamp, in half axes of its thing: an outline that is no ellipse reaches beyond it."""

SOFT = 0.7
"""Standard deviation of the blur of a thing's edge, in pixels of the disc: the edge is as sharp as the picture's."""


@dataclass(frozen=True)
class Things:
    """Things of one picture."""

    places: NDArray[np.float32]
    """(B, 2). Places of their middles on the disc."""
    axes: NDArray[np.float32]
    """(B, 2). Half axes in radii of the disc, the longer first."""
    turns: NDArray[np.float32]
    """(B,). Angle from the disc's x axis to the longer axis, radians."""
    stamps: NDArray[np.float32]
    """(B, S, S, 4). Colours and how much they cover, along the longer axis and across it, over EXTENT half axes."""
    are_close: bool
    """Whether they fill what they lie in, so that as many are wanted as there is room for."""

    @classmethod
    def of(
        cls,
        disc: Disc,
        places: NDArray[np.floating],
        axes: NDArray[np.floating],
        turns: NDArray[np.floating],
        parts: NDArray[np.int32] | None = None,
    ) -> Things:
        """Any number of things of a face. `parts` (P, P): the number of the thing at each pixel, from 1, and 0 for
        none; without it the things lie close and cover all of their ellipses."""
        step = (np.arange(STAMP_PIXELS) + 0.5) / STAMP_PIXELS * 2 - 1
        s, t = (EXTENT * a for a in np.meshgrid(step, step, indexing="ij"))
        stamps = np.ones((len(places), STAMP_PIXELS, STAMP_PIXELS, 4), np.float32)
        for n, ((x, y), (a, b), turn) in enumerate(zip(places, axes, turns, strict=True)):
            u = x + a * s * np.cos(turn) - b * t * np.sin(turn)
            v = y + a * s * np.sin(turn) + b * t * np.cos(turn)
            stamps[n, ..., :3] = disc.read(u, v)
            if parts is not None:
                i, j = (np.clip(np.round(at).astype(int), 0, len(parts) - 1) for at in to_pixels(u, v, len(parts)))
                there = (parts[i, j] == n + 1).astype(np.float32)
                stamps[n, ..., 3] = ndimage.gaussian_filter(there, SOFT * _pixels(axes[n]), mode="nearest")
        places, axes, turns = (np.asarray(a, np.float32) for a in (places, axes, turns))
        return cls(places, axes, turns, stamps, parts is None)

    def reduced(self, n: int) -> Things:
        """The same things without the detail that pixels of the disc n times as large do not show."""
        stamps = np.empty_like(self.stamps)
        for m, (stamp, axes) in enumerate(zip(self.stamps, self.axes, strict=True)):
            cover = stamp[..., 3:]
            shown = np.concatenate([stamp[..., :3] * cover, cover], -1)
            shown = ndimage.gaussian_filter(shown, (*(n / 2 * _pixels(axes)), 0), mode="nearest")
            stamps[m, ..., :3] = shown[..., :3] / np.maximum(shown[..., 3:], 1e-6)
            stamps[m, ..., 3] = shown[..., 3]
        return replace(self, stamps=stamps)


def _pixels(axes: NDArray[np.floating]) -> NDArray[np.floating]:
    """(2,). Pixels of a stamp with these half axes (2,) per pixel of the disc."""
    return PIXEL * STAMP_PIXELS / (2 * EXTENT * axes)
