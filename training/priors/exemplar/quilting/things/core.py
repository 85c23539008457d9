"""The core of a face: what stands out around the axis and ends, such as the star of an apple.

There is one core, so it is laid once, as a solid, where its picture was taken, and no chunk shows any. Radial pictures
tell how tall it is. A core that they show taller than it is wide is a column (`column`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import regionprops

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    HALO,
    PIXEL,
    RIND_RADIUS,
    THING_CONTRAST,
    Disc,
    disc_grid,
    disc_radius,
    to_pixels,
)
from training.priors.exemplar.quilting.relief import NARROWEST
from training.priors.exemplar.quilting.things.forms import form_around, form_of, thickest
from training.priors.exemplar.rind import FLESH
from training.priors.exemplar.sampling import blurred, lengths, opened, read_bilinear

__all__ = [
    "AXIS",
    "COMPACT",
    "CORE",
    "MARGIN",
    "NEAR",
    "SMOOTH",
    "Core",
    "Profile",
    "Shown",
    "find_shape",
    "seen_along",
    "stands_out",
]

CORE = 0.12
"""Radius of the area around the axis. A region that reaches into it is part of the core, with all that is in it."""

EDGE, STRONG = 0.5, 0.8
"""Least contrast of a core's pixels over the core's contrast, a half as at a blurred edge; and the quantile of what
stands out that is a core's contrast in a horizontal picture: the flesh around a star is stained, and by the median it
was a part of the stars of three apples. In radial pictures, where seeds and what holds them are as tall as a core, the
median is taken."""

WHOLE, SHARP, RAISED = 0.9, 0.95, 1.25
"""Least share of its hull that is filled by what stands out around the axis if all of that is the core, whatever lies
in it, as the hollow of a papaya with its seeds; and least share of it that stands out by more than this factor of the
least contrast. Stars and pith in eight photographs fill up to 0.86, hollows, stones and a yolk of five drawn kinds 0.92
or more, of which 0.977 or more stands out so."""

GAP = 2 * NARROWEST
"""Half width in radii of gaps that do not part such a core: between a hollow and pale seeds is the colour of flesh."""

UNDER, AT_EDGE = (0.02, 0.06), 0.1
"""Depths in radii under the outline of such a core, and the quantile there, that are its contrast at its edge: seeds
that lie there stand out more."""

NEAR = 0.15
"""Distance in radii from the height of a horizontal picture within which its core is looked for in radial ones: two
fruits do not have theirs at the same height."""

JOINS = NARROWEST, 2 * NARROWEST, 4 * NARROWEST, 8 * NARROWEST
"""Half widths in radii of what may join a core to the rind and is no part of it, such as membranes and the walls of a
tomato; the least that sets it free is taken. The cores of eight photographs have half widths of 0.06 and more, a speck
at the axis of a melon 0.009."""

WIDER = 2.0
"""Least half width of a core over that of what joins it: walls that cross at the axis are no core."""

SPREAD = 4.5
"""Least distance from the flesh of what stands out, over the usual distance in the ring where the flesh is sampled:
over the whole face, a stone and its halo would raise it."""

COLUMN = 1.8
"""Height over width from which a core is a column. In photographs two apples have 0.6 and 1.3, four oranges 2.4 to 4.3;
a drawn stone has 1.1, a drawn kiwi 3.5."""

LEAST = 0.1
"""Least part of its width that a core fills in radial pictures that show it: with less they pass beside it."""

HALF, PART = 0.5, 0.25
"""Least part that is filled, over the largest, as far as a core reaches along the axis, and as far as a column does."""

MOST_OF = 0.95
"""Share of a core that is compared with what radial pictures show: a crack may reach out of it."""

SMOOTH = 0.015
"""Standard deviation in radii of the blur of the filled parts along the axis: a seed is several times as long."""

MARGIN = 0.03
"""Radii around a core in which nothing but its picture is shown, so that no seam passes along its edge."""

COMPACT = 0.8
"""Least share of its convex hull that a core in one piece fills: drawn stones and a melon's hollow fill 0.86 to 0.99,
the stars of five apples 0.40 to 0.61, whose arms end each by itself."""

LAYER, LAYERED = 0.01, 0.7
"""Thickness in radii of layers along a core's outline, and the least share of its contrast that is between them if it
is made of layers, which are no seeds. Drawn halos around stones have 0.80, rows of seeds along a hollow up to 0.58."""

TIP, BEYOND = 0.15, 2.0
"""Least width of a core in one piece over the largest, where an ellipsoid is a hundredth from its end, and what stands
for heights where it has less: no core."""

BESIDE = 0.03
"""Distance in radii from the horizontal picture over which its own colours give way to those of equal depths."""

AXIS = 0.12
"""Distance from a ridge, over that of the edge, within which directions fade: on the ridge itself there is none. The
ridge of a seed or a grain is the line through its middle across its picture's plane."""


