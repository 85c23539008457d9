"""Chambers of a body: the parts that grains fill, from what pictures show of them.

A place is in a chamber if it is in one of the horizontal picture, at the same angle, and in one of the radial pictures.
So what lies between the chambers of a horizontal picture runs from pole to pole, as membranes do, and what lies between
those of a radial one runs around. Beside own planes, what these show of chambers is known without a doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.noise import Noise
from training.priors.exemplar.quilting.chunks import OWN_AZIMUTHS, Ball
from training.priors.exemplar.quilting.disc import read_map
from training.priors.exemplar.quilting.films import Beside
from training.priors.exemplar.quilting.labels import Label, Source
from training.priors.exemplar.sampling import blurred, read_trilinear, smoothstep

__all__ = ["BESIDE", "HALF", "NODES", "Chambers", "room_beside"]

NODES, HALF = 97, 1.05
"""Nodes along each axis of the grid on which walls are known, and its half side in radii: four to the
width of a grain."""

WALL = 0.033
"""Standard deviation in radii of the blur of chambers: bends in their walls are as wide as grains."""

SOFT = 2.0
"""Standard deviation in pixels of the blur of a picture's chambers, so that nodes between pixels tell where a wall is.
"""

WANDER, WANDER_LENGTH, ONSET = 0.25, 0.7, 0.3
"""Standard deviation in radians by which chambers of a horizontal picture wander around the axis, the length in radii
over which they do, and the distance from its plane from which they do: no wall is as straight as a column."""

BESIDE = np.float32(0.2)
"""Largest distance in radii from an own plane at which it tells where grains end: half of what is widest between the
chambers of two horizontal photographs. In radial ones, 0.28 and 0.44 are found around the stem."""


@dataclass(frozen=True)
class Chambers:
    """The chambers of a body."""

    room: NDArray[np.float32]
    """(NODES, NODES, NODES). Distance to the nearest wall in radii, below 0 outside of chambers."""

    @classmethod
    def of(
        cls,
        across: Sequence[Source],
        along: Sequence[Source],
        height: float,
        ball_of: Callable[[NDArray[np.float32]], Ball],
        rng: np.random.Generator,
    ) -> Chambers:
        """The chambers that horizontal pictures, the first of which is at this height, and radial ones show;
        `ball_of` makes a ball of points (M, 3)."""
        axis = np.linspace(-HALF, HALF, NODES, dtype=np.float32)
        nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
        inside = np.linalg.norm(nodes, axis=-1) < 1
        ball = ball_of(nodes[inside])
        seen = np.ones(len(ball.points), np.float32)
        for source in across[:1]:
            seen = _across(source, height, ball, Noise((WANDER_LENGTH,) * 3, 1, rng))
        if along:
            seen = np.minimum(seen, _along(along[:OWN_AZIMUTHS], ball))
        soft = np.zeros(inside.shape, np.float32)
        soft[inside] = seen
        step = 2 * HALF / (NODES - 1)
        held = ndimage.gaussian_filter(soft, WALL / step) > 0.5
        edt = ndimage.distance_transform_edt
        away = np.where(held, edt(held) - 0.5, 0.5 - edt(~held))
        return cls((away * step).astype(np.float32))

    def at(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). The distance to the nearest wall at points (M, 3) of the ball."""
        nodes = ((points + HALF) * ((NODES - 1) / (2 * HALF))).astype(np.float32)
        return read_trilinear(self.room[..., None], nodes)[:, 0]


def room_beside(
    labels: Sequence[Label], points: NDArray[np.float32], beside: Beside, ball_of: Callable[[NDArray[np.float32]], Ball]
) -> NDArray[np.float32]:
    """(M,). How far in radii points (M, 3) that lie so beside own planes are from where these show walls of chambers,
    below 0 in walls; BESIDE at most. What is between chambers becomes narrower as fast as its plane is left: carried
    only as far as a plane is thick, walls are lines in cuts across it."""
    room = np.full(len(points), BESIDE, np.float32)
    for number, far in zip(beside.numbers, beside.far, strict=True):
        label, rows = labels[number], np.flatnonzero(np.abs(far) < BESIDE)
        places = label.chunks.places(ball_of(points[rows]))
        depth = np.maximum(label.depth_in_chambers(places), -BESIDE)
        room[rows] = np.minimum(room[rows], depth + places.distance)
    return room


def _across(source: Source, height: float, ball: Ball, noise: Noise) -> NDArray[np.float32]:
    """(M,). How surely points lie in a chamber of a horizontal picture at this height."""
    away = np.minimum(np.abs(ball.points[:, 2] - height) / ONSET, 1)
    turn = WANDER * away * noise.at(ball.points)[:, 0]
    c, s = np.cos(turn), np.sin(turn)
    x, y = ball.level.T
    return read_map(_chambers_of(source), c * x - s * y, s * x + c * y)


def _along(sources: Sequence[Source], ball: Ball) -> NDArray[np.float32]:
    """(M,). How surely points lie in a chamber of radial pictures, in planes evenly spread over half a turn: between
    two halves of pictures, as far as in both."""
    covers = [_chambers_of(source) for source in sources]
    turn = ball.angle / (np.pi / len(covers))
    first = np.floor(turn)
    halves = []
    for half in (first.astype(int), first.astype(int) + 1):
        # Half a turn further is the same picture, seen from the other side.
        side = np.where(half // len(covers) % 2 == 0, 1, -1)
        shown = np.stack([read_map(cover, side * ball.radius, ball.points[:, 2]) for cover in covers])
        halves.append(np.take_along_axis(shown, (half % len(covers))[None], 0)[0])
    return halves[0] + smoothstep(turn - first).astype(np.float32) * (halves[1] - halves[0])


def _chambers_of(source: Source) -> NDArray[np.float32]:
    """(P, P). The chambers of a picture, with soft edges; one that is not made of grains tells of none, and is all
    chamber."""
    regions = source.grains.regions if source.has_grains else np.ones_like(source.grains.regions)
    return blurred(regions.astype(np.float32), SOFT)
