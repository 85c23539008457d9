"""Evens out rinds: a picture's rind is thicker on one side, and no two fruits have rinds of the same thickness.

Where chunks of such pictures meet, a rind would have steps. So pictures are quilted with a common rind, and the ball is
bent: in a picture's own plane its rind is as thick as the picture shows it, and between planes it changes gradually
from one thickness to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import PIXEL, Disc, disc_grid, disc_radius, ring_medians
from training.priors.exemplar.rind import FLESH, rind_depth
from training.priors.exemplar.sampling import blurred, lengths, read_bilinear

__all__ = ["Rinds", "goes_inwards", "rind_of"]

ANGLES = 360
"""Directions in which a picture's rind is measured."""

STEP = 0.005
"""Radii from one depth to the next at which that is measured: more than a pixel."""

DEEPEST = 2.5
"""Depth to which a rind is followed, over the usual depth in its picture."""

NARROWEST, SMOOTH = 21, 5.0
"""Width of the median, and standard deviation of the blur, of the depths around a picture, in degrees: what is narrower
are gaps between segments, not the thickness of the rind."""

MOST = 2.0
"""Largest factor by which a rind is taken to be thicker or thinner than in all pictures: beyond it something else is
there."""

REACH = 3.0
"""Depth, over the rind's, beyond which nothing is moved."""

NEAR = 0.35
"""Radians from an own plane at which the rind is midway between its thickness there and that in all pictures: by eye,
no cut across an own plane has a notch in its rind."""

LATITUDES, LONGITUDES = 90, 180
"""Directions in which the ball's rind is stored."""

RINGS = 50
"""Rings in which a rind's colours are compared with the flesh."""

ALONG_LAYERS, TONES = 25, 12.0
"""Width in degrees of the mean along rings that leaves layers, and standard deviation of the blur that leaves tones, in
degrees and hundredths of a radius."""

CENTRE = 0.15
"""Radius within which rings are too short for such means."""

LAYERED, FAINT = 0.6, 0.02
"""Least share of the details' contrast that such means leave in a picture of layers all over, and its least value (RMS
of RGB). In 26 photographs of fruit 0.55 is left where it is as strong as that, and 0.63 of an apple's 0.012; of drawn
onions 0.98 of 0.08 and, with uneven shells, 0.76 of 0.03."""

BLUR = 3.0
"""Standard deviation of the blur under which they are compared, in pixels of a disc: a hundredth of a radius."""


def rind_of(disc: Disc, is_horizontal: bool) -> tuple[float, NDArray[np.float32], float]:
    """Depth in radii of the layers along the rim, to where half of their contrast with the flesh is left; the colour of
    the flesh (3,); and half of that contrast."""
    depth = np.maximum(1 - disc_radius(), 0)
    deepest = rind_depth(disc.rgb, depth, BLUR, goes_around=is_horizontal)
    colours = ring_medians(disc, RINGS)[::-1]
    flesh = colours[int(FLESH[0] * RINGS) : int(FLESH[1] * RINGS)].mean(0)
    contrast = np.linalg.norm(colours - flesh, axis=1)[: max(round(deepest * RINGS), 1)]
    half = float(contrast.max() / 2)
    return float((np.flatnonzero(contrast >= half)[-1] + 1) / RINGS), flesh, half


def goes_inwards(disc: Disc, core: float, rind: float) -> bool:
    """Whether layers like those of a rind go on under a rind of this depth, down to a core of this radius in radii, as
    in an onion."""
    radius = np.arange(max(core, CENTRE), 1 - rind - BLUR * PIXEL, 0.01)
    if len(radius) < TONES:
        return False
    turn = np.arange(ANGLES) / ANGLES * 2 * np.pi
    polar = Disc(blurred(disc.rgb, BLUR / 2)).read(radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn))
    tones = ndimage.gaussian_filter(polar, (TONES, TONES, 0), mode=("nearest", "wrap", "nearest"))
    along = ndimage.uniform_filter1d(polar - tones, ALONG_LAYERS, axis=1, mode="wrap")
    left = float(np.square(along).mean())
    return left > FAINT**2 and left > LAYERED * float(np.square(polar - tones).mean())