@dataclass(frozen=True)
class Profile:
    """How a core in one piece, such as a stone, narrows towards its ends, from radial pictures."""

    ends: NDArray[np.float64]
    """(P,). How near the heights of a disc's pixels are to the ends of the core: 0 where it is widest, 1 at its ends
    and BEYOND outside, and between them as in an ellipsoid."""
    widest: float
    """Its largest width over that in the horizontal picture."""
    height: float
    """Height of the horizontal picture in the ball."""

    @classmethod
    def of(cls, wide: NDArray[np.floating], height: float, most: float) -> Profile:
        """The profile of these widths (P,) at the heights of a disc's pixels. The horizontal picture, which is at a
        `height` in the ball, shows its core as wide as there, but is taken to show at least 1 / `most` of its largest
        width, as two fruits do not have their cores at the same height."""
        shares = wide / wide.max()
        here = max(float(np.interp(height, disc_grid()[1][0], shares)), 1 / most)
        return cls(np.where(shares > TIP, np.sqrt(1 - np.square(shares)), BEYOND), 1 / here, height)

    def at(self, rise: NDArray[np.floating]) -> NDArray[np.float64]:
        """(...). `ends` at signed distances (...) from the horizontal picture's plane."""
        return np.interp(rise + self.height, disc_grid()[1][0], self.ends)

    def grown(self, rise: NDArray[np.floating]) -> NDArray[np.float64]:
        """(...). Its width at signed distances (...) from the horizontal picture's plane, over that in the plane."""
        width = np.sqrt(np.maximum(1 - np.square(self.at(rise)), TIP**2))
        return np.asarray(width / np.sqrt(max(1 - float(self.at(np.zeros(())) ** 2), TIP**2)))

    @property
    def reach(self) -> tuple[float, float]:
        """How far in radii it reaches below and above the horizontal picture's plane."""
        level = disc_grid()[1][0] - self.height
        held = level[self.ends < 1]
        return max(-float(held.min()), MARGIN), max(float(held.max()), MARGIN)


