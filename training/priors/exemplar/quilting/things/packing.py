"""Ellipsoids in the ball: the seeds of photographs laid as solids.

Every ellipsoid shows a seed of a picture: a point shows the colour that the seed has at the same distance from its
middle, in the direction in which the point lies. So any cut through it shows a whole seed, with its outline all around.
As many are laid as pictures show.
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
from training.priors.exemplar.quilting.things.laying import LATTICE, Lattice, lattice_side, lay
from training.priors.exemplar.quilting.things.stamps import EXTENT, Things, stamped, within

__all__ = ["CLEAR", "Packing", "pack"]

NEAR = np.float32(1.0)
"""Least distance of a seed from what is already laid, over the sum of their radii."""

CLEAR = 1.15
"""Least distance of a seed's middle from a plane in which a picture does not show it, in its longer half axes."""


@dataclass(frozen=True)
class Packing:
    """Ellipsoids that show seeds of pictures."""

    seeds: Sequence[Things]
    """The seeds of each picture."""
    laid: Candidates
    lattice: Lattice
    stamps: NDArray[np.float32]
    """(T, S, S, 4). Stamps of all seeds."""

    def read(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of seeds at points (M, 3), multiplied by how much of the point they cover, and that
        cover. Range [0, 1]."""
        out = np.empty((len(points), 4), np.float32)
        for_spans(_read, len(points), points, *self.laid, *self.lattice, self.stamps, out)
        return out[:, :3], out[:, 3]

    def reduced(self, n: int) -> Packing:
        """The same packing without the detail that pixels of the pictures n times as large do not show."""
        seeds = [some.reduced(n) for some in self.seeds]
        return replace(self, seeds=seeds, stamps=np.concatenate([some.stamps for some in seeds]))


def pack(
    seeds: Sequence[Things],
    fixed: Sequence[Candidates],
    tried: Candidates,
    is_free: Callable[[Candidates], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> Packing | None:
    """Seeds as ellipsoids: those that are `fixed`, and of those that are `tried` and free, as many as are wanted, as
    far as they do not meet; None if there is nothing."""
    tried = tried.chosen(np.argsort(rng.uniform(size=len(tried.stamps)), kind="stable"))
    tried = tried.chosen(is_free(tried))
    count = sum(len(some.stamps) for some in fixed)
    wanted = round(len(tried.stamps) / CANDIDATES)
    tried = Candidates.together([*fixed, tried])
    if not len(tried.stamps):
        return None
    cell = float(2 * EXTENT * tried.axes.max())
    laid = tried.chosen(lay(tried.middles, tried.radii, NEAR, cell, count, wanted))
    lattice = Lattice.reaching(laid.middles, np.float32(EXTENT) * laid.axes.max(1))
    return Packing(seeds, laid, lattice, np.concatenate([some.stamps for some in seeds]))


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
    cell: float,
    starts: NDArray[np.int64],  # [C + 1]
    members: NDArray[np.int64],  # [B]
    stamps: NDArray[np.float32],  # [T, S, S, 4]
    out: NDArray[np.float32],  # [M, 4]
) -> None:
    """Shows the two things with the most power at each point: the square of the half width times 1 - q^2, at q half
    axes."""
    side, one = lattice_side(cell), np.float32(1)
    for m in range(start, stop):
        x = int((points[m, 0] + np.float32(LATTICE)) / cell)
        y = int((points[m, 1] + np.float32(LATTICE)) / cell)
        z = int((points[m, 2] + np.float32(LATTICE)) / cell)
        for c in range(4):
            out[m, c] = np.float32(0)
        if min(x, y, z) < 0 or max(x, y, z) >= side:
            continue
        a, b = -1, -1
        most, next_most = np.float32(-9), np.float32(-9)
        here = (x * side + y) * side + z
        for n in range(starts[here], starts[here + 1]):
            thing = members[n]
            s, t, w = within(points, m, middles, axes, long, short, thing)
            square = s * s + t * t + w * w
            if square >= np.float32(EXTENT * EXTENT):
                continue
            power = axes[thing, 1] * axes[thing, 1] * (one - square)
            if power > most:
                next_most, b = most, a
                most, a = power, thing
            elif power > next_most:
                next_most, b = power, thing
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
        _show(points, m, middles, axes, long, short, a, which, stamps, share, out)
        if b >= 0:
            _show(points, m, middles, axes, long, short, b, which, stamps, one - out[m, 3], out)


@njit(cache=True, nogil=True)
def _show(points, m, middles, axes, long, short, thing, which, stamps, share, out):  # type: ignore[no-untyped-def]
    """Adds a share of what a thing shows at a point, as far as it covers it."""
    s, t, w = within(points, m, middles, axes, long, short, thing)
    flat, one = s * s + t * t, np.float32(1)
    square, n = flat + w * w, which[thing]
    fade = flat + np.float32(AXIS * AXIS)
    # Cuts parallel to the picture's plane have the thing's outline, made smaller.
    smaller = np.sqrt(max(one - w * w, np.float32(0))) + np.float32(1e-3)
    cover = stamped(stamps, n, s / smaller, t / smaller, 3) if w < one else np.float32(0)
    stretched = np.sqrt(square / fade)
    for c in range(3):
        out[m, c] += share * cover * stamped(stamps, n, s * stretched, t * stretched, c)
    out[m, 3] += share * cover
