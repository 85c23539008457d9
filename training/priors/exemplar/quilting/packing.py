"""Balls in the ball: the grains of photographs laid as solids, close to one another, wherever grains are to be.

Every ball shows a grain of a picture, turned about its own middle: at a distance from its middle are the colours that
the grain has there, in the direction in which the point lies. So any cut through it shows a whole grain, its rim all
around. Where balls meet, the border is the plane of equal power (a Laguerre tessellation, as in packings of grains).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans
from training.priors.exemplar.quilting.disc import Disc
from training.priors.exemplar.quilting.grains import Grains

__all__ = ["REACHES", "Packing", "pack_grains"]

SECTION = 4 / np.pi
"""Radius of a ball over the mean radius of its cuts by random planes, which is what a picture shows."""

CANDIDATES = 6
"""Times as many balls as there are to be that are tried: most meet one that lies there already."""

NEAR = 0.5
"""Least distance of two balls over the sum of their radii. Balls that may not overlap at all fill 0.38 of space when
they are laid at random; arils press one another flat."""

REACHES = 1.15
"""Times as far as its radius a ball goes where no other one is: what is left between them shows chunks."""

MIXED_SIZES = 0.7
"""Balls are laid from large to small, by their radius times a random number from this to 1: small ones fill gaps."""

AXIS = 0.12
"""Distance over a ball's radius from the line across its picture's plane within which directions fade: on the line
itself there is none."""

EDGE = 0.006
"""Distance in radii over which two balls pass into one another: as a relief's colours do."""

INSIDE = 0.95
"""Largest distance of a ball's middle from that of the body."""

EXTENT = 1.3
"""Half a side of the lattice in which balls are looked up, in radii: the body and a ball's reach."""


