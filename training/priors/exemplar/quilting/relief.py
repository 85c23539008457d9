"""What a face shows beside its plane: closed things as solids.

This applies the law of shape (`persistence`) at every distance: a closed thing is as tall as it is wide, so its outline
closes with the distance from the plane, and beyond its end its surroundings show. Every pixel has the height at which
its colour gives way to that of the median around it, for medians of a few widths: a seed gives way to the carpel that
holds it, and that to flesh. So a thing ends as a solid does, with an edge as sharp as the picture's, and no seam has to
cut it off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from skimage.morphology import remove_small_objects

from engine.threads import for_spans
from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    PIXEL,
    THING_CONTRAST,
    Disc,
    Medians,
    disc_radius,
    enlarged,
    filled_in,
    to_pixels,
)
from training.priors.exemplar.sampling import lengths, opened, reduced

__all__ = ["BLEND", "NARROWEST", "TYPICAL", "Relief"]

WIDTHS = (0.05, 0.12, 0.22)
"""Radii of the medians to which the colours of a picture give way, one after the other, in radii of the disc: for
seeds, carpels and cores."""

STEPS = 5
"""Steps between two of these widths, at which medians tell the height at which one gives way to the next."""

ROUND = np.float32(np.sqrt(2))
"""Radius of the median at a distance, over that distance: a round thing is gone from the median over a disc of sqrt(2)
half widths."""

CALM = 2.0
"""How many times the spread of colours around it a thing's contrast must exceed for it to close at all: a seed lies in
flesh, but arils lie among arils, and their median is the colour of none. At 1 pomegranates turn to mush (features 0.1
worse)."""

AROUND = 2.0
"""Radius in which that spread is taken, over that of the median: the thing itself must be a small part of it."""

NEVER = 2.0
"""Height in radii that stands for what does not close."""

NO_CONTRAST = 0.03
"""RGB distance below which two colours count as one: then the first gives way as soon as it may."""

CLOSED = 0.5
"""Height in radii up to which what stands out is closed: the widest closed thing has a half width of 0.22."""

LEAST_CONTRAST, TYPICAL = 0.08, 3.5
"""Least RGB distance of a thing from what shows beyond its end, and least multiple of the median distance in the same
picture: as for the details of layers. With less, an orange's juice sacs are things."""

CLOSE = np.float32(0.01)
"""Distance in radii at which what lies between the parts of a thing that is laid whole ends."""

NARROWEST = 0.01
"""Least half width of a thing in radii: anything narrower is texture."""

BLEND = np.float32(0.006)
"""Distance in radii over which a colour gives way to the next: a pixel and a half of the disc."""


