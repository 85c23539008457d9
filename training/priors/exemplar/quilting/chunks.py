"""Chunks of the unit ball that show photographs: which picture each point of a chunk reads, and where in it.

A horizontal picture fills slabs across the axis, a radial one sectors around it, each about as thick as the things in
pictures are long. A chunk is turned, mirrored or shifted at random, so that no two show the same; only the planes in
which the pictures were taken show them as they are.
"""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass, fields
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.noise import Noise
from training.priors.exemplar.quilting.disc import REACH, read_map
from training.priors.exemplar.quilting.rinds import Rinds
from training.priors.exemplar.sampling import smoothstep
from training.priors.exemplar.strata import Rows

__all__ = [
    "Ball",
    "Chunks",
    "Depths",
    "OwnAzimuths",
    "OwnHeight",
    "Places",
    "Sectors",
    "Slabs",
    "smooth_noise",
]

SLABS, SLAB_SPACING = 4, 0.5
"""Sets of slabs, and distance in radii between slabs of one set: together an eighth of a radius, the length of
seeds."""

SECTOR_SETS, SECTORS = 4, 5
"""Sets of sectors, and sectors around the axis of one set: at half the radius, again an eighth of a radius."""

WAVE, WAVE_LENGTH = 0.08, 0.4
"""Standard deviation and length in radii of the waves in a chunk's middle plane: no seam is straight."""

DRIFT, DRIFT_LENGTHS = 0.03, (0.5, 0.5, 0.16)
"""Standard deviation, and lengths across and along the axis, of the drift of places in slabs: more bends
membranes into wavy lines, less shows seeds as rods."""

SECTOR_DRIFT, SECTOR_DRIFT_LENGTHS = 0.06, (0.25, 0.25, 0.35)
"""The same for sectors: short around the axis, where they would show as rings."""

SHIFT = 0.05
"""Standard deviation in radii of the shift of a sector's places."""

CORE = 0.3
"""Radius below which places drift less and sectors are shifted less, to nothing at the axis: a core is in the middle.
For sectors this goes by the square, as a stem that is shifted is cut into chips."""

OWN_AZIMUTHS = 3
"""Largest number of radial pictures with a plane of their own; more would leave no room for variety near the axis."""

MEMBRANE_HOLD = 0.04
"""Radii around a membrane within which its picture does not drift: it runs straight through (`persistence`), and what
lies beside it is not folded over it."""

DRIFT_ONSET = 0.05
"""Distance in radii from a picture's own plane at which it drifts as much as elsewhere."""

RIND = (0.05, 0.25)
"""Depths in radii between which the rind ends: in the rind, places keep their depth and chunks are avoided."""

THICK = 0.16
"""Thickness of a rind in radii from which it ends as much deeper as it is thicker. Those of photographs of oranges and
melons have 0.1 to 0.18; if theirs end as deep as they are thick, horizontal cuts have a quarter more rings."""

SHARED = (0.08, 0.3)
"""Depths in radii between which a place in a horizontal picture goes over from the same depth to the same share of the
radius. Under a thicker rind this begins where that ends: in shares of the radius, it would be thin near the poles."""

GOLDEN_ANGLE = 2.399
"""Turn in radians from one slab of a set to the next, so that no earlier turn repeats."""


class Depths(Enum):
    """Where a horizontal picture shows what lies deep inside, at another height."""

    SHARED = 0
    """At the same share of the radius, as seeds and cores are."""
    KEPT = 1
    """As deep under the skin: its colours go by that."""
    LAYERED = 2
    """As deep, and it is rind all through: it has layers along the skin."""


@dataclass(frozen=True)
class Ball:
    """Points in the unit ball with what chunks need of them; all float32."""

    points: NDArray[np.float32]
    """(M, 3). Along e1, e2, up."""
    radius: NDArray[np.float32]
    """(M,). Distance from the axis."""
    length: NDArray[np.float32]
    """(M,). Distance from the middle."""
    angle: NDArray[np.float32]
    """(M,). Angle around the axis, radians."""
    rind: NDArray[np.float32]
    """(M,). Range [0, 1]: 1 in the rind, 0 deep inside."""
    level: NDArray[np.float32]
    """(M, 2). The place in a horizontal picture at the same angle: equally deep near the skin, at the same share of the
    radius further inside."""

    @classmethod
    def of(cls, points: NDArray[np.float32], rinds: Rinds | None = None, depths: Depths = Depths.SHARED) -> Ball:
        """For points (M, 3) in a quilt with these `rinds`."""
        x, y, z = points.T
        radius = np.hypot(x, y)
        length = np.sqrt(x * x + y * y + z * z)
        share = np.minimum(radius / np.sqrt(np.maximum(1 - z * z, 1e-4)), 1.15)
        thick = np.zeros_like(length) if rinds is None else rinds.at(points, length)
        depth = 1 - length
        deep = smoothstep((depth - np.maximum(SHARED[0], thick)) / (SHARED[1] - SHARED[0]))
        under = smoothstep((depth / np.maximum(thick / THICK, 1) - RIND[0]) / (RIND[1] - RIND[0]))
        skin = length if rinds is None else rinds.in_horizontal(length, thick)
        if rinds is not None and depths is not Depths.SHARED:
            deep, skin = np.zeros_like(deep), rinds.as_deep(skin)
        if depths is Depths.LAYERED:
            under = np.zeros_like(under)
        level = (skin * (1 - deep) + share * deep) / np.maximum(radius, 1e-4)
        rind = 1 - under
        angle = np.arctan2(y, x)
        found = (radius, length, angle, rind, points[:, :2] * level[:, None])
        return cls(points, *(f.astype(np.float32) for f in found))

    def at(self, rows: Rows) -> Ball:
        """Some of the points."""
        return Ball(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True)
