"""What of a cut face goes on beside it: the one law of shape.

A closed thing is about as tall as it is long, and a sheet that joins core and rind runs through. Neither looks at a
colour's name: the median over a disc of radius t is what remains of a picture at distance t, as it rounds off and then
removes things narrower than that.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    REACH,
    REDUCTION,
    Disc,
    disc_grid,
    disc_median,
    to_pixels,
)
from training.priors.exemplar.sampling import reduced

__all__ = ["Persistence", "find_sheets"]

DISTANCES = (0.02, 0.04, 0.07, 0.11, 0.16, 0.22)
"""Distances in radii at which the medians are taken; seeds, pores and carpels have half widths in this range."""

THIN, WIDE = 0.07, 0.16
"""Distances in radii over which a sheet has gone, and with which that is compared: the median over a disc takes away a
line that is as wide as 0.8 of its radius. What is wider is flesh or a hollow, which ends as closed things do."""

BORDER = 0.01
"""Radii over which a sheet's surety is smoothed across its edges."""

SHEET_LENGTH = 0.42
"""Length in radii along which a sheet is followed: longer than seeds and carpels, and shorter than the flesh."""

BENDS = np.radians(np.linspace(-8, 8, 9))
"""Angles by which a sheet may lean over that length."""

SHEET_QUANTILE = 0.25
"""Of the contrast along the length. A mean would take seeds and carpels, strong but short, for sheets."""

ANGLES, RADII = 360, 128
"""Samples around and along the radius when sheets are looked for."""

CONTRAST_ANGLES = 21
"""Samples around over whose median a sheet stands out: about 20 degrees."""

SHEET_RADII = (0.12, 0.93)
"""Radii between which sheets are: inside is the core, outside the rind."""


class Persistence:
    """How far the colours of a disc are from what remains of them at a distance from its plane."""

    def __init__(self, disc: Disc) -> None:
        small = reduced(disc.rgb, REDUCTION)
        gone = [np.linalg.norm(small - disc_median(disc.rgb, distance), axis=-1) for distance in DISTANCES]
        self._gone = np.stack([np.zeros_like(gone[0]), *gone]).astype(np.float32)

    def gone(
        self, x: NDArray[np.floating], y: NDArray[np.floating], distance: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(M,). RGB distance between the colours at places (M,), (M,) and what remains at distances (M,), in radii."""
        step = np.interp(distance, (0, *DISTANCES), np.arange(len(DISTANCES) + 1))
        at = np.stack([step, *to_pixels(x, y, self._gone.shape[1])])
        return ndimage.map_coordinates(self._gone, at, order=1, mode="nearest", output=np.float32)


def find_sheets(disc: Disc, persistence: Persistence) -> NDArray[np.float32]:
    """(DISC_PIXELS, DISC_PIXELS). How surely a horizontal face shows a thin sheet from core to rind. Range [0, 1].

    `persistence`: of the same face.
    """
    angle = np.arange(ANGLES) / ANGLES * 2 * np.pi
    radius = (np.arange(RADII) + 0.5) / RADII
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    smooth = Disc(ndimage.gaussian_filter(disc.rgb, (1.2, 1.2, 0)))
    polar = smooth.read(x, y)
    ground = [ndimage.median_filter(polar[..., c], size=(1, CONTRAST_ANGLES), mode="wrap") for c in range(3)]
    contrast = polar - np.stack(ground, -1)
    length = int(SHEET_LENGTH * RADII)
    along = np.arange(-(length // 2), length // 2 + 1, 2)
    padded = np.pad(contrast, ((length, length), (0, 0), (0, 0)), mode="edge")
    found = np.zeros((RADII, ANGLES), np.float32)
    for bend in BENDS:
        turns = np.round(bend * along / length * ANGLES / (2 * np.pi)).astype(int)
        steps = list(zip(along.tolist(), turns.tolist(), strict=True))
        line = np.stack([np.roll(padded[length + a : length + a + RADII], -t, axis=1) for a, t in steps])
        mean = line.mean(0)
        size = np.linalg.norm(mean, axis=-1)
        direction = mean / np.maximum(size, 1e-6)[..., None]
        steady = np.quantile((line * direction).sum(-1), SHEET_QUANTILE, axis=0)
        # All along a steady line is a sheet, but where the picture itself does not stand out it ends.
        for a, t in steps:
            here, there = slice(max(a, 0), RADII + min(a, 0)), slice(max(-a, 0), RADII + min(-a, 0))
            out = np.roll(contrast[here], -t, axis=1)
            surely = np.where((out * direction[there]).sum(-1) > 0.5 * size[there], steady[there], 0)
            found[here] = np.maximum(found[here], np.roll(surely, t, axis=1))
    flesh = contrast[int(0.2 * RADII) : int(0.8 * RADII)]
    surely = np.clip(found / (np.linalg.norm(flesh, axis=-1).std() + 0.01) - 0.5, 0, 1)
    surely[(radius < SHEET_RADII[0]) | (radius > SHEET_RADII[1])] = 0
    px, py = disc_grid()
    turn = np.arctan2(py, px) % (2 * np.pi) / (2 * np.pi) * ANGLES
    at = np.stack([np.hypot(px, py) * RADII - 0.5, turn])
    closed = np.concatenate([surely, surely[:, :1]], axis=1)
    sheets = ndimage.map_coordinates(closed, at, order=1, cval=0, output=np.float32)
    thin, wide = (persistence.gone(px.ravel(), py.ravel(), np.full(px.size, d)) for d in (THIN, WIDE))
    share = np.clip(2 * thin / (wide + 0.02) - 0.5, 0, 1).reshape(px.shape)
    return sheets * ndimage.gaussian_filter(share, BORDER * DISC_PIXELS / (2 * REACH))
