"""Cut faces as unit discs and the body as a unit ball, so that places in pictures and in the body can be compared.

Each direction from the middle is stretched to its own edge: a cut through the middle of the ball is a disc, whatever
the outlines of the body and of the photographed thing are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import read_cells
from engine.solid.distance_transform import depth_in
from training.priors.exemplar.frames import Space
from training.priors.exemplar.medians import Ranks
from training.priors.exemplar.pictures import Picture
from training.priors.exemplar.sampling import blurred, lengths, read_as_scipy, read_bilinear, reduced, resampled

__all__ = [
    "DISC_PIXELS",
    "HALO",
    "PIXEL",
    "REACH",
    "RIND_RADIUS",
    "THING_CONTRAST",
    "BallMap",
    "Disc",
    "Medians",
    "disc_grid",
    "disc_radius",
    "enlarged",
    "even_around",
    "even_sides",
    "evened",
    "filled_in",
    "halo",
    "match_light",
    "read_map",
    "ring_medians",
    "smooth_disc",
    "to_pixels",
]

DISC_PIXELS = 560
"""Pixels along a side of a disc's array: 510 across the disc, as fine as most photographs on the web."""

REACH = 1.1
"""Half a side of that array, in radii of the disc; the colours of the rim continue beyond the disc."""

PIXEL = 2 * REACH / DISC_PIXELS
"""Width of a disc's pixel, in radii."""

RIM = 0.985
"""Radius beyond which the colour is that of the rim: the last pixels of a photographed edge are half background."""

DIRECTIONS = 720
"""Directions in which the outline of a picture is sampled."""

LATITUDES, LONGITUDES = 90, 180
"""Directions in which the skin of the body is sampled: two degrees, finer than any dent that a cut face shows."""

LEAST_SHARE = 0.1
"""Least part of a ring that both pictures must show for their medians there to be a pair."""

RINGS, CORE_RINGS = 24, 6
"""Rings in which the colours of two pictures are matched, and how many of them are the core: too small for a median to
tell light from what is there."""

REDUCTION = 4
"""Pixels of the disc per pixel of a median: what a median leaves is several times wider."""

MEDIAN_PIXELS = 4
"""Radius in pixels from which a median is taken on a coarser picture: wide medians of a fine picture take seconds."""

FLESH_RINGS, MIDDLE_RINGS = (12, 19), 4
"""Rings most of which show flesh, however large a core is, and those that show a core if there is one. Where only one
of two pictures shows its core, as stones are not equally wide, a ring is no pair: a brown stone became as pale as
flesh."""

THING_CONTRAST = 0.12
"""Least RGB distance from what is around it, or shows beyond its end, for a pixel to be of a thing that is laid whole:
half as much again as the least contrast of a closed thing, as the thing is taken out of its picture."""

ROWS = 8
"""Rows of a disc whose light is matched at a time."""

ALIKE, NEAR = 0.15, 0.05
"""Standard deviations of the RGB distance, and in the rind of the distance in radii, over which colours are moved
alike."""

FAINTEST = 0.01
"""Least distance of a ring's channel from black and white, of which others are shares: three steps of 255."""

HALO = 0.015
"""Radii around hidden pixels that are filled in, too: edges are blurred and may cast a shadow."""

FILLS = 0.02, 0.06, 0.2
"""Standard deviations in radii of the blurred surroundings that replace hidden pixels: the narrowest of which a quarter
is known."""

RIND_RADIUS = 0.8
"""Radius from which a face may show its rind."""