@dataclass(frozen=True)
class Packing:
    """Balls that show grains of pictures."""

    centres: NDArray[np.float32]
    """(B, 3). In the unit ball."""
    radii: NDArray[np.float32]
    """(B,)."""
    pictures: NDArray[np.int64]
    """(B,). Number of the picture, horizontal ones first."""
    horizontal: NDArray[np.bool_]
    """(B,). Whether it is a horizontal one."""
    places: NDArray[np.float32]
    """(B, 2). Of the grain's middle on its disc."""
    cell: float
    starts: NDArray[np.int64]
    """(C + 1,). Where the balls of each cell of a lattice start in `members`."""
    members: NDArray[np.int64]
    """(B,)."""

    def read(
        self, points: NDArray[np.float32], discs: Sequence[Disc]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of balls at points (M, 3), and how much they cover what is there. Range [0, 1].

        `discs`: the pictures by their numbers.
        """
        rgb, cover = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        best = np.empty((len(points), 2), np.int64)
        power = np.empty((len(points), 2), np.float32)
        balls = self.centres, self.radii, self.starts, self.members
        for_spans(_most_power, len(points), points, *balls, self.cell, best, power)
        rows = np.flatnonzero(best[:, 0] >= 0)
        if not len(rows):
            return rgb, cover
        first, second = best[rows].T
        two = second >= 0
        apart = np.linalg.norm(self.centres[first] - self.centres[second], axis=1)
        # Half of the difference of powers over the distance of the middles is the distance from the border.
        beyond = np.where(two, (power[rows, 0] - power[rows, 1]) / (2 * np.maximum(apart, 1e-4)), EDGE)
        share = (0.5 + 0.5 * np.clip(beyond / EDGE, 0, 1)).astype(np.float32)
        rgb[rows] = share[:, None] * self._shown(points[rows], first, discs)
        rgb[rows[two]] += (1 - share[two])[:, None] * self._shown(points[rows[two]], second[two], discs)
        radius = self.radii[first]
        away = np.sqrt(np.maximum(radius * radius - power[rows, 0], 0))
        cover[rows] = np.clip((radius * REACHES - away) / EDGE, 0, 1)
        return rgb, cover

    def _shown(
        self, points: NDArray[np.float32], ball: NDArray[np.int64], discs: Sequence[Disc]
    ) -> NDArray[np.float32]:
        """(M, 3). What the balls (M,) show at points (M, 3)."""
        offset, place = points - self.centres[ball], self.places[ball]
        horizontal = self.horizontal[ball]
        out = _directions(self.centres[ball, :2])
        outward = (offset[:, :2] * out).sum(1)
        across = np.where(horizontal, offset[:, 1] * out[:, 0] - offset[:, 0] * out[:, 1], offset[:, 2])
        # In a radial picture outwards is to its nearer side.
        side = np.where(place[:, 0] < 0, np.float32(-1), np.float32(1))
        shown = np.where(horizontal[:, None], _directions(place), np.stack([side, np.zeros_like(side)], -1))
        across = across * np.where(horizontal, np.float32(1), side)
        near = np.square(AXIS * self.radii[ball])
        stretched = np.linalg.norm(offset, axis=1) / np.sqrt(outward * outward + across * across + near) / SECTION
        u, v = stretched * outward, stretched * across
        x = place[:, 0] + u * shown[:, 0] - v * shown[:, 1]
        y = place[:, 1] + u * shown[:, 1] + v * shown[:, 0]
        rgb = np.empty((len(points), 3), np.float32)
        for n, disc in enumerate(discs):
            rows = np.flatnonzero(self.pictures[ball] == n)
            rgb[rows] = disc.read(x[rows], y[rows])
        return rgb


def pack_grains(
    horizontal: Sequence[Grains],
    radial: Sequence[Grains],
    is_free: Callable[[NDArray[np.float32], NDArray[np.float32]], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> Packing | None:
    """The grains of pictures as balls in the unit ball, as many as the pictures show; None if they show none.

    A ball may be where `is_free` of its middle (M, 3) and radius (M,). There are N_A / 2R balls in a volume where a
    picture shows N_A cuts of them in an area (Saltykov).
    """
    balls = []
    for n, grains in enumerate([*horizontal, *radial]):
        wide = 2 * SECTION * grains.radii.astype(np.float64)
        # A horizontal picture stands for all heights, each half of a radial one for half a turn.
        copies = np.where(n < len(horizontal), 2.0, np.pi * np.hypot(*grains.places.T)) / wide
        count = CANDIDATES / (len(horizontal) + len(radial)) * copies
        which = np.repeat(np.arange(len(count)), np.floor(count + rng.uniform(size=len(count))).astype(int))
        place, size = grains.places[which], SECTION * grains.radii[which]
        moved = rng.standard_normal((len(which), 2)) * 0.5 * size[:, None]
        if n < len(horizontal):
            height: NDArray[np.floating] = rng.uniform(-INSIDE, INSIDE, len(which))
            out = np.hypot(*place.T) * np.sqrt(1 - height * height) + moved[:, 0]
        else:
            height = place[:, 1] + moved[:, 1]
            out = np.abs(place[:, 0]) + moved[:, 0]
        turn = rng.uniform(0, 2 * np.pi, len(which))
        middle = np.stack([np.abs(out) * np.cos(turn), np.abs(out) * np.sin(turn), height], -1)
        balls.append((middle.astype(np.float32), size.astype(np.float32), np.full(len(which), n), place))
    centres, radii, pictures, places = (np.concatenate(a) for a in zip(*balls, strict=True))
    order = np.argsort(-radii * rng.uniform(MIXED_SIZES, 1, len(radii)), kind="stable")
    order = order[np.linalg.norm(centres[order], axis=1) < INSIDE]
    order = order[is_free(centres[order], radii[order])]
    if not len(order):
        return None
    cell = float(2 * REACHES * radii[order].max())
    order = order[_laid(centres[order], radii[order], cell)]
    centres, radii, pictures, places = (a[order] for a in (centres, radii, pictures, places))
    side = _lattice(cell)
    at = np.clip(((centres + EXTENT) / np.float32(cell)).astype(np.int64), 0, side - 1)
    number = (at[:, 0] * side + at[:, 1]) * side + at[:, 2]
    members = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[members], np.arange(side**3 + 1))
    return Packing(centres, radii, pictures, pictures < len(horizontal), places, cell, starts, members)


def _directions(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M, 2). Vectors (M, 2) of length 1."""
    return vectors / np.maximum(np.hypot(*vectors.T), np.float32(1e-4))[:, None]


@njit(cache=True)
def _lattice(cell: float) -> int:
    """Cells along a side of the lattice in which balls are looked up."""
    return int(2 * EXTENT / cell) + 1


@njit(cache=True)
def _laid(
    centres: NDArray[np.float32],  # [M, 3]
    radii: NDArray[np.float32],  # [M]
    cell: float,
) -> NDArray[np.bool_]:
    """(M,). Which of the balls lie, each one only where it is far enough from all before it."""
    side = _lattice(cell)
    first = np.full(side * side * side, -1, np.int64)
    following = np.full(len(radii), -1, np.int64)
    laid = np.zeros(len(radii), np.bool_)
    for b in range(len(radii)):
        x = int((centres[b, 0] + np.float32(EXTENT)) / cell)
        y = int((centres[b, 1] + np.float32(EXTENT)) / cell)
        z = int((centres[b, 2] + np.float32(EXTENT)) / cell)
        free = True
        for i in range(max(x - 1, 0), min(x + 2, side)):
            for j in range(max(y - 1, 0), min(y + 2, side)):
                for k in range(max(z - 1, 0), min(z + 2, side)):
                    other = first[(i * side + j) * side + k]
                    while other >= 0:
                        away = np.float32(0)
                        for c in range(3):
                            d = centres[other, c] - centres[b, c]
                            away += d * d
                        least = np.float32(NEAR) * (radii[other] + radii[b])
                        free = free and away >= least * least
                        other = following[other]
        if free:
            laid[b] = True
            here = (x * side + y) * side + z
            following[b] = first[here]
            first[here] = b
    return laid


@njit(cache=True, nogil=True)
def _most_power(
    start: int,
    stop: int,
    points: NDArray[np.float32],  # [M, 3]
    centres: NDArray[np.float32],  # [B, 3]
    radii: NDArray[np.float32],  # [B]
    starts: NDArray[np.int64],  # [C + 1]
    members: NDArray[np.int64],  # [B]
    cell: float,
    best: NDArray[np.int64],  # [M, 2], -1 for none
    power: NDArray[np.float32],  # [M, 2]
) -> None:
    """The two balls with the most power at each point, R^2 - d^2, of those that reach it."""
    side = _lattice(cell)
    for m in range(start, stop):
        x = int((points[m, 0] + np.float32(EXTENT)) / cell)
        y = int((points[m, 1] + np.float32(EXTENT)) / cell)
        z = int((points[m, 2] + np.float32(EXTENT)) / cell)
        a, b = -1, -1
        most, next_most = np.float32(-9), np.float32(-9)
        for i in range(max(x - 1, 0), min(x + 2, side)):
            for j in range(max(y - 1, 0), min(y + 2, side)):
                for k in range(max(z - 1, 0), min(z + 2, side)):
                    here = (i * side + j) * side + k
                    for n in range(starts[here], starts[here + 1]):
                        ball = members[n]
                        away = np.float32(0)
                        for c in range(3):
                            d = centres[ball, c] - points[m, c]
                            away += d * d
                        reach = np.float32(REACHES) * radii[ball]
                        if away >= reach * reach:
                            continue
                        here_power = radii[ball] * radii[ball] - away
                        if here_power > most:
                            next_most, b = most, a
                            most, a = here_power, ball
                        elif here_power > next_most:
                            next_most, b = here_power, ball
        best[m, 0], best[m, 1] = a, b
        power[m, 0], power[m, 1] = most, next_most