class Places:
    """What each of M points reads."""

    picture: NDArray[np.int64]
    """(M,). Number of the picture in its family."""
    x: NDArray[np.float32]
    """(M,). Position on the picture's disc."""
    y: NDArray[np.float32]
    distance: NDArray[np.float32]
    """(M,). Distance in radii from the plane in which the chunk shows the picture as it is."""
    rind: NDArray[np.float32]
    """(M,). `Ball.rind` at the points."""

    def of(self, n: int, pictures: Sized) -> Rows:
        """The points that read picture n of these."""
        return slice(None) if len(pictures) == 1 else self.picture == n


class Chunks(Protocol):
    """A set of chunks that fills the ball with pictures of one family."""

    def distance(self, ball: Ball) -> NDArray[np.float32]:
        """(M,). The `Places.distance` alone."""
        ...

    def places(self, ball: Ball) -> Places:
        """What the points of the ball read."""
        ...


class OwnHeight:
    """The first horizontal picture as it was taken, at one height; away from there it drifts, but for its membranes."""

    def __init__(self, height: float, membranes: NDArray[np.float32], rng: np.random.Generator) -> None:
        """`membranes` (P, P): how surely each place of the picture shows a membrane."""
        self.height = np.float32(height)
        pixels = len(membranes) / (2 * REACH)
        wide = ndimage.maximum_filter(membranes, int(2 * MEMBRANE_HOLD * pixels) | 1)
        self.held = ndimage.gaussian_filter(wide, MEMBRANE_HOLD * pixels)
        self.drift = Noise(DRIFT_LENGTHS, 2, rng)

    def distance(self, ball: Ball) -> NDArray[np.float32]:
        return np.asarray(np.abs(ball.points[:, 2] - self.height))

    def off(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,) and (1, 3). How far points (M, 3) are above the plane, and its normal."""
        return points[:, 2] - self.height, np.array([[0, 0, 1]], np.float32)

    def places(self, ball: Ball) -> Places:
        flat = np.stack([*ball.points[:, :2].T, np.full(len(ball.points), self.height)], -1)
        distance = self.distance(ball)
        held = read_map(self.held, *ball.level.T)
        onset = ((1 - held) * np.minimum(distance / DRIFT_ONSET, 1))[:, None]
        x, y = _drifted(
            ball.level[:, 0], ball.level[:, 1], ball, onset * (self.drift.at(ball.points) - self.drift.at(flat))
        )
        return Places(np.zeros(len(ball.points), np.int64), x, y, distance, ball.rind)


class OwnAzimuths:
    """The first radial pictures as they were taken, evenly spread over half a turn; the first at angle 0."""

    def __init__(self, pictures: int, rng: np.random.Generator) -> None:
        self.count = min(pictures, OWN_AZIMUTHS)
        self.drift = Noise(SECTOR_DRIFT_LENGTHS, 2, rng)

    def _nearest(self, ball: Ball) -> tuple[NDArray[np.int64], NDArray[np.floating], NDArray[np.floating]]:
        """(M,) each. The nearest plane's number, its angle and the distance from it."""
        step = np.pi / self.count
        nearest = np.round(ball.angle / step).astype(np.int64)
        plane = nearest * step
        return nearest, plane, np.abs(ball.radius * np.sin(ball.angle - plane))

    def distance(self, ball: Ball) -> NDArray[np.float32]:
        return self._nearest(ball)[2].astype(np.float32)

    def off(self, points: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,) and (M, 3). How far points (M, 3) are from the nearest plane, along its normal, and that normal."""
        angles = np.arange(self.count) * np.pi / self.count
        normals = np.stack([-np.sin(angles), np.cos(angles), np.zeros(self.count)], -1).astype(np.float32)
        far = normals[:, :1] * points[:, 0] + normals[:, 1:2] * points[:, 1]
        nearest = np.abs(far).argmin(0)
        return np.take_along_axis(far, nearest[None], 0)[0], normals[nearest]

    def places(self, ball: Ball) -> Places:
        nearest, plane, off = self._nearest(ball)
        # Half a turn further is the same plane, seen from the other side.
        side = np.where(nearest // self.count % 2 == 0, 1, -1).astype(np.float32)
        x, y = ball.radius * np.cos(plane), ball.radius * np.sin(plane)
        flat = np.stack([x, y, ball.points[:, 2]], -1).astype(np.float32)
        free = ((1 - ball.rind) * np.minimum(ball.radius / CORE, 1) ** 2)[:, None]
        onset = np.minimum(off / DRIFT_ONSET, 1)[:, None]
        moved = SECTOR_DRIFT * free * onset * (self.drift.at(ball.points) - self.drift.at(flat))
        u, v = side * ball.radius + moved[:, 0], ball.points[:, 2] + moved[:, 1]
        return Places(nearest % self.count, *(a.astype(np.float32) for a in (u, v, off, ball.rind)))


class Slabs:
    """Slabs across the axis; each shows a horizontal picture turned and perhaps mirrored, and drifting a little."""

    def __init__(self, number: int, pictures: int, rng: np.random.Generator) -> None:
        self.number, self.pictures = number, pictures
        self.turn, self.mirror = rng.uniform(0, 2 * np.pi), float(rng.choice([-1.0, 1.0]))
        self.offset = (number + rng.uniform()) / SLABS * SLAB_SPACING
        self.wave, self.drift = Noise((WAVE_LENGTH,) * 3, 1, rng), Noise(DRIFT_LENGTHS, 2, rng)

    def _nearest(self, ball: Ball) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """(M,) both. The slab's number, and the distance from its middle."""
        height = ball.points[:, 2] - self.offset + WAVE * self.wave.at(ball.points)[:, 0]
        slab = np.round(height / SLAB_SPACING).astype(np.int64)
        return slab, np.abs(height - slab * SLAB_SPACING).astype(np.float32)

    def distance(self, ball: Ball) -> NDArray[np.float32]:
        return self._nearest(ball)[1]

    def places(self, ball: Ball) -> Places:
        slab, distance = self._nearest(ball)
        turn = (self.turn + slab * GOLDEN_ANGLE).astype(np.float32)
        c, s = np.cos(turn), np.sin(turn)
        u, v = ball.level[:, 0], self.mirror * ball.level[:, 1]
        x, y = c * u - s * v, s * u + c * v
        x, y = _drifted(x, y, ball, self.drift.at(ball.points))
        picture = (self.number + slab * SLABS) % self.pictures
        return Places(picture, x, y, distance, ball.rind)