@dataclass(frozen=True)
class Disc:
    """A cut face stretched to the unit disc."""

    rgb: NDArray[np.float32]
    """(DISC_PIXELS, DISC_PIXELS, 3), indexed [x, y] with y upwards, over [-REACH, REACH]."""

    @classmethod
    def of(cls, picture: Picture) -> Disc:
        """The face of a picture. Its middle is the core, or the mask's centroid."""
        rows, columns = np.nonzero(picture.mask)
        row, column = rows.mean(), columns.mean()
        if picture.core is not None:
            column, row = picture.core[0] - 0.5, picture.core[1] - 0.5
        angles = np.arange(DIRECTIONS) / DIRECTIONS * 2 * np.pi
        reach = np.arange(0, np.hypot(*picture.mask.shape), 0.5)
        at = [row - reach[:, None] * np.sin(angles), column + reach[:, None] * np.cos(angles)]
        hit = ndimage.map_coordinates(picture.mask.astype(np.float32), at, order=1) > 0.5
        rim = np.where(hit.any(0), reach[len(reach) - 1 - np.argmax(hit[::-1], axis=0)], 0)  # a core beside the face
        rim = ndimage.gaussian_filter1d(ndimage.median_filter(rim, 13, mode="wrap"), 3, mode="wrap")
        x, y = disc_grid()
        angle = np.arctan2(y, x) % (2 * np.pi)
        r = np.interp(angle, angles, rim, period=2 * np.pi) * np.minimum(disc_radius(), RIM)
        sigma = max(0.5 * rim.mean() * 2 * REACH / DISC_PIXELS - 0.4, 0.0)  # against aliasing
        rgb = blurred(picture.rgb, sigma)
        found = read_as_scipy(rgb, row - r * np.sin(angle), column + r * np.cos(angle))
        return cls.of_bytes(np.round(found * 255).astype(np.uint8))  # as fine as a file stores it

    @classmethod
    def of_bytes(cls, rgb: NDArray[np.uint8]) -> Disc:
        """The face of 8-bit colours."""
        return cls(rgb.astype(np.float32) / np.float32(255))

    def to_bytes(self) -> NDArray[np.uint8]:
        """The 8-bit colours of a face that is made from such."""
        return np.round(self.rgb * 255).astype(np.uint8)

    def reduced(self, n: int) -> Disc:
        """The disc with pixels n times as large; n divides DISC_PIXELS."""
        return Disc(reduced(self.rgb, n))

    def read(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(..., 3). Colours at places (...), (...)."""
        shape = np.broadcast_shapes(x.shape, y.shape)
        return _read(self.rgb, x, y).reshape(*shape, 3)


TONE_ANGLE, TONE_LENGTH = 0.4, 0.15
"""Standard deviations in radians around, and in radii, of the blur that separates tones from details: wider than
seeds, membranes and the arms of a star. With even tones the patches of photographs are 1 to 11 % nearer to unseen ones
(three seeds, three pairs)."""


@cache
def disc_grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The places x and y of a disc's pixels, both (DISC_PIXELS, DISC_PIXELS); not to be written to."""
    axis = ((np.arange(DISC_PIXELS) + 0.5) / DISC_PIXELS * 2 - 1) * REACH
    x, y = np.meshgrid(axis, axis, indexing="ij")
    for places in (x, y):
        places.setflags(write=False)
    return x, y


@cache
def disc_radius() -> NDArray[np.float64]:
    """(DISC_PIXELS, DISC_PIXELS). How far a disc's pixels are from its middle; not to be written to."""
    radius = np.hypot(*disc_grid())
    radius.setflags(write=False)
    return radius


def read_map(values: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(...). Values (P, P) on a disc's pixels, at places (...), (...)."""
    return _read(values[..., None], x, y).reshape(np.broadcast_shapes(x.shape, y.shape))


def _read(values: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M, C). Values (P, P, C) on a disc's pixels, at places of M values in all."""
    rows, columns = (at.ravel() for at in np.broadcast_arrays(*to_pixels(x, y, len(values))))
    return read_bilinear(values, rows, columns)


def to_pixels(
    x: NDArray[np.floating], y: NDArray[np.floating], pixels: int
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Places on the disc as indices into an array of `pixels` along a side."""
    scale = pixels / (2 * REACH)
    return (x + REACH) * scale - 0.5, (y + REACH) * scale - 0.5


def smooth_disc(disc: Disc, sigma: float) -> Disc:
    """The disc blurred by a Gaussian of this standard deviation in radii."""
    pixels = sigma * DISC_PIXELS / (2 * REACH)
    return Disc(blurred(disc.rgb, pixels, reach=3))


class Medians:
    """Medians of values on a disc's pixels, over one radius or several."""

    def __init__(self, values: NDArray[np.float32]) -> None:
        """`values`: (H, W, C)."""
        self._values, self._ranks, self._known = values, dict[int, Ranks](), dict[float, NDArray[np.float32]]()

    def over(self, radius: float) -> NDArray[np.float32]:
        """(H / REDUCTION, W / REDUCTION, C). The medians over discs of this radius, in radii."""
        if radius not in self._known:
            self._known[radius] = self._found(radius)
        return self._known[radius]

    def _found(self, radius: float) -> NDArray[np.float32]:
        pixels = radius * DISC_PIXELS / (2 * REACH)
        n = max(REDUCTION, REDUCTION * int(pixels / (REDUCTION * MEDIAN_PIXELS)))
        reach = int(np.ceil(pixels / n))
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        across = (np.hypot(x, y) <= pixels / n + 0.3).sum(1)
        if n not in self._ranks:
            self._ranks[n] = Ranks.of(reduced(self._values, n))
        medians = self._ranks[n].medians(across[across > 0] // 2)
        return medians if n == REDUCTION else resampled(medians, DISC_PIXELS // REDUCTION, REDUCTION / n)


def halo(hidden: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(P, P). 1 where pixels of a disc are `hidden` (P, P) and close around them, 0 elsewhere."""
    if not hidden.any():
        return np.zeros(hidden.shape, np.float32)
    away = depth_in(~hidden)
    return np.clip(HALO / PIXEL + 0.5 - away, 0, 1).astype(np.float32)


def filled_in(values: NDArray[np.float32], hidden: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(P, P, C). Values (P, P, C) on a disc's pixels, replaced by their surroundings where they are `hidden` (P, P)."""
    if not hidden.any():
        return values
    kept = 1 - halo(hidden)[..., None]
    known, coarse = reduced(kept, REDUCTION), reduced(values * kept, REDUCTION)
    around: NDArray[np.floating] = coarse
    share: NDArray[np.floating] = known
    for width in FILLS:
        sigma = width / (PIXEL * REDUCTION)
        near, weight = (blurred(a, sigma, reach=3) for a in (coarse, known))
        add = (1 - share) * np.minimum(weight * 4, 1)
        around, share = around + add * near / np.maximum(weight, 1e-6), share + add
    there = enlarged((around / np.maximum(share, 1e-6)).astype(np.float32))
    return values * kept + there * (1 - kept)


def enlarged(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(DISC_PIXELS, DISC_PIXELS, C). Values (H / REDUCTION, W / REDUCTION, C), interpolated to all pixels."""
    return resampled(values, DISC_PIXELS, 1 / REDUCTION)


def match_light(disc: Disc, to: Disc, chambers: Sequence[NDArray[np.bool_]] = ()) -> Disc:
    """The disc in the light of another one. What two fruits have in common lies at the same depth, so the medians of
    their rings are pairs of colours, and each colour is moved like the rings that resemble it: a white core stays white
    beside flesh that is yellow in one light and orange in the other. In the rind the depth decides as well. Rings are
    compared beside the middle alone: above and below it a radial picture shows the core as far out as its poles.
    A colour unlike all of them is moved the less, the nearer it is to black in each channel, and to white in all
    together: black seeds do not turn blue in whiter light, nor white pith violet beside flesh of another colour, nor
    pale strands beside pith of another colour cyan.

    `chambers`: where both have grains (P, P), if they have any. These are one more pair, wherever they lie.
    """
    x, y = disc_grid()
    level = np.abs(y) < np.abs(x)
    ring = (disc_radius() * RINGS).astype(int)
    where = [level & ~grains for grains in chambers] or [level, level]
    pixels = np.bincount(ring[level], minlength=RINGS)
    left = np.min([np.bincount(ring[w], minlength=RINGS)[:RINGS] / pixels[:RINGS] for w in where], axis=0)
    medians = [ring_medians(d, RINGS, w) for d, w in zip((disc, to), where, strict=True)]
    in_one_core = np.logical_xor(*(_core_rings(m) for m in medians))
    rings = np.flatnonzero((left > LEAST_SHARE) & (np.arange(RINGS) >= CORE_RINGS) & ~in_one_core)
    colours, wanted = (m[rings] for m in medians)
    depth = np.maximum(disc_radius(), RIND_RADIUS)
    middles = [np.broadcast_to(m, depth.shape) for m in np.maximum((rings + 0.5) / RINGS, RIND_RADIUS)]
    area = (2 * rings + 1) * left[rings]
    if chambers:
        grains = [np.median(d.rgb[w], axis=0)[None] for d, w in zip((disc, to), chambers, strict=True)]
        colours, wanted = (np.concatenate(both) for both in zip((colours, wanted), grains, strict=True))
        middles.append(depth)  # at any depth
        area = np.append(area, RINGS * RINGS * chambers[0].mean())
    area = area[:, None, None]

    def moved(rows: slice) -> NDArray[np.floating]:
        unlike = np.stack(
            [
                np.square(disc.rgb[rows] - colour).sum(-1) / ALIKE**2 + np.square((depth[rows] - middle[rows]) / NEAR)
                for colour, middle in zip(colours, middles, strict=True)
            ]
        )
        least = unlike.min(0)
        weights = np.exp((least - unlike) / 2) * area
        like, there = (np.tensordot(weights, m, (0, 0)) / weights.sum(0)[..., None] for m in (colours, wanted))
        rgb, like = disc.rgb[rows], np.clip(like, FAINTEST, 1 - FAINTEST)
        to_white = (lengths(1 - rgb) / lengths(1 - like))[..., None]
        on_curve = np.minimum(np.minimum(rgb / like, to_white), 1)
        alike = np.exp(-least / 2)[..., None]
        return rgb + (there - like) * (alike + (1 - alike) * on_curve)

    # By some rows at a time: the weights of all pixels do not fit in the cache.
    matched = np.concatenate([moved(slice(n, n + ROWS)) for n in range(0, DISC_PIXELS, ROWS)])
    return Disc(np.clip(matched, 0, 1).astype(np.float32))


def _core_rings(colours: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(RINGS,). Which rings of a face, with these median colours (RINGS, 3), are its core: from the middle out to where
    half of its contrast with the flesh is left. Where there is none, as with pixels left out, colours are NaN."""
    flesh = colours[slice(*FLESH_RINGS)]
    flesh = flesh[np.isfinite(flesh).all(1)]
    if not len(flesh):
        return np.zeros(len(colours), bool)
    away = np.nan_to_num(np.linalg.norm(colours - np.median(flesh, axis=0), axis=1))
    middle = float(away[:MIDDLE_RINGS].max())
    return np.logical_and.accumulate(away > middle / 2) & (middle > THING_CONTRAST)


def ring_medians(disc: Disc, rings: int, where: NDArray[np.bool_] | bool = True) -> NDArray[np.float32]:
    """(rings, 3). The median colours of rings of the same width from the middle to the rim, over the pixels `where`
    (P, P) is true."""
    ring = np.where(where, (disc_radius() * rings).astype(int), rings).ravel()
    order = np.argsort(ring, kind="stable")
    ends = np.searchsorted(ring[order], np.arange(rings + 1))
    of_ring = np.split(disc.rgb.reshape(-1, 3)[order], ends)[1:-1]
    return np.array([np.median(c, axis=0) if len(c) else np.full(3, np.nan) for c in of_ring], np.float32)


def even_around(disc: Disc) -> Disc:
    """The horizontal face with tones that depend on the radius alone, and unchanged details: light, ripeness and an
    off-centre outline would show as patches wherever two turned copies meet."""
    angle = np.arange(DIRECTIONS) / DIRECTIONS * 2 * np.pi
    radius = np.linspace(0, 1, DISC_PIXELS // 4)[:, None]
    polar = disc.read(radius * np.cos(angle), radius * np.sin(angle))
    tones = ndimage.gaussian_filter1d(polar, TONE_ANGLE * DIRECTIONS / (2 * np.pi), axis=1, mode="wrap")
    excess = ndimage.gaussian_filter1d(tones - tones.mean(1, keepdims=True), 1.5, axis=0, mode="nearest")
    x, y = disc_grid()
    at = disc_radius() * (len(radius) - 1), np.arctan2(y, x) % (2 * np.pi) * DIRECTIONS / (2 * np.pi)
    closed = np.concatenate([excess, excess[:, :1]], axis=1)
    return Disc(np.clip(disc.rgb - read_as_scipy(closed, *at), 0, 1))


def even_sides(disc: Disc) -> Disc:
    """The radial face with the same tones on both sides, and unchanged details."""
    tones = smooth_disc(disc, TONE_LENGTH).rgb
    return Disc(np.clip(disc.rgb + (tones[::-1] - tones) / 2, 0, 1))


def evened(disc: Disc, is_horizontal: bool, hidden: NDArray[np.bool_] | None = None) -> Disc:
    """The face with even tones, which what is `hidden` (P, P) does not affect."""
    made_even = even_around if is_horizontal else even_sides
    if hidden is None:
        return made_even(disc)
    toned = Disc(filled_in(disc.rgb, hidden))
    return Disc(np.clip(disc.rgb + made_even(toned).rgb - toned.rgb, 0, 1))


@dataclass(frozen=True)
class BallMap:
    """A body as the unit ball: each direction from the middle is stretched to the skin.

    The middle is the centroid of the cuts through the axis, as a picture's middle is its centroid: if it were half way
    up, a body that is wider above would show its pictures shifted. A long body is brought to the proportions of its
    pictures first: else what runs along its axis would be an hourglass.
    """

    rise: float
    """Cells from half way up the body to the middle."""
    stretch: NDArray[np.float64]
    """(3,). Factors along e1, e2 and up with which the body has the proportions of its pictures."""
    skin: NDArray[np.float64]
    """(LATITUDES + 2, LONGITUDES + 2). Distance of the skin from the middle in cells once the body is stretched, with a
    margin on each side."""

    @classmethod
    def of(cls, space: Space, across: float = 1.0, up: float = 1.0) -> BallMap:
        """The map of a body with the factors `across` along e1, its inverse along e2, and `up`."""
        factors = np.array([across, 1 / across, up])
        along = 1 / np.maximum(space.radius, 0.5)  # a cut's share of a voxel, as cuts crowd at the axis
        rise = float((space.planar[:, 2] * along).sum() / along.sum())
        latitude = ((np.arange(LATITUDES) + 0.5) / LATITUDES - 0.5) * np.pi
        longitude = (np.arange(LONGITUDES) + 0.5) / LONGITUDES * 2 * np.pi
        b, a = np.meshgrid(latitude, longitude, indexing="ij")
        rays = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], -1) / factors @ space.basis
        farthest = lengths((space.planar - np.array([0, 0, rise])) * factors).max()
        skin = np.zeros(b.shape)
        outside = np.ones(b.shape, bool)  # so far on the way in
        for reach in np.arange(0, farthest + 2, 0.5)[::-1]:
            at = space.centre + rise * space.basis[2] + reach * rays[outside]
            met = read_cells(space.body.depth, at) > 0
            skin[outside] = np.where(met, reach, 0)
            outside[outside] = ~met
        skin = ndimage.gaussian_filter(np.maximum(skin, 1.0), 0.7, mode=("nearest", "wrap"))
        return cls(rise, factors, np.pad(np.pad(skin, ((1, 1), (0, 0)), mode="edge"), ((0, 0), (1, 1)), mode="wrap"))

    @property
    def height(self) -> float:
        """Height in the ball of the plane half way up the body."""
        return -self.rise * float(self.stretch[2]) / float(self.skin[LATITUDES // 2].mean())

    def to_ball(self, planar: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, 3). Points of the ball for points (M, 3) along e1, e2 and up from half way up the axis, in cells."""
        planar = (planar - np.array([0, 0, self.rise], np.float32)) * self.stretch.astype(np.float32)
        distance = np.linalg.norm(planar, axis=1)
        up = np.arcsin(np.clip(planar[:, 2] / np.maximum(distance, 1e-6), -1, 1))
        around = np.arctan2(planar[:, 1], planar[:, 0]) % (2 * np.pi)
        at = np.stack([(up / np.pi + 0.5) * LATITUDES + 0.5, around / (2 * np.pi) * LONGITUDES + 0.5])
        rim = ndimage.map_coordinates(self.skin, at, order=1, mode="nearest")
        return (planar / rim[:, None]).astype(np.float32)
