"""Ellipsoids in the ball: the things of photographs laid as solids.

Every ellipsoid shows a thing of a picture, turned about its longer axis: a point shows the colour that the thing has at
the same distance from its middle, in the direction in which the point lies. So any cut through it shows a whole thing,
with its outline all around. Grains are laid until there is no room, seeds as many as pictures show. Where two meet, the
border is where their powers are equal (a Laguerre tessellation, as in packings of grains).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.things.candidates import CANDIDATES, Candidates
from training.priors.exemplar.quilting.things.core import AXIS
from training.priors.exemplar.quilting.things.stamps import EXTENT, STAMP_PIXELS, Things

__all__ = ["NEAR", "REACHES", "Packing", "pack"]

NEAR = (1.0, 0.5)
"""Least distance of a seed, and of a grain, from what is already laid, over the sum of their radii. Balls that may not
overlap at all fill 0.38 of space when they are laid at random; arils press one another flat."""

REACHES = 1.15
"""How far a grain reaches where there is no other, over its radius: what is left between grains shows chunks."""

MIXED_SIZES = 0.7
"""Grains are laid from large to small, by their radius times a random number from this to 1: small ones fill gaps."""

LATTICE = 1.3
"""Half a side of the lattice in which things are looked up, in radii: the body and a thing's reach."""


