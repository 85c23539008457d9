"""Cuts off the side of a round thing that is seen beside its cut face.

A camera that looks down on a halved fruit at an angle sees its skin below the face, as a crescent that ends in an edge
as sharp as the face's own. Colour tells them apart: all around a face lies what lies under its outline on the far side,
but the crescent has a colour that the far side shows no deeper than its skin.

Of a half that is seen at a greater angle, the side is no thin crescent any more, and the outline no oval. The face is
one: it is as wide as the thing, and one half of its outline is the thing's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.completion import NEAR_BORDER
from training.faces.edges import MIXED, colours_apart, edge_strength, from_mixtures, largest_component
from training.faces.rays import Rays, diameter_of

__all__ = ["find_half", "without_side"]

TURNS = 180
"""Number of directions in which a face is looked at."""

SKIN, DEEPEST = 0.025, 0.2
"""Depth from which a face has no skin left, and the depth to which a side is looked for, as fractions of its diameter.
At an angle of 40 degrees the side of half a ball is 0.12 wide."""

SKIN_COLOUR = 0.15
"""Least RGB distance of a side from all that the far side of the face shows, in any light. The skin of a photographed
apple is 0.38 away, a drawn kiwi's 0.2; an orange's peel is 0, as it has the same colour on the face."""

LIGHTS = 0.7, 1.4
"""Factors by which the light on the two sides of a face may differ."""

PALETTE = 400
"""Number of colours that stand for those of a face's far side."""

ROUND = 0.01
"""Root mean square distance of the outline from an oval, as a fraction of the diameter, up to which a thing is round:
it is up to 0.008 in twelve photographs of apples, oranges and melons cut across. A wedge or a cake has skin or icing on
one side of its face."""

LEAST = 0.003
"""Least mean width of a side around the whole face, as a fraction of its diameter: less is as wide as outlines are off.
In 28 photographs without a side it is at most 0.0027, but for a tint."""

FADES = 1.5
"""How many times steeper the outline may be than the edge between a face and its side. It is 0.9 to 1.1 times as steep
in a photograph altered in five ways, up to 1.4 times in drawings; and 1.7 times, out of focus 1.4, beside the tint on
one side of a melon, which fades away."""

HALVES, FLATTEST, DEPTHS = 48, 0.25, 40
"""Number of directions in which the side of a half is looked for; least height of the oval that its face is, as a
fraction of its width, which is that of a disc at 75 degrees; and how many heights are tried, up to a round one."""

COARSE = 192
"""Pixels along a thing's longer side at which it is looked for."""

ALONG = np.linspace(-0.95, 0.95, 77)
"""Places along half an oval, in its half widths; at its ends both halves are one."""

EDGES, RIMS = (-0.03, -0.02, -0.01, 0.0, 0.01, 0.02, 0.03), (0.03, 0.06, 0.1)
"""How far from an oval its edge is looked for, and the depths below it that are compared, in its half widths."""

OWN, SAME_LINE = 0.06, 0.6
"""How near the thing's outline is to the far half of a face, in its half widths, and along how much of it at least:
along 0.65 and more in 24 renderings of halved apples, oranges and melons at 35 to 62 degrees."""

AS_STRONG, EDGED = 0.4, 0.8
"""Strength of the edge between a face and its side, over the outline's, and the least fraction of the near half that
has such an edge: 0.99 and more in these renderings."""

STANDS_OUT, CLEAR = 0.3, 0.68
"""Least RGB distance between a face and its side, where they meet: 0.42 and more in the renderings. And the least of
the fraction with an edge, times 1 less the ratio of what the halves of the face differ by to that distance. It is 0.77
to 0.98 in the renderings, and at most 0.63 in 29 photographs without so wide a side."""

ONE_COLOUR, SHADES = 0.35, (0.6, 1.6)
"""Greatest RGB distance within a side, over that between it and the face, and the factors by which its light may vary:
it is 0.03 to 0.18 in the renderings. The rind of an orange, white and then orange, has 0.4 and more."""

RIND = 0.09
"""RGB distance of what seems to be a side's outline from all mixtures of its colour and that behind it, from which it
is a thick rind with a skin: the sides in the renderings have 0.07 at most, those with a melon's stripes."""

