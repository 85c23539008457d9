"""Things cut out of pictures, each an ellipse that can be laid anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import PIXEL, Disc, to_pixels

__all__ = ["EXTENT", "STAMP_PIXELS", "Things"]

STAMP_PIXELS = 64
"""Along a side of a stamp: as fine as the disc for things with a half width of a tenth of a radius."""

EXTENT = 1.25
"""Half a side of a stamp, in half axes of its thing: an outline that is no ellipse reaches out of it."""

SOFT = 0.7
"""Standard deviation in pixels of the disc of a thing's edge, which is as sharp as the picture's."""


@dataclass(frozen=True)
class Things:
    """Things of one picture."""

    places: NDArray[np.float32]
    """(B, 2). Of their middles on the disc."""
    axes: NDArray[np.float32]
    """(B, 2). Half axes in radii of the disc, the longer first."""
    turns: NDArray[np.float32]
    """(B,). From the disc's x axis to the longer axis, radians."""
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
        """Things of a face, of any number. `parts` (P, P): at its pixels the number of the thing that is there, from 1
        and 0 for none; without it they lie close and cover all of their ellipses."""
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
        """The same things without what pixels of the disc n times as large do not show."""
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
