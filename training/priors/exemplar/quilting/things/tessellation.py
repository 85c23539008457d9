"""Grains that fill the chambers of a body, pressed against one another.

They are the cells of a Laguerre tessellation (as in packings of grains), which end at the walls of their chamber. Every
cell shows a grain of a picture, whose cells are bent to discs: on the ray from a grain's middle through a point, the
point lies at some share of the way to the border, and shows what the disc has at that share of its radius. So every cut
shows whole grains, with their rims all around. A grain is turned about its longer axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans
from training.priors.exemplar.quilting.relief import BLEND
from training.priors.exemplar.quilting.things.candidates import Candidates, Placed
from training.priors.exemplar.quilting.things.chambers import Chambers
from training.priors.exemplar.quilting.things.laying import LATTICE, Lattice, lattice_side, lay
from training.priors.exemplar.quilting.things.stamps import Things, stamped, within

__all__ = ["REACHES", "TIMES", "Tessellation", "off_plane"]

NEAR = np.float32(0.75)
"""Least distance of two grains over the sum of their radii. Balls that are laid at random until no more fit fill 0.38
of space. N random cells in a volume are cut into 1.46 N^(2/3) in an area (Meijering 1953), so with balls SECTION times
as large as the picture's grains this is the distance at which cuts have as many grains as the picture."""

TIMES = 50
"""How many times as many grains are tried as pictures say: of chambers of two pairs 0.98 and 0.96 are filled, with
twice as many 0.99 and 0.97, with half as many 0.97 and 0.94."""

REACHES = 1.3
"""How far a grain reaches where there is no other, over its radius: arils that are not pressed are round."""

MIDDLE = 0.3
"""Least distance of a grain's middle from the wall of its chamber, over its radius."""

BULGE = 0.3
"""How far a grain bulges out of its chamber, over its radius: half a membrane, and what the blur of chambers takes."""

MIXED_SIZES = 0.7
"""Grains are laid from large to small, by their radius times a random number from this to 1: small ones fill gaps."""

MOST_OFF = 0.7
"""Largest distance of the middle of a picture's own grain from its plane, over the grain's radius: any is as likely."""

SIDES = np.float32(1.0)
"""Width of the blend of a grain's two halves around its longer axis, in cosines: seams would show as cracks."""

THINNEST = np.float32(0.02)
"""Least distance to the wall in radii by which that to a point is divided: a cell of the grid of walls."""