@dataclass(frozen=True)
class Relief:
    """A face at every distance from its plane."""

    levels: NDArray[np.float32]
    """(len(WIDTHS) + 1, P, P, 4). Colours of the picture and of the medians to which it gives way, and the strength of
    their texture."""
    heights: NDArray[np.float32]
    """(P, P, len(WIDTHS)). Distances in radii at which each level gives way to the next."""

    @classmethod
    def of(cls, disc: Disc, strength: Disc, rind: float) -> Relief:
        """The relief of a face with texture of this strength and a rind of this depth in radii; everything in it is
        taken for a closed thing."""
        face = Medians(disc.rgb)
        medians = [face.over(width) for width in WIDTHS]
        ends: list[NDArray[np.floating]] = []
        for n in range(len(WIDTHS)):
            ends.append(_end(disc.rgb, face, medians, n, ends))
        of_strength = Medians(strength.rgb[..., :1])
        first = np.concatenate([disc.rgb, strength.rgb[..., :1]], -1)
        after = [_level(median, of_strength.over(width)) for median, width in zip(medians, WIDTHS, strict=True)]
        made = cls(np.stack([first, *after]), _heights(ends, rind))
        # The function for small holes suppresses warnings of the whole process, which threads must not do.
        open_parts = made.closed_until(rind) < 0
        closed = ~remove_small_objects(open_parts, max_size=round(np.pi * (WIDTHS[1] / PIXEL) ** 2))
        if not closed.any():
            return made
        # Among several things, as in a star, a median as wide as the widest has the colour of none of them.
        medians[-1] = Medians(filled_in(disc.rgb, closed)).over(WIDTHS[-1])
        ends[-1] = _end(disc.rgb, face, medians, len(WIDTHS) - 1, ends[:-1])
        made.levels[-1] = _level(medians[-1], of_strength.over(WIDTHS[-1]))
        return cls(made.levels, _heights(ends, rind))

    def closed_until(self, rind: float) -> NDArray[np.floating]:
        """(P, P). Distance in radii up to which each pixel shows a closed thing; -1 where there is none. What touches a
        rind of this depth is no closed thing: flesh stands out there from the colours of both."""
        apart = lengths(self.levels[:-1, ..., :3] - self.levels[-1, ..., :3])
        radius = disc_radius()
        least = np.maximum(LEAST_CONTRAST, TYPICAL * np.median(apart[:, radius < 1], axis=1))
        heights = np.moveaxis(self.heights, -1, 0)
        in_rind = radius > 1 - rind
        until = np.where((apart > least[:, None, None]) & ((heights < CLOSED) | in_rind), heights, -1).max(0)
        pixels = round(NARROWEST / PIXEL)
        parts, _ = ndimage.label(opened(until > 0, pixels))
        held = np.bincount(parts[in_rind], minlength=parts.max() + 1) == 0
        return np.where((parts > 0) & held[parts], until, -1)

    def contrast(self) -> NDArray[np.floating]:
        """(P, P). How far each pixel stands out from what is left where all things have ended, over the least that
        counts; 0 outside of the face."""
        inside = disc_radius() < 1
        apart = lengths(self.levels[0, ..., :3] - self.levels[-1, ..., :3]) * inside
        return apart / max(THING_CONTRAST, TYPICAL * float(np.median(apart[inside])))

    def closing(
        self,
        disc: Disc,
        strength: Disc,
        region: NDArray[np.bool_],
        hidden: NDArray[np.bool_],
        end: np.float32 = CLOSE,
    ) -> Relief:
        """The relief of this face (`disc`), changed so that the pixels in a region (P, P) close at a distance `end` in
        radii from the plane, all at once, to the surroundings of all that is hidden (P, P)."""
        last = np.concatenate([disc.rgb, strength.rgb[..., :1]], -1)
        last = enlarged(Medians(filled_in(last, hidden)).over(WIDTHS[-1]))
        ends = np.full(len(WIDTHS), end - BLEND, np.float32)
        ends[0] = end  # when the first level gives way, none of the others is left to show
        at = np.where(region[..., None], np.minimum(self.heights, ends), self.heights)
        return replace(self, levels=np.concatenate([self.levels[:-1], last[None]]).astype(np.float32), heights=at)

    def read(
        self, x: NDArray[np.floating], y: NDArray[np.floating], distance: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(M, 4). Colours and strength of texture at places (M,), (M,) at distances (M,) from the plane, in radii."""
        rows, columns = (np.asarray(a, np.float32) for a in to_pixels(x, y, self.levels.shape[1]))
        out = np.empty((len(rows), 4), np.float32)
        away = np.asarray(distance, np.float32)
        for_spans(_read_relief, len(out), self.levels, self.heights, rows, columns, away, out)
        return out

    def reduced(self, n: int) -> Relief:
        """The relief with pixels n times as large."""
        return replace(
            self, levels=np.stack([reduced(level, n) for level in self.levels]), heights=reduced(self.heights, n)
        )


def _level(median: NDArray[np.float32], strength: NDArray[np.float32]) -> NDArray[np.float32]:
    """(P, P, 4). A level of a relief, of the medians (H, W, 3) of its colours and (H, W, 1) of its strength."""
    return enlarged(np.concatenate([median, strength], -1))


def _heights(ends: list[NDArray[np.floating]], rind: float) -> NDArray[np.float32]:
    """(P, P, L). The heights of a relief whose colours give way at these radii (H, W) of medians: what closes takes
    along what lies in it. A rind of this depth in radii does not close."""
    lowest = list(accumulate(ends[::-1], np.minimum))[::-1]
    heights = enlarged(np.stack(lowest, -1).astype(np.float32)) / ROUND
    return np.where(disc_radius()[..., None] > 1 - rind, np.float32(NEVER), heights)


def _end(
    rgb: NDArray[np.float32],
    face: Medians,
    medians: list[NDArray[np.float32]],
    n: int,
    ends: list[NDArray[np.floating]],
) -> NDArray[np.floating]:
    """(H, W). Radius at which the colours before the n-th median of a face `rgb` (P, P, 3) give way to that median;
    `ends` are the radii of the medians before."""
    after, width, start = medians[n], WIDTHS[n], WIDTHS[n - 1] if n else 0.0
    fine = reduced(rgb, DISC_PIXELS // after.shape[0])
    before = medians[n - 1] if n else fine
    radii = np.linspace(start, width, STEPS + 1)
    given = [np.zeros(before.shape[:2])]
    for radius in radii[1:-1]:
        here = face.over(radius)
        left, right = (lengths(here - there) for there in (before, after))
        given.append(left / (left + right + 1e-3))
    given.append(np.ones(before.shape[:2]))
    height = _half_way(np.maximum.accumulate(np.stack(given), axis=0), radii)
    contrast = lengths(before - after)
    unlike = enlarged(lengths(fine - after)[..., None])
    calm = 1 - CALM * Medians(unlike).over(AROUND * width)[..., 0] / (contrast + 0.01)
    height = np.where(calm > 0, np.minimum(height / np.maximum(calm, 0.01), NEVER), NEVER)
    weight = contrast**2 / (contrast**2 + NO_CONTRAST**2)
    return weight * height + (1 - weight) * (ends[-1] if ends else 0)


def _half_way(given: NDArray[np.floating], radii: NDArray[np.floating]) -> NDArray[np.floating]:
    """(H, W). Radius between `radii` (N,) at which `given` (N, H, W), which rises from 0 to 1, is a half."""
    last = np.maximum((given < 0.5).sum(0) - 1, 0)
    low, high = (np.take_along_axis(given, (last + n)[None], 0)[0] for n in (0, 1))
    part = np.clip((0.5 - low) / np.maximum(high - low, 1e-6), 0, 1)
    return radii[last] + part * (radii[last + 1] - radii[last])


@njit(cache=True, nogil=True)
def _read_relief(
    start: int,
    stop: int,
    levels: NDArray[np.float32],  # [L + 1, H, W, 4]
    heights: NDArray[np.float32],  # [H, W, L]
    rows: NDArray[np.float32],  # [M]
    columns: NDArray[np.float32],  # [M]
    distance: NDArray[np.float32],  # [M]
    out: NDArray[np.float32],  # [M, 4]
) -> None:
    height, width, count = heights.shape
    for m in range(start, stop):
        u = min(max(rows[m], np.float32(0)), np.float32(height - 1))
        v = min(max(columns[m], np.float32(0)), np.float32(width - 1))
        i, j = min(int(u), height - 2), min(int(v), width - 2)
        a, b = u - np.float32(i), v - np.float32(j)
        rest = np.float32(1)
        for c in range(4):
            out[m, c] = np.float32(0)
        for n in range(count + 1):
            share = rest
            if n < count:
                low = heights[i, j, n] + b * (heights[i, j + 1, n] - heights[i, j, n])
                high = heights[i + 1, j, n] + b * (heights[i + 1, j + 1, n] - heights[i + 1, j, n])
                t = (low + a * (high - low) - distance[m]) / BLEND + np.float32(0.5)
                t = min(max(t, np.float32(0)), np.float32(1))
                share = rest * t
            if share > 0:
                for c in range(4):
                    low = levels[n, i, j, c] + b * (levels[n, i, j + 1, c] - levels[n, i, j, c])
                    high = levels[n, i + 1, j, c] + b * (levels[n, i + 1, j + 1, c] - levels[n, i + 1, j, c])
                    out[m, c] += share * (low + a * (high - low))
                rest -= share
            if rest <= 0:
                break