@dataclass(frozen=True)
class Rinds:
    """Depths of the pictures' rinds, and of the ball's rind, which equals them in their planes."""

    across: list[NDArray[np.float64]]
    """(ANGLES,) each. Depths in radii of the horizontal pictures around their middle, degree by degree."""
    along: list[NDArray[np.float64]]
    """(ANGLES,) each. The same of the radial pictures."""
    level: float
    """Depth of the quilt's rind at the height of the first horizontal picture, and of all horizontal ones in it."""
    usual: NDArray[np.float64]
    """(ANGLES,). Depth of the quilt's rind by direction in a radial picture, the same on both sides."""
    height: float
    """Height of the first horizontal picture in the ball."""
    ball: NDArray[np.float32]
    """(LATITUDES + 1, LONGITUDES + 1, 2). Depth of the rind in each direction, in the ball and in the quilt."""

    @classmethod
    def of(cls, horizontal: Sequence[Disc], radial: Sequence[Disc], height: float, most: int) -> Rinds:
        """The rinds of pictures: the first horizontal one at a height in the ball, and the first `most` radial ones in
        planes evenly spread over half a turn."""
        across, along = [_depths(disc, True) for disc in horizontal], [_depths(disc, False) for disc in radial]
        everywhere = float(np.mean([np.median(depths) for depths in [*across, *along]]))
        usual = np.full(ANGLES, everywhere)
        if along:
            both = np.mean([(depths + _mirrored(depths)) / 2 for depths in along], axis=0)
            usual = both * everywhere / np.median(both)
        latitude = float(np.arcsin(np.clip(height, -1, 1)))
        level = float(_around(usual, np.array(latitude)))
        across = [_at_most(depths, np.full(ANGLES, level)) for depths in across]
        along = [_at_most(depths, usual) for depths in along]
        up = (np.arange(LATITUDES + 1) / LATITUDES - 0.5)[:, None] * np.pi
        turn = np.arange(LONGITUDES + 1) / LONGITUDES * 2 * np.pi
        in_quilt = np.broadcast_to(_around(usual, up), (len(up), len(turn)))
        total, weights = in_quilt / NEAR**2, np.full(in_quilt.shape, 1 / NEAR**2)
        seen = []
        if across:
            seen.append((np.abs(up - latitude) + 0 * turn, _around(across[0], turn + 0 * up)))
        planes = min(len(along), most)
        for n, depths in enumerate(along[:planes]):
            off = turn - n * np.pi / planes
            here = np.where(np.cos(off) >= 0, up, np.pi - up)  # half a turn on is the picture's other side
            seen.append((np.abs(np.arcsin(np.cos(up) * np.sin(off))), _around(depths, here)))
        for away, depths in seen:
            weight = 1 / np.maximum(away, 1e-3) ** 2
            total, weights = total + weight * depths, weights + weight
        return cls(across, along, level, usual, height, np.stack([total / weights, in_quilt], -1).astype(np.float32))

    def even(self, disc: Disc, depths: NDArray[np.float64], is_horizontal: bool) -> Disc:
        """The picture, whose rind has these depths (ANGLES,), with the common rind."""
        x, y = disc_grid()
        radius, turn = disc_radius(), np.arctan2(y, x)
        usual = np.full(ANGLES, self.level) if is_horizontal else self.usual
        depth = _moved(np.maximum(1 - radius, 0), _around(usual, turn), _around(depths, turn))
        there = np.where(radius < 1, 1 - depth, radius)
        return Disc(disc.read(there * np.cos(turn), there * np.sin(turn)))

    def at(self, points: NDArray[np.float32], length: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). Depth of the quilt's rind towards points (M, 3) at these distances (M,) from the middle."""
        up = np.arcsin(np.clip(points[:, 2] / np.maximum(length, 1e-3), -1, 1))
        return _around(self.usual, up).astype(np.float32)

    def in_horizontal(self, length: NDArray[np.floating], rind: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M,). Distances from the middle at which horizontal pictures, whose rind is as thick as at their height, show
        what lies at distances (M,) where the quilt's rind is as thick as (M,)."""
        return 1 - _moved(1 - length, rind, np.float32(self.level))

    def as_deep(self, length: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M,). Distances from the middle of a horizontal picture at which it shows what lies at distances (M,) from
        that of the ball, at its own height."""
        return np.sqrt(np.maximum(np.square(length) - self.height**2, 0) / (1 - self.height**2))

    def evened(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). Points (M, 3) of the ball, moved to their places in the quilt."""
        x, y, z = points.T
        length = np.sqrt(x * x + y * y + z * z)
        rows = np.flatnonzero((1 - length < REACH * self.ball.max()) & (length > 1e-3) & (length < 1))
        out, some, long = points.copy(), points[rows], length[rows]
        up = np.arcsin(np.clip(some[:, 2] / long, -1, 1))
        turn = np.arctan2(some[:, 1], some[:, 0]) / (2 * np.pi)
        at = (up / np.pi + 0.5) * LATITUDES, np.where(turn < 0, turn + 1, turn) * LONGITUDES
        here, in_quilt = read_bilinear(self.ball, *at).T
        out[rows] *= ((1 - _moved(1 - long, here, in_quilt)) / long)[:, None]
        return out