WIDE_SIDE = 0.06
"""Least width of the side of a half, as a fraction of the thing's diameter: that of half a ball at 29 degrees. With
0.05, a rendered orange seen from above has one."""


def without_side(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The face (H, W) in a picture (H, W, 3), range [0, 1], without the side that is seen next to it; as it is
    unless it is round."""
    if not mask.any():
        return mask
    seen = Rays.of(mask, TURNS)
    depths = np.arange(round(DEEPEST * seen.diameter))
    skin = max(round(SKIN * seen.diameter), MIXED + 1)
    uneven = np.sqrt(np.square(seen.reach - seen.oval()).mean())
    if uneven > ROUND * seen.diameter or len(depths) <= skin:
        return mask
    smooth = ndimage.gaussian_filter(rgb, (1, 1, 0))
    colours = np.stack([seen.read(smooth[..., c], seen.reach - depths[:, None]) for c in range(3)], -1)
    found = max((_side(colours, skin, first) for first in range(0, TURNS, TURNS // 12)), key=np.sum)
    for _ in range(2):  # once more, seen from its own middle
        if not found.any():
            return mask
        found = _side(colours, skin, _middle(found))
    if found.mean() < LEAST * seen.diameter or found.max() > len(depths) - 2 * MIXED:
        return mask
    wide, strength = found > 0, edge_strength(rgb)
    (under, change), (around, contrast) = (
        _edge_along(rgb, strength, seen, wide, radii) for radii in (seen.reach - found, seen.reach)
    )
    if around * change > FADES * under * contrast:
        return mask
    return mask & seen.within(np.where(wide, seen.reach - found, seen.reach + 2), mask.shape)


def _side(colours: NDArray[np.float32], skin: int, towards: int) -> NDArray[np.float64]:
    """(T,). How wide the side is in each direction, in pixels, if it is seen somewhere on the half around the direction
    `towards`: how much deeper than on the far half colours (D, T, 3) under the outline go on that the far half shows
    nowhere below its skin."""
    away = np.abs((np.arange(TURNS) - towards + TURNS // 2) % TURNS - TURNS // 2)
    far = away > TURNS // 4
    palette = colours[skin:, far].reshape(-1, 3)
    palette = palette[:: max(len(palette) // PALETTE, 1)]
    deep = np.full(TURNS, MIXED)  # the lens mixes what is above with what is behind
    going = np.ones(TURNS, bool)
    for layer in colours[MIXED:]:
        going[going] = _apart(layer[going], palette) > SKIN_COLOUR
        if not going.any():
            break
        deep += going
    deep = ndimage.median_filter(deep, 5, mode="wrap")
    wider = np.where(far, 0, deep - np.median(deep[far]))
    turned = np.roll(wider, TURNS // 2 - towards)  # with the side in the middle, so that it is not torn
    parts, count = ndimage.label(turned > MIXED)
    if count == 0:
        return np.zeros(TURNS)
    largest = 1 + ndimage.sum_labels(turned, parts, np.arange(1, count + 1)).argmax()
    return np.roll(np.where(parts == largest, turned, 0.0), towards - TURNS // 2)


def _apart(colours: NDArray[np.float32], palette: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M,). RGB distance of colours (M, 3) from the nearest in a palette (P, 3), in the light that suits it best."""
    return colours_apart(colours, palette, LIGHTS).min(1)


def _middle(side: NDArray[np.float64]) -> int:
    """The direction in which the middle of a side lies."""
    turns = 2 * np.pi * np.arange(TURNS) / TURNS
    return int(np.round(np.angle((side * np.exp(1j * turns)).sum()) * TURNS / (2 * np.pi))) % TURNS


def _edge_along(
    rgb: NDArray[np.float32],
    strength: NDArray[np.float32],
    seen: Rays,
    wide: NDArray[np.bool_],
    radii: NDArray[np.float64],
) -> tuple[float, float]:
    """The changes of colour across an outline of these radii (N,) in the directions `wide` (N,), summed: in a pixel, at
    the steepest place nearby, and across all of the edge."""
    steepest = seen.read(strength, radii + np.arange(-MIXED, MIXED + 1)[:, None]).max(0)
    ends = radii + np.array([[-2 * MIXED], [2 * MIXED]])
    inner, outer = np.stack([seen.read(rgb[..., c], ends) for c in range(3)], -1)
    return float(steepest[wide].sum()), float(np.linalg.norm(inner - outer, axis=-1)[wide].sum())


@dataclass(frozen=True)
class _Ovals:
    """Ovals that are as wide as a thing and begin where it does, seen in one direction."""

    beside: NDArray[np.float64]
    """(2,). Unit vector along their width, row and column."""
    near: NDArray[np.float64]
    """(2,). Unit vector towards the side."""
    middle: float
    """Of their width, in pixels along `beside`."""
    wide: float
    """Half their width."""
    far: float
    """Where they and the thing begin, in pixels along `near`."""
    end: float
    """Where the thing ends."""
    deep: NDArray[np.float64]
    """(D,). Half their heights."""

    def half(self, side: int, offset: float) -> NDArray[np.float64]:
        """(2, D, A). Rows and columns ALONG their near (`side` 1) or far (-1) halves, moved outwards by `offset` half
        widths."""
        deep, round_off = self.deep[:, None], np.sqrt(1 - ALONG**2)
        outwards = np.stack([np.broadcast_to(ALONG, (len(deep), len(ALONG))), round_off * self.wide / deep])
        outwards *= offset * self.wide / np.linalg.norm(outwards, axis=0)
        across = self.middle + self.wide * ALONG + outwards[0]
        return self._places(across, self.far + deep + side * (deep * round_off + outwards[1]))

    def beyond(self, part: float) -> NDArray[np.float64]:
        """(2, D, A). Rows and columns beyond their near halves, this `part` of the way to where the thing ends."""
        deep = self.deep[:, None]
        deeper = deep + part * (self.end - self.far - 2 * deep)
        across = np.broadcast_to(self.middle + self.wide * ALONG, (len(deep), len(ALONG)))
        return self._places(across, self.far + deep + deeper * np.sqrt(1 - ALONG**2))

    def within(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(H, W). Whether places (2, H, W), rows and columns, do not lie beyond the near half of the first oval."""
        across = (np.tensordot(self.beside, places, 1) - self.middle) / self.wide
        along = (np.tensordot(self.near, places, 1) - self.far) / self.deep[0] - 1
        return np.asarray((along <= 0) | (across**2 + along**2 <= 1))

    def _places(self, across: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
        return across * self.beside[:, None, None] + along * self.near[:, None, None]


def find_half(rgb: NDArray[np.float32], thing: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(H, W). About where the cut face is of a thing (H, W) in a picture (H, W, 3), range [0, 1], that is a half and is
    seen at so great an angle that much of its side is seen, too; None if the thing is none.

    Within the near half of such a face lies what lies within its far half, and beyond it a skin of one colour. The same
    is true of a face with a thick rind that the picture's border cuts off on the other side: it is none.
    """
    inner = np.zeros_like(thing)
    inner[NEAR_BORDER:-NEAR_BORDER, NEAR_BORDER:-NEAR_BORDER] = True
    if not thing.any() or (thing & ~inner).any():
        return None
    box = tuple(slice(max(axis.min() - MIXED, 0), axis.max() + 1 + MIXED) for axis in np.nonzero(thing))
    own = thing[box]
    scale = min(1.0, COARSE / max(own.shape))
    rows, columns = (max(round(scale * side), 1) for side in own.shape)
    small, filled = (
        np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
        for image in (np.ascontiguousarray(rgb[box]), own.astype(np.float32))
    )
    whole = filled > 0.5
    rim = np.argwhere(whole & ~ndimage.binary_erosion(whole))
    if len(rim) < HALVES:
        return None
    strength = edge_strength(small)
    usual = max(float(np.median(ndimage.maximum_filter(strength, 2 * MIXED - 1)[tuple(rim.T)])), 1e-6)
    smooth = ndimage.gaussian_filter(small, (0.7, 0.7, 0))
    best, found = CLEAR, None
    for turn in 2 * np.pi * np.arange(HALVES) / HALVES:
        near, beside = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
        across, along = rim @ beside, rim @ near
        wide, middle = float(np.ptp(across)) / 2, float(across.max() + across.min()) / 2
        deep = np.linspace(FLATTEST, 1.05, DEPTHS) * wide
        deep = deep[(deep > 1) & (np.ptp(along) - 2 * deep > WIDE_SIDE * diameter_of(whole))]
        ovals = _Ovals(beside, near, middle, wide, float(along.min()), float(along.max()), deep)
        clear = _clear(smooth, filled, strength / usual, ovals)
        if clear.max(initial=0) > best:
            best, found = clear.max(), replace(ovals, deep=deep[[clear.argmax()]])
    if found is None or _third_colour(smooth, found) > RIND:
        return None
    steps = (np.linspace(0, n - 1, m) for n, m in zip((rows, columns), own.shape, strict=True))
    places = np.stack(np.meshgrid(*steps, indexing="ij"))
    face = np.zeros_like(thing)
    face[box] = own & found.within(places)
    return largest_component(face)


def _clear(
    rgb: NDArray[np.float32], filled: NDArray[np.float32], strength: NDArray[np.float32], ovals: _Ovals
) -> NDArray[np.float64]:
    """(D,). How clear it is that ovals are the face of a half, as CLEAR says, 0 if they are not: in a picture (H, W, 3)
    with edges of this strength (H, W) over that of the thing's outline, of which the thing fills this much (H, W)."""

    def usual(places: NDArray[np.float64]) -> NDArray[np.float32]:
        """(D, 3). The median colours ALONG each oval."""
        return np.median(_read(rgb, places), axis=1)

    if not len(ovals.deep):
        return np.zeros(0)
    edged = (np.max([_read(strength, ovals.half(1, o)) for o in EDGES], axis=0) > AS_STRONG).mean(1)
    inner, outer = (_read(filled, ovals.half(-1, o)) > 0.5 for o in (-OWN, OWN))
    faces = (edged > EDGED) & ((inner & ~outer).mean(1) > SAME_LINE)
    ovals = replace(ovals, deep=ovals.deep[faces])
    found = np.zeros(len(faces))
    if not faces.any():
        return found
    contrast = np.linalg.norm(usual(ovals.half(1, -RIMS[0])) - usual(ovals.half(1, RIMS[0])), axis=-1)
    unlike = np.mean(
        [np.linalg.norm(usual(ovals.half(1, -o)) - usual(ovals.half(-1, -o)), axis=-1) for o in RIMS], axis=0
    )
    middle = usual(ovals.beyond(0.5))
    uneven = np.max([colours_apart(usual(ovals.beyond(p)), middle, SHADES).diagonal() for p in (0.25, 0.8)], axis=0)
    real = (contrast > STANDS_OUT) & (uneven < ONE_COLOUR * contrast)
    found[faces] = np.where(real, edged[faces] * (1 - unlike / np.maximum(contrast, STANDS_OUT)), 0)
    return found


def _third_colour(rgb: NDArray[np.float32], oval: _Ovals) -> float:
    """RGB distance of the outline of the side beyond an oval, in a picture (H, W, 3), from mixtures of its colour and
    that behind it. A side ends in its own colour, a rind in a skin."""
    middle = np.abs(ALONG) < 0.7  # it narrows towards its ends

    own, behind, *outline = (_read(rgb, oval.beyond(p)[:, 0, middle]) for p in (0.6, 1.3, 0.85, 0.9, 0.95, 1.0, 1.05))
    return float(np.median(np.max([from_mixtures(colours, own, behind) for colours in outline], axis=0)))


def _read(image: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """(...) or (..., 3). What an image (H, W) or (H, W, 3) shows at places (2, ...), rows and columns; bilinear."""
    channels = np.moveaxis(image[..., None] if image.ndim == 2 else image, -1, 0)
    read = np.stack([ndimage.map_coordinates(one, places, order=1, mode="nearest") for one in channels], -1)
    return read[..., 0] if image.ndim == 2 else read