class Sectors:
    """Sectors around the axis; each shows a radial picture shifted and perhaps mirrored, and drifting a little."""

    def __init__(self, number: int, pictures: int, rng: np.random.Generator) -> None:
        self.number, self.pictures = number, pictures
        self.turn = rng.uniform(0, SECTORS)
        self.mirror = rng.choice([-1.0, 1.0], SECTORS).astype(np.float32)
        self.shift = (rng.standard_normal((SECTORS, 2)) * SHIFT).astype(np.float32)
        self.wave, self.drift = Noise((WAVE_LENGTH,) * 3, 1, rng), Noise(SECTOR_DRIFT_LENGTHS, 2, rng)

    def _nearest(self, ball: Ball) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """(M,) both. The sector's number, and the distance from its middle."""
        turn = ball.angle / (2 * np.pi) * SECTORS + self.turn + WAVE * SECTORS / 4 * self.wave.at(ball.points)[:, 0]
        sector = np.floor(turn).astype(np.int64) % SECTORS
        off = np.abs(turn - np.floor(turn) - 0.5) / SECTORS * 2 * np.pi
        return sector, (off * np.maximum(ball.radius, RIND[0])).astype(np.float32)

    def distance(self, ball: Ball) -> NDArray[np.float32]:
        return self._nearest(ball)[1]

    def places(self, ball: Ball) -> Places:
        sector, distance = self._nearest(ball)
        free = (1 - ball.rind) * np.minimum(ball.radius / CORE, 1) ** 2
        moved = free[:, None] * (self.shift[sector] + SECTOR_DRIFT * self.drift.at(ball.points))
        x, y = self.mirror[sector] * ball.radius + moved[:, 0], ball.points[:, 2] + moved[:, 1]
        picture = (self.number + sector * SECTOR_SETS) % self.pictures
        return Places(picture, *(a.astype(np.float32) for a in (x, y, distance, ball.rind)))


def _drifted(
    x: NDArray[np.floating], y: NDArray[np.floating], ball: Ball, noise: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Places in a horizontal picture, moved by noise (M, 2): half as far outwards as around, as rings of a picture keep
    their radius, less in the core, and not at all in the rind."""
    drift = DRIFT * (1 - ball.rind)[:, None] * noise / np.maximum(np.hypot(x, y), CORE)[:, None]
    out, around = 0.5 * drift[:, 0], drift[:, 1]
    return (x + x * out - y * around).astype(np.float32), (y + y * out + x * around).astype(np.float32)


def smooth_noise(ball: Ball, length: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """(M,). One random function of this length in radii, at the points."""
    return Noise((length,) * 3, 1, rng).at(ball.points)[:, 0]