@dataclass(frozen=True)
class Core:
    """The core of one picture as a solid, if it has any."""

    region: NDArray[np.bool_]
    """(P, P). Where the core is in the picture, and what lies between its parts."""
    form: NDArray[np.float32]
    """(P, P, 4). The half height of the solid's ridge at each pixel, over the largest; the distance of the pixel from
    the ridge, over that of the edge, from 1 outside of the core; and the vector from the ridge to the edge, in radii. A
    horizontal core in one piece has its middle for a ridge, and the length of that vector for a height."""
    tall: tuple[float, float]
    """Largest half height in radii on either side of the plane, negative distances first; both 0 with a profile, and
    without a core."""
    ends: tuple[float, float]
    """How far in radii the core reaches below and above the horizontal picture's plane, with what radial ones show of
    it."""
    reach: float
    """How far it reaches from the axis, in radii; 0 without a core."""
    profile: Profile | None = None
    """That of a core in one piece, if radial pictures show it; of a ball without them."""
    middle: tuple[float, float] = (0.0, 0.0)
    """That of a horizontal core in one piece, around which it is larger or smaller beside its picture's plane."""
    ground: Disc | None = None
    """What a core in one piece shows away from its picture's plane if things lie in it: the face without these."""

    @classmethod
    def none(cls) -> Core:
        """The core of a face without any."""
        nothing = np.zeros((DISC_PIXELS, DISC_PIXELS, 4), np.float32)
        nothing[..., 1] = 1
        return cls(nothing[..., 0] > 0, nothing, (0.0, 0.0), (0.0, 0.0), 0.0)

    @classmethod
    def across(cls, shape: NDArray[np.bool_], seen: Sequence[Shown]) -> Core:
        """The core of this shape (P, P) in a horizontal face, with the proportions that are `seen` in radial faces; if
        none shows it, it is as tall as a disc of its area is wide."""
        radius = disc_radius()
        reach = float(radius[shape].max()) + MARGIN
        if seen:
            under, over, wide = np.mean([(shown.under, shown.over, shown.wide) for shown in seen], axis=0).tolist()
            tall = (under + over) / 2 * float(np.quantile(radius[shape], MOST_OF)) / wide
        else:
            under = over = tall = float(np.sqrt(shape.sum() / np.pi)) * PIXEL
        # Two fruits do not have their cores at the same height, so it goes half way to where radial pictures show it.
        below, above = (under + tall) / 2, (over + tall) / 2
        form = form_of(shape)
        ridge = np.stack(disc_grid(), -1) - form[..., 1:2] * form[..., 2:]
        form[..., 0] = np.maximum(1 - np.square(ridge / reach).sum(-1), 0)
        return cls(radius < reach, form, (below, above), (max(under, below), max(over, above)), reach)

    @classmethod
    def along(cls, disc: Disc, core: Core, height: float) -> Core:
        """The core of a radial face of even tones, as far as it shows the core of a horizontal one at a height in the
        ball. What stands out there is as thick as it is wide, but no thicker than the other picture shows it as far
        from the axis: an arm of a star that is cut along is no ball."""
        if not core.reach:
            return core
        x, y = disc_grid()
        shape = stands_out(disc, core.reach, height) & core.holds(x, np.zeros_like(x), y - height)
        if core.profile:
            shape = ndimage.binary_fill_holes(shape)
        if not shape.any():
            return cls.none()
        form = form_of(shape)
        form[..., 0] = np.minimum(form[..., 0], np.interp(np.abs(x), *thickest(core.shape)))
        most = float(form[shape, 0].max())
        form[..., 0] /= most
        return replace(core, region=shape, form=form, tall=(most, most))

    @classmethod
    def in_one_piece(cls, shape: NDArray[np.bool_], profile: Profile) -> Core:
        """The core of this shape (P, P) in a horizontal face, as wide at every height as radial faces show it."""
        reach = float(disc_radius()[shape].max()) + MARGIN
        x, y = disc_grid()
        middle = float(x[shape].mean()), float(y[shape].mean())
        form = form_around(shape, *middle)
        return cls(disc_radius() < reach, form, (0.0, 0.0), profile.reach, reach, profile, middle)

    @property
    def shape(self) -> NDArray[np.bool_]:
        """(P, P). Where the picture shows it."""
        return self.form[..., 1] < 1

    def has_layers(self, disc: Disc) -> bool:
        """Whether what this face shows of the core are layers along its outline."""
        layer = (depth_in(self.shape)[self.shape] * PIXEL / LAYER).astype(int)
        colours = disc.rgb[self.shape].astype(np.float64)
        sums = np.stack([np.bincount(layer, channel) for channel in colours.T], -1)
        means = (sums / np.maximum(np.bincount(layer), 1)[:, None])[layer]
        return float(np.square(means - colours.mean(0)).sum()) > LAYERED * float(colours.var(0).sum() * len(colours))

    def inner(self, disc: Disc) -> Disc:
        """What this face shows of the core, and its usual colour all around."""
        there = depth_in(self.shape) * PIXEL > HALO
        return Disc(np.where(there[..., None], disc.rgb, np.median(disc.rgb[self.shape], axis=0)))

    def holds(self, x: NDArray[np.floating], y: NDArray[np.floating], rise: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(...). Whether only the horizontal picture is to be shown at places (...), (...) of it and signed distances
        (...) from its plane."""
        if not self.reach:
            return np.zeros(x.shape, bool)
        below, above = (end + MARGIN for end in self.ends)
        wide = self.reach * (self.profile.widest if self.profile else 1)
        return np.square(x * x + y * y) / wide**4 + (rise / np.where(rise > 0, above, below)) ** 4 < 1

    def depth_at(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). How deep places (M,), (M,) of a radial picture are in the core, in radii; negative outside."""
        rows, columns = (np.asarray(at, np.float32) for at in to_pixels(x, y, DISC_PIXELS))
        form = read_bilinear(self.form, rows, columns)
        return np.where(form[:, 0] > 0, (1 - form[:, 1]) * form[:, 0] * self.tall[1], -1).astype(np.float32)

    def read(
        self, disc: Disc, x: NDArray[np.floating], y: NDArray[np.floating], away: NDArray[np.floating]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M, 3) and (M,). Colours of the core of this face at places (M,), (M,) of it and distances (M,) from its
        plane, and how deep in the core they are, in radii; negative outside. Equal depths have one colour."""
        wide = np.float32(self.profile.widest if self.profile else 1)
        u, v = self._scaled(x, y, wide)
        rows, columns = (np.asarray(at, np.float32) for at in to_pixels(u, v, DISC_PIXELS))
        form = read_bilinear(self.form, rows, columns)
        off, way = form[:, 1], form[:, 2:]
        if self.profile:
            tall, part = form[:, 0] * wide, np.hypot(off, self.profile.at(away))
        else:
            tall = form[:, 0] * np.where(away > 0, self.tall[1], self.tall[0])
            part = np.hypot(off, away / np.maximum(tall, 1e-6))
        deep = np.where(tall > 0, (1 - part) * tall, -1).astype(np.float32)
        moved = (off * (np.minimum(part, 1) / np.hypot(off, AXIS) - 1))[:, None] * way
        colours = (self.ground or disc).read(u + moved[:, 0], v + moved[:, 1])
        if self.profile:
            own = disc.read(*self._scaled(x, y, self.profile.grown(away)))
            colours += np.exp(-np.square(away / BESIDE))[:, None] * (own - colours)
        return colours, deep

    def _scaled(
        self, x: NDArray[np.floating], y: NDArray[np.floating], wide: NDArray[np.floating] | np.floating
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Places (M,), (M,) of the picture, as many times as close to the middle as the core is `wide`."""
        u, v = self.middle
        return u + (x - u) / wide, v + (y - v) / wide

    def reduced(self, n: int) -> Core:
        """The same core, of a face with pixels n times as large."""
        return replace(self, ground=self.ground and self.ground.reduced(n))


def _contrast(disc: Disc, where: NDArray[np.bool_] | bool = True) -> NDArray[np.floating]:
    """(P, P). How far a face stands out from its flesh, which lies `where` (P, P) is true, over the least that counts;
    0 outside of it."""
    radius = disc_radius()
    rgb = blurred(disc.rgb, 1.0)
    ring = (radius > 1 - FLESH[1]) & (radius < 1 - FLESH[0]) & where
    flesh = np.median(rgb[ring], axis=0)
    apart = lengths(rgb - flesh) * (radius < 1)
    return apart / max(THING_CONTRAST, SPREAD * float(np.median(apart[ring])))


@dataclass(frozen=True)
class Shown:
    """What a radial face shows of a core, in radii."""

    under: float
    """How far it reaches below the height of its horizontal picture."""
    over: float
    wide: float
    """How far from the axis."""
    is_column: bool


def find_shape(disc: Disc, rind: float) -> NDArray[np.bool_] | None:
    """(P, P). Where the core is in a horizontal face with a rind of this depth in radii; None without a core."""
    radius, contrast = disc_radius(), _contrast(disc)
    for thin in JOINS:
        parts, _ = ndimage.label(opened(contrast >= 1, round(thin / PIXEL)))
        found = (parts > 0) & np.isin(parts, parts[radius < CORE])
        if not (found & (radius > min(1 - rind, RIND_RADIUS))).any():
            break
    else:
        return None
    if not found.any():
        return None
    shape = _in_one_piece(contrast, found)
    if shape is None:
        shape = ndimage.binary_fill_holes(found & (contrast > EDGE * np.quantile(contrast[found], STRONG)))
    return shape if depth_in(shape).max() * PIXEL >= WIDER * thin else None


def _in_one_piece(contrast: NDArray[np.floating], found: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(P, P). The core, of what was `found` (P, P) around the axis with this contrast (P, P), if all of that is it."""
    gap = round(GAP / PIXEL)

    def beyond(least: float) -> NDArray[np.bool_]:
        around = opened(np.pad(~(found & (contrast >= least)), gap, constant_values=True), gap)
        return np.asarray(ndimage.binary_fill_holes(~around[gap:-gap, gap:-gap]))

    whole = beyond(1)
    (region,) = regionprops(whole.astype(np.uint8))
    if region.solidity < WHOLE or beyond(RAISED).sum() < SHARP * whole.sum():
        return None
    depth = depth_in(whole) * PIXEL
    at_edge = contrast[(depth > UNDER[0]) & (depth < UNDER[1])]
    return beyond(EDGE * float(np.quantile(at_edge, AT_EDGE))) if len(at_edge) else None


def stands_out(disc: Disc, reach: float, height: float) -> NDArray[np.bool_]:
    """(P, P). Where a radial face of even tones stands out as a core does that lies at this height and reaches out to
    this radius. The flesh is that beside the axis: above and below, a core may reach as far as the poles."""
    x, y = disc_grid()
    contrast = _contrast(disc, np.abs(y) < np.abs(x))
    core = (contrast >= 1) & (np.abs(x) < reach) & (np.abs(y - height) < NEAR)
    return contrast >= max(1.0, EDGE * float(np.median(contrast[core])) if core.any() else 1.0)


def seen_along(disc: Disc, reach: float, height: float) -> Shown | None:
    """What a radial face of even tones shows of a core at this height that reaches out to this radius; None if it does
    not show it."""
    x, y = disc_grid()
    level, away = y[0], np.abs(x[:, 0])
    found = stands_out(disc, reach, height)[away < reach]
    part = ndimage.gaussian_filter1d(found.mean(0), SMOOTH / PIXEL)
    top = int(np.where(np.abs(level - height) < NEAR, part, -1).argmax())
    if part[top] < LEAST:
        return None

    def ends(share: float) -> tuple[float, float]:
        less = level[part < share * part[top]]
        return float(less[less < level[top]].max(initial=-1)), float(less[less > level[top]].min(initial=1))

    under, over = ends(PART)
    filled = found[:, (level > under) & (level < over)].mean(1) > HALF * part[top]
    wide = float(away[away < reach][filled].max(initial=PIXEL))
    is_column = over - under > 2 * COLUMN * wide
    under, over = ends(HALF)
    return Shown(max(height - under, MARGIN), max(over - height, MARGIN), wide, is_column)
