"""Things cut out of pictures, each an ellipse that can be laid anywhere."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import PIXEL, Disc, to_pixels

__all__ = ["EXTENT", "STAMP_PIXELS", "Things", "stamped", "within"]

STAMP_PIXELS = 64
"""Pixels along a side of a stamp: as fine as the disc for things with a half width of a tenth of a radius."""

EXTENT = 1.25
"""Half a side of a stamp, in half axes of its thing: an outline that is no ellipse reaches beyond it."""

RAYS, RAY_STEP, LONGEST = 32, 0.05, 3.0
"""Directions in which the outline of a cell is looked up; the step, over the radius of a disc as large as the cell, at
which that is done; and how far from the middle at most."""

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

    @classmethod
    def of(
        cls,
        disc: Disc,
        places: NDArray[np.floating],
        axes: NDArray[np.floating],
        turns: NDArray[np.floating],
        parts: NDArray[np.int32],
    ) -> Things:
        """Any number of things of a face. `parts` (P, P): the number of the thing at each pixel, from 1, and 0 for
        none."""
        s, t = _stamp_grid()
        stamps = np.ones((len(places), STAMP_PIXELS, STAMP_PIXELS, 4), np.float32)
        for n, ((x, y), (a, b), turn) in enumerate(zip(places, axes, turns, strict=True)):
            u = x + a * s * np.cos(turn) - b * t * np.sin(turn)
            v = y + a * s * np.sin(turn) + b * t * np.cos(turn)
            stamps[n, ..., :3] = disc.read(u, v)
            i, j = (np.clip(np.round(at).astype(int), 0, len(parts) - 1) for at in to_pixels(u, v, len(parts)))
            there = (parts[i, j] == n + 1).astype(np.float32)
            stamps[n, ..., 3] = ndimage.gaussian_filter(there, SOFT * _pixels(axes[n]), mode="nearest")
        places, axes, turns = (np.asarray(a, np.float32) for a in (places, axes, turns))
        return cls(places, axes, turns, stamps)

    @classmethod
    def of_cells(
        cls,
        disc: Disc,
        places: NDArray[np.floating],
        radii: NDArray[np.floating],
        turns: NDArray[np.floating],
        cells: NDArray[np.int32],
    ) -> Things:
        """Things that touch one another: `cells` (P, P) has the number of the thing at each pixel, from 1. A stamp
        shows its cell bent to a disc, as far as it is seen from the middle."""
        s, t = _stamp_grid()
        angles = (np.arange(RAYS) + 0.5) / RAYS * 2 * np.pi
        shares = np.arange(RAY_STEP, LONGEST, RAY_STEP)
        stamps = np.ones((len(places), STAMP_PIXELS, STAMP_PIXELS, 4), np.float32)
        for n, ((x, y), radius, turn) in enumerate(zip(places, radii, turns, strict=True)):
            away = radius * shares[:, None]
            along = to_pixels(x + away * np.cos(angles + turn), y + away * np.sin(angles + turn), len(cells))
            i, j = (np.clip(np.round(at).astype(int), 0, len(cells) - 1) for at in along)
            ends = shares[np.maximum((cells[i, j] != n + 1).argmax(0), 1)]
            ends = ndimage.gaussian_filter1d(radius * ends, 1.0, mode="wrap")
            reach = np.interp(np.arctan2(t, s), angles, ends, period=2 * np.pi)
            c, d = reach * np.cos(turn), reach * np.sin(turn)
            stamps[n, ..., :3] = disc.read(x + c * s - d * t, y + d * s + c * t)
        places, radii, turns = (np.asarray(a, np.float32) for a in (places, radii, turns))
        return cls(places, np.repeat(radii[:, None], 2, 1), turns, stamps)

    def chosen(self, rows: NDArray[np.bool_]) -> Things:
        """The things of some rows."""
        return Things(self.places[rows], self.axes[rows], self.turns[rows], self.stamps[rows])

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


def _stamp_grid() -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """(S, S) both. Places of a stamp's pixels, in half axes along the longer and the shorter axis."""
    step = EXTENT * ((np.arange(STAMP_PIXELS) + 0.5) / STAMP_PIXELS * 2 - 1)
    s, t = np.meshgrid(step, step, indexing="ij")
    return s, t


def _pixels(axes: NDArray[np.floating]) -> NDArray[np.floating]:
    """(2,). Pixels of a stamp with these half axes (2,) per pixel of the disc."""
    return PIXEL * STAMP_PIXELS / (2 * EXTENT * axes)


@njit(cache=True, nogil=True, inline="always")
def within(points, m, middles, axes, long, short, thing):  # type: ignore[no-untyped-def]
    """Where a point is in a thing, in half axes: along the longer one, and across it in the picture's plane and out of
    it."""
    s, t, square = np.float32(0), np.float32(0), np.float32(0)
    for c in range(3):
        d = points[m, c] - middles[thing, c]
        s += d * long[thing, c]
        t += d * short[thing, c]
        square += d * d
    w = np.sqrt(max(square - s * s - t * t, np.float32(0)))
    return s / axes[thing, 0], t / axes[thing, 1], w / axes[thing, 1]


@njit(cache=True, nogil=True, inline="always")
def stamped(stamps, n, s, t, c):  # type: ignore[no-untyped-def]
    """A channel of a stamp at a place in half axes."""
    scale = np.float32(STAMP_PIXELS / (2 * EXTENT))
    top = np.float32(STAMP_PIXELS - 1)
    u = min(max((s + np.float32(EXTENT)) * scale - np.float32(0.5), np.float32(0)), top)
    v = min(max((t + np.float32(EXTENT)) * scale - np.float32(0.5), np.float32(0)), top)
    i, j = min(int(u), STAMP_PIXELS - 2), min(int(v), STAMP_PIXELS - 2)
    a, b = u - np.float32(i), v - np.float32(j)
    low = stamps[n, i, j, c] + b * (stamps[n, i, j + 1, c] - stamps[n, i, j, c])
    high = stamps[n, i + 1, j, c] + b * (stamps[n, i + 1, j + 1, c] - stamps[n, i + 1, j, c])
    return low + a * (high - low)
