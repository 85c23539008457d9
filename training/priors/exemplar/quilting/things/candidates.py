"""Where things of photographs may lie as solids, and in which direction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import Ball
from training.priors.exemplar.quilting.things.stamps import Things

__all__ = ["CANDIDATES", "SECTION", "Candidates", "Placed", "in_own_planes", "strewn"]

SECTION = 4 / np.pi
"""Radius of a ball over the mean radius of its cuts by random planes, which is what a picture shows."""

CANDIDATES = 6
"""How many times as many seeds are tried as are wanted: where they are strewn in a ring, many meet one that lies there
already."""

INSIDE = 0.95
"""Largest distance of a thing's middle from that of the body."""

ROWS = 0.15
"""Standard deviation, in radians around the axis, of seeds from the directions in which a horizontal picture has them:
fruits have them in rows along the axis, so that one radial cut shows a row and the next none. With seeds strewn all
around, features of radial cuts of two pairs of melons are 0.16 and 0.01 farther from photographs."""

LEVELS = 64
"""Number of distances from the axis at which the place in a horizontal picture is looked up."""


class Candidates(NamedTuple):
    """Ellipsoids in whose form things may be laid."""

    middles: NDArray[np.float32]
    """(M, 3). In the unit ball."""
    axes: NDArray[np.float32]
    """(M, 2). Half axes in radii: the longer one, and the two equal ones across it."""
    long: NDArray[np.float32]
    """(M, 3). Direction of the longer axis."""
    short: NDArray[np.float32]
    """(M, 3). Direction of the shorter axis that lies in the picture's plane."""
    stamps: NDArray[np.int64]
    """(M,). Number of the thing that each shows."""

    def chosen(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Candidates:
        """The candidates of some rows."""
        return Candidates._make(field[rows] for field in self)

    @classmethod
    def together(cls, some: Sequence[Candidates]) -> Candidates:
        """All candidates of some sets, at least one."""
        return cls._make(np.concatenate(fields) for fields in zip(*some, strict=True))

    @property
    def radii(self) -> NDArray[np.float32]:
        """(M,). Radii of discs as large as their cuts in the pictures' planes."""
        return np.sqrt(self.axes.prod(1))


def strewn(
    pictures: Sequence[Things], horizontal: int, times: float, rng: np.random.Generator, *, in_rows: bool
) -> Candidates:
    """Things strewn wherever their pictures may be shown, so many times as many as the pictures say.

    `horizontal`: how many of the pictures, the first ones, are horizontal. `in_rows`: in the directions from the axis
    in which these have them, and not all around. Where a picture shows N_A things in an area, there are N_A / 2b in a
    volume, for things of half width b across the picture's plane (Saltykov).
    """
    found, first = [], 0
    for n, things in enumerate(pictures):
        is_horizontal = n < horizontal
        wide = 2 * SECTION * things.axes[:, 1].astype(np.float64)
        # A horizontal picture stands for all heights, each half of a radial one for half a turn.
        copies = np.where(is_horizontal, 2.0, np.pi * np.abs(things.places[:, 0])) / wide
        count = times / len(pictures) * copies
        which = np.repeat(np.arange(len(count)), np.floor(count + rng.uniform(size=len(count))).astype(int))
        place, axes = things.places[which], SECTION * things.axes[which]
        moved = rng.standard_normal((len(which), 2)) * 0.5 * axes[:, 1:]
        if is_horizontal:
            height: NDArray[np.floating] = rng.uniform(-INSIDE, INSIDE, len(which))
            out = _out_at(np.hypot(*place.T), height) + moved[:, 0]
        else:
            height = place[:, 1] + moved[:, 1]
            out = np.abs(place[:, 0]) + moved[:, 0]
        turn = rng.uniform(0, 2 * np.pi, len(which))
        if is_horizontal and in_rows:  # other individuals than the first are turned as a whole
            turn = np.arctan2(place[:, 1], place[:, 0]) + ROWS * rng.standard_normal(len(which)) + min(n, 1) * turn[:1]
        middles = np.stack([np.abs(out) * np.cos(turn), np.abs(out) * np.sin(turn), height], -1)
        found.append(_placed(things, which, middles, axes, is_horizontal, first))
        first += len(things.places)
    together = Candidates.together(found)
    return together.chosen(np.linalg.norm(together.middles, axis=1) < INSIDE)  # not NaN, either


class Placed(NamedTuple):
    """The things of a picture where its own plane shows them."""

    laid: Candidates
    normal: NDArray[np.float64]
    """(3,). The plane's normal."""

    @property
    def is_horizontal(self) -> bool:
        """Whether the plane lies across the axis."""
        return bool(self.normal[2])


def in_own_planes(own: Sequence[Things], heights: Sequence[float], first: int) -> list[Placed]:
    """The things of each picture where its own plane shows them.

    `own`: the things of the pictures at these heights (none or one), then of those in planes evenly spread over half a
    turn. Their stamps are numbered from `first`.
    """
    found = []
    for n, things in enumerate(own):
        which = np.arange(len(things.places))
        if n < len(heights):
            height = np.full(len(which), heights[n])
            share = np.hypot(*things.places.T)
            out = _out_at(share, height)
            out = np.where(np.isnan(out), share, out)  # next to the axis
            middles = np.column_stack([_directions(things.places) * out[:, None], height])
            normal = np.array([0.0, 0.0, 1.0])
        else:
            turn, (x, y) = (n - len(heights)) * np.pi / (len(own) - len(heights)), things.places.T
            middles = np.stack([x * np.cos(turn), x * np.sin(turn), y], -1)
            normal = np.array([-np.sin(turn), np.cos(turn), 0.0])
        found.append(Placed(_placed(things, which, middles, things.axes, n < len(heights), first), normal))
        first += len(which)
    return found


def _placed(
    things: Things,
    which: NDArray[np.integer],
    middles: NDArray[np.floating],
    axes: NDArray[np.floating],
    is_horizontal: bool,
    first: int,
) -> Candidates:
    """The things `which` (M,), laid around middles (M, 3): what points outwards in the picture does so in the ball."""
    out, x = _directions(middles[:, :2]), things.places[which, 0]
    outwards = np.column_stack([out, np.zeros(len(out))])
    if is_horizontal:
        across = np.column_stack([-out[:, 1], out[:, 0], np.zeros(len(out))])
        c, s = _directions(things.places[which]).T[..., None]
        right, up = c * outwards - s * across, s * outwards + c * across
    else:  # outwards is to the picture's nearer side
        right, up = np.where(x < 0, -1, 1)[:, None] * outwards, np.array([[0.0, 0.0, 1.0]])
    c, s = (f(things.turns[which])[:, None] for f in (np.cos, np.sin))
    frames = (np.asarray(a, np.float32) for a in (middles, axes, c * right + s * up, c * up - s * right))
    return Candidates._make((*frames, which + first))


def _out_at(shares: NDArray[np.floating], heights: NDArray[np.floating]) -> NDArray[np.float64]:
    """(M,). Distances from the axis, at heights (M,) in the ball, of the places `shares` (M,) of the radius from the
    middle of a horizontal picture; NaN where there is none: towards the poles everything is closer to the skin."""
    part = (np.arange(LEVELS) + 0.5) / LEVELS
    out = part * np.sqrt(1 - np.square(heights))[:, None]
    points = np.stack([out, np.zeros_like(out), np.broadcast_to(heights[:, None], out.shape)], -1)
    levels = Ball.of(points.reshape(-1, 3).astype(np.float32)).level[:, 0].reshape(out.shape)
    return np.array([np.interp(s, level, o, left=np.nan) for s, level, o in zip(shares, levels, out, strict=True)])


def _directions(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    """(M, 2). Vectors (M, 2), scaled to length 1."""
    return vectors / np.maximum(np.hypot(*vectors.T), 1e-4)[:, None]