def _depths(disc: Disc, is_horizontal: bool) -> NDArray[np.float64]:
    """(ANGLES,). How deep the rind of a picture is, degree by degree."""
    usual, flesh, half = rind_of(disc, is_horizontal)
    depth = np.arange(0, DEEPEST * usual, STEP)
    turn = np.arange(ANGLES) / ANGLES * 2 * np.pi
    smooth = Disc(blurred(disc.rgb, BLUR))
    rays = smooth.read((1 - depth[:, None]) * np.cos(turn), (1 - depth[:, None]) * np.sin(turn))
    contrast = lengths(rays - flesh)
    strongest = contrast[: max(int(usual / STEP), 1)].argmax(0)
    under = (contrast < half) & (np.arange(len(depth))[:, None] >= strongest)
    ends = np.where(under.any(0), np.maximum(depth[under.argmax(0)], STEP), depth[-1])  # no rind counts as a thin one
    return ndimage.gaussian_filter1d(ndimage.median_filter(ends, NARROWEST, mode="wrap"), SMOOTH, mode="wrap")


def _at_most(depths: NDArray[np.float64], usual: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.clip(depths, usual / MOST, usual * MOST)


def _mirrored(depths: NDArray[np.float64]) -> NDArray[np.float64]:
    """(ANGLES,). The depths in a picture with its sides exchanged."""
    return depths[(ANGLES // 2 - np.arange(ANGLES)) % ANGLES]


def _around(depths: NDArray[np.float64], turn: NDArray[np.floating]) -> NDArray[np.float64]:
    """Depths at angles in radians, of any shape."""
    return np.interp(turn % (2 * np.pi) * ANGLES / (2 * np.pi), np.arange(ANGLES + 1), np.append(depths, depths[0]))


def _moved(
    depth: NDArray[np.floating], rind: NDArray[np.floating], to: NDArray[np.floating] | np.floating
) -> NDArray[np.floating]:
    """Depths after a rind is made as thick as `to`: what lies under it is compressed or stretched, fading at REACH."""
    ends = REACH * np.maximum(rind, to)
    beyond = to + (depth - rind) * (ends - to) / (ends - rind)
    return np.where(depth < rind, depth * to / rind, np.where(depth < ends, beyond, depth))