@dataclass(frozen=True)
class Packing:
    """Ellipsoids that show things of pictures."""

    laid: Candidates
    stamps: NDArray[np.float32]
    """(T, S, S, 4). Stamps of all things."""
    cell: float
    starts: NDArray[np.int64]
    """(C + 1,). Where the things of each cell of a lattice start in `members`."""
    members: NDArray[np.int64]
    """(M,). Rows of the things that are laid, cell after cell."""

    def read(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of things at points (M, 3), multiplied by how much of the point they cover, and that
        cover. Range [0, 1]."""
        out = np.empty((len(points), 4), np.float32)
        laid = self.laid
        frames = laid.middles, laid.axes, laid.long, laid.short
        lattice = self.starts, self.members, self.cell
        for_spans(_read, len(points), points, *frames, laid.stamps, laid.are_close, *lattice, self.stamps, out)
        return out[:, :3], out[:, 3]

    def reduced(self, things: Sequence[Things]) -> Packing:
        """The same packing of the same things, which are given in less detail."""
        return replace(self, stamps=np.concatenate([t.stamps for t in things]))


def pack(
    things: Sequence[Things],
    fixed: Sequence[Candidates],
    tried: Candidates,
    is_free: Callable[[Candidates], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> Packing | None:
    """Things as ellipsoids: those that are `fixed`, and of those that are `tried` and free, as far as they do not meet,
    all grains and as many seeds as are wanted; None if there is nothing."""
    order = np.where(tried.are_close, -tried.radii, 1) * rng.uniform(MIXED_SIZES, 1, len(tried.radii))
    tried = tried.chosen(np.argsort(order, kind="stable"))
    tried = tried.chosen(is_free(tried))
    count = sum(len(some.stamps) for some in fixed)
    seeds = round((~tried.are_close).sum() / CANDIDATES)
    tried = Candidates.together([*fixed, tried])
    if not len(tried.stamps):
        return None
    cell = float(2 * REACHES * tried.axes.max())
    laid = tried.chosen(_laid(tried.middles, tried.radii, tried.are_close, count, seeds, cell))
    side = _lattice(cell)
    at = np.clip(((laid.middles + LATTICE) / np.float32(cell)).astype(np.int64), 0, side - 1)
    number = (at[:, 0] * side + at[:, 1]) * side + at[:, 2]
    members = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[members], np.arange(side**3 + 1))
    return Packing(laid, np.concatenate([t.stamps for t in things]), cell, starts, members)


@njit(cache=True)
def _lattice(cell: float) -> int:
    """Cells along a side of the lattice in which things are looked up."""
    return int(2 * LATTICE / cell) + 1


@njit(cache=True)
def _laid(
    middles: NDArray[np.float32],  # [M, 3]
    radii: NDArray[np.float32],  # [M]
    are_close: NDArray[np.bool_],  # [M]
    fixed: int,
    seeds: int,
    cell: float,
) -> NDArray[np.bool_]:
    """(M,). Which of the things are laid: the first `fixed` ones, and every other that is far enough from all before
    it, up to a number of `seeds`."""
    side = _lattice(cell)
    first = np.full(side * side * side, -1, np.int64)
    following = np.full(len(radii), -1, np.int64)
    laid = np.zeros(len(radii), np.bool_)
    for b in range(len(radii)):
        x = int((middles[b, 0] + np.float32(LATTICE)) / cell)
        y = int((middles[b, 1] + np.float32(LATTICE)) / cell)
        z = int((middles[b, 2] + np.float32(LATTICE)) / cell)
        free = are_close[b] or seeds > 0
        near = np.float32(NEAR[1] if are_close[b] else NEAR[0])
        for i in range(max(x - 1, 0), min(x + 2, side)):
            for j in range(max(y - 1, 0), min(y + 2, side)):
                for k in range(max(z - 1, 0), min(z + 2, side)):
                    other = first[(i * side + j) * side + k]
                    while other >= 0:
                        away = np.float32(0)
                        for c in range(3):
                            d = middles[other, c] - middles[b, c]
                            away += d * d
                        least = near * (radii[other] + radii[b])
                        free = free and away >= least * least
                        other = following[other]
        if free or b < fixed:
            laid[b] = True
            seeds -= b >= fixed and not are_close[b]
            here = (x * side + y) * side + z
            following[b] = first[here]
            first[here] = b
    return laid


@njit(cache=True, nogil=True)
def _read(
    start: int,
    stop: int,
    points: NDArray[np.float32],  # [M, 3]
    middles: NDArray[np.float32],  # [B, 3]
    axes: NDArray[np.float32],  # [B, 2]
    long: NDArray[np.float32],  # [B, 3]
    short: NDArray[np.float32],  # [B, 3]
    which: NDArray[np.int64],  # [B]
    are_close: NDArray[np.bool_],  # [B]
    starts: NDArray[np.int64],  # [C + 1]
    members: NDArray[np.int64],  # [B]
    cell: float,
    stamps: NDArray[np.float32],  # [T, S, S, 4]
    out: NDArray[np.float32],  # [M, 4]
) -> None:
    """Shows the two things with the most power at each point: the square of the half width times 1 - q^2, at q half
    axes."""
    side, one = _lattice(cell), np.float32(1)
    for m in range(start, stop):
        x = int((points[m, 0] + np.float32(LATTICE)) / cell)
        y = int((points[m, 1] + np.float32(LATTICE)) / cell)
        z = int((points[m, 2] + np.float32(LATTICE)) / cell)
        a, b = -1, -1
        most, next_most = np.float32(-9), np.float32(-9)
        for i in range(max(x - 1, 0), min(x + 2, side)):
            for j in range(max(y - 1, 0), min(y + 2, side)):
                for k in range(max(z - 1, 0), min(z + 2, side)):
                    here = (i * side + j) * side + k
                    for n in range(starts[here], starts[here + 1]):
                        thing = members[n]
                        s, t, w = _within(points, m, middles, axes, long, short, thing)
                        square = s * s + t * t + w * w
                        reach = np.float32(REACHES) if are_close[thing] else np.float32(EXTENT)
                        if square >= reach * reach:
                            continue
                        power = axes[thing, 1] * axes[thing, 1] * (one - square)
                        if power > most:
                            next_most, b = most, a
                            most, a = power, thing
                        elif power > next_most:
                            next_most, b = power, thing
        for c in range(4):
            out[m, c] = np.float32(0)
        if a < 0:
            continue
        share = one
        if b >= 0:
            apart = np.float32(0)
            for c in range(3):
                d = middles[a, c] - middles[b, c]
                apart += d * d
            # Half of the difference of powers over the distance of the middles is the distance from the border.
            beyond = (most - next_most) / (np.float32(2) * max(np.sqrt(apart), np.float32(1e-4)))
            share = np.float32(0.5) + np.float32(0.5) * min(beyond / BLEND, one)
        _show(points, m, middles, axes, long, short, a, which, are_close[a], stamps, share, out)
        if b >= 0:
            _show(points, m, middles, axes, long, short, b, which, are_close[b], stamps, one - out[m, 3], out)
        if are_close[a]:
            half = axes[a, 1]
            away = np.sqrt(max(half * half - most, np.float32(0)))
            fade = min(max((half * np.float32(REACHES) - away) / BLEND, np.float32(0)), one)
            for c in range(4):
                out[m, c] *= fade


@njit(cache=True, nogil=True, inline="always")
def _within(points, m, middles, axes, long, short, thing):  # type: ignore[no-untyped-def]
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


@njit(cache=True, nogil=True)
def _show(points, m, middles, axes, long, short, thing, which, is_close, stamps, share, out):  # type: ignore[no-untyped-def]
    """Adds a share of what a thing shows at a point, as far as it covers it."""
    s, t, w = _within(points, m, middles, axes, long, short, thing)
    flat, one = s * s + t * t, np.float32(1)
    square, n = flat + w * w, which[thing]
    fade = flat + np.float32(AXIS * AXIS)
    cover = one
    if not is_close:
        # Cuts parallel to the picture's plane have the thing's outline, made smaller.
        smaller = np.sqrt(max(one - w * w, np.float32(0))) + np.float32(1e-3)
        cover = _stamped(stamps, n, s / smaller, t / smaller, 3) if w < one else np.float32(0)
    stretched = np.sqrt(square / fade)
    for c in range(3):
        out[m, c] += share * cover * _stamped(stamps, n, s * stretched, t * stretched, c)
    out[m, 3] += share * cover


@njit(cache=True, nogil=True, inline="always")
def _stamped(stamps, n, s, t, c):  # type: ignore[no-untyped-def]
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