@dataclass(frozen=True)
class Tessellation:
    """Grains that show those of pictures."""

    grains: Sequence[Things]
    """The grains of each picture."""
    laid: Candidates
    fixed: int
    """How many of these, the first ones, lie in own planes: those end where own planes show walls, but not at walls
    elsewhere, which other pictures may have moved."""
    lattice: Lattice
    chambers: Chambers
    room: NDArray[np.float32]
    """(B,). Distances from the middles of grains to the walls of their chambers."""
    beside: NDArray[np.float32]
    """(B,). Their distances to where own planes nearby show walls (`room_beside`)."""
    stamps: NDArray[np.float32]
    """(T, S, S, 4). Stamps of all grains."""

    @classmethod
    def of(
        cls,
        grains: Sequence[Things],
        fixed: Sequence[Candidates],
        tried: Candidates,
        chambers: Chambers,
        beside: Callable[[NDArray[np.float32]], NDArray[np.float32]],
        rng: np.random.Generator,
    ) -> Tessellation:
        """Grains that are `fixed`, and as many of those that are `tried` as there is room for in chambers. `beside`:
        distances (M,) of points (M, 3) to where own planes nearby show walls."""
        tried = tried.chosen(chambers.at(tried.middles) > MIDDLE * tried.radii)
        order = -tried.radii * rng.uniform(MIXED_SIZES, 1, len(tried.radii))
        tried = Candidates.together([*fixed, tried.chosen(np.argsort(order, kind="stable"))])
        count = sum(len(some.stamps) for some in fixed)
        cell = float(2 * REACHES * tried.radii.max(initial=0.01))
        laid = tried.chosen(lay(tried.middles, tried.radii, NEAR, cell, count, len(tried.radii)))
        stamps = np.concatenate([some.stamps for some in grains])
        room = chambers.at(laid.middles)
        return cls(grains, laid, count, Lattice.of(laid.middles, cell), chambers, room, beside(laid.middles), stamps)

    def read(
        self, points: NDArray[np.float32], shown: NDArray[np.float32], beside: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of grains at points (M, 3), multiplied by how much of the point they cover, and that
        cover, which is at most how much of them is to be `shown` (M,). Range [0, 1]. `beside` (M,): distances of the
        points to where own planes nearby show walls."""
        out = np.empty((len(points), 4), np.float32)
        walls = self.chambers.at(points)
        laid = *self.laid, self.room, self.beside, self.fixed
        for_spans(_read, len(out), points, shown, walls, beside, *laid, *self.lattice, self._balls, self.stamps, out)
        return out[:, :3], out[:, 3]

    @cached_property
    def _balls(self) -> NDArray[np.float32]:
        """(B, 4). Middles and squared radii of the grains, in the order of the lattice's members: those that are looked
        at together lie side by side."""
        balls = np.concatenate([self.laid.middles, self.laid.axes[:, 1:] ** 2], axis=1)
        return np.ascontiguousarray(balls[self.lattice.members])

    def reduced(self, n: int) -> Tessellation:
        """The same grains without the detail that pixels of the pictures n times as large do not show."""
        grains = [some.reduced(n) for some in self.grains]
        return replace(self, grains=grains, stamps=np.concatenate([some.stamps for some in grains]))


def off_plane(placed: Placed, rng: np.random.Generator) -> Candidates:
    """A picture's own grains, with their middles anywhere before or behind its plane and larger by so much that their
    cuts by it, and the borders between these, stay the same: on the plane, all their powers change by nothing."""
    laid = placed.laid
    part = rng.uniform(-MOST_OFF, MOST_OFF, len(laid.stamps))
    larger = 1 / np.sqrt(1 - part * part)
    middles = laid.middles + (part * larger * laid.radii)[:, None] * placed.normal
    return laid._replace(middles=middles.astype(np.float32), axes=(laid.axes * larger[:, None]).astype(np.float32))


@njit(cache=True, nogil=True)
def _read(
    start: int,
    stop: int,
    points: NDArray[np.float32],  # [M, 3]
    shown: NDArray[np.float32],  # [M]
    walls: NDArray[np.float32],  # [M]
    beside: NDArray[np.float32],  # [M]
    middles: NDArray[np.float32],  # [B, 3]
    axes: NDArray[np.float32],  # [B, 2]
    long: NDArray[np.float32],  # [B, 3]
    short: NDArray[np.float32],  # [B, 3]
    which: NDArray[np.int64],  # [B]
    room: NDArray[np.float32],  # [B]
    room_beside: NDArray[np.float32],  # [B]
    fixed: int,
    cell: float,
    starts: NDArray[np.int64],  # [C + 1]
    members: NDArray[np.int64],  # [B]
    balls: NDArray[np.float32],  # [B, 4]
    stamps: NDArray[np.float32],  # [T, S, S, 4]
    out: NDArray[np.float32],  # [M, 4]
) -> None:
    """Shows the grain with the most power at each point: the square of its radius less that of the distance. No grain
    reaches farther than half a cell, and one that does not reach the point has less power than one that does."""
    side, zero, one = lattice_side(cell), np.float32(0), np.float32(1)
    reach = 0.5001 * cell  # rounding must not lose what ends at a cell's side
    for m in range(start, stop):
        for c in range(4):
            out[m, c] = zero
        if shown[m] <= zero:
            continue
        x, y, z = points[m]
        shown_by, most = -1, np.float32(-9)
        first_z, last_z = _cells(z, reach, cell, side)
        for i in range(*_cells(x, reach, cell, side)):
            for j in range(*_cells(y, reach, cell, side)):
                for n in range(starts[(i * side + j) * side + first_z], starts[(i * side + j) * side + last_z]):
                    power = _power(x, y, z, balls[n])
                    if power > most:
                        shown_by, most = n, power
        if shown_by < 0:
            continue
        grain = members[shown_by]
        radius = axes[grain, 1]
        away = np.sqrt(max(radius * radius - most, zero))
        ends = radius * np.float32(REACHES)
        inside = min(ends - away, beside[m])
        if inside <= zero:
            continue
        share = max(away / ends, one - beside[m] / max(room_beside[grain], THINNEST))
        if grain >= fixed:
            bulge = np.float32(BULGE) * radius
            here = walls[m] + bulge
            inside = min(inside, here)
            if inside <= zero:
                continue
            share = max(share, one - here / max(room[grain] + bulge, THINNEST))
        # Along a ray from the grain's middle, its lead over another one's power falls evenly, to 0 at their border.
        u, v, w, power_there = balls[shown_by]
        first_z, last_z = _cells(z, cell, cell, side)
        for i in range(*_cells(x, cell, cell, side)):
            for j in range(*_cells(y, cell, cell, side)):
                for n in range(starts[(i * side + j) * side + first_z], starts[(i * side + j) * side + last_z]):
                    if n != shown_by:
                        first = power_there - _power(u, v, w, balls[n])
                        lead = most - _power(x, y, z, balls[n])
                        share = max(share, one - lead / max(first, np.float32(1e-6)))
        cover = shown[m] * min(inside / BLEND, one)
        _show(points, m, middles, axes, long, short, grain, which, stamps, min(share, one), cover, out)


@njit(cache=True, nogil=True, inline="always")
def _cells(at, reach, cell, side):  # type: ignore[no-untyped-def]
    """The first of the lattice's cells that a place reaches along an axis, and the one after the last."""
    low, high = (at + np.float32(LATTICE) - reach) / cell, (at + np.float32(LATTICE) + reach) / cell
    return max(int(low), 0), min(int(high) + 1, side)


@njit(cache=True, nogil=True, inline="always")
def _power(x, y, z, ball):  # type: ignore[no-untyped-def]
    """The power of a grain at a point."""
    right, high, up = x - ball[0], y - ball[1], z - ball[2]
    return ball[3] - (right * right + high * high + up * up)


@njit(cache=True, nogil=True)
def _show(points, m, middles, axes, long, short, grain, which, stamps, share, cover, out):  # type: ignore[no-untyped-def]
    """What a grain shows at a point, at this share of the way from its middle to its border."""
    s, t, w = within(points, m, middles, axes, long, short, grain)
    off, n = np.sqrt(t * t + w * w), which[grain]
    scale = share / np.sqrt(s * s + off * off + np.float32(1e-12))
    s, half = s * scale, off * scale
    side = np.float32(0.5) + t / (max(off, np.float32(1e-6)) * SIDES)
    side = min(max(side, np.float32(0)), np.float32(1))
    for c in range(3):
        one = stamped(stamps, n, s, half, c)
        out[m, c] = cover * (one + (np.float32(1) - side) * (stamped(stamps, n, s, -half, c) - one))
    out[m, 3] = cover
