"""Cuts off the side of a round thing that is seen beside its cut face.

A camera that looks down on a halved fruit at an angle sees its skin below the face, as a crescent that ends in an edge
as sharp as the face's own. Colour tells them apart: all around a face lies what lies under its outline on the far side,
but the crescent has a colour that the far side shows no deeper than its skin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.edges import MIXED, edge_strength
from training.faces.rays import Rays

__all__ = ["without_side"]

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
    product, square = colours @ palette.T, np.square(palette).sum(1)
    light = np.clip(product / np.maximum(square, 1e-6), *LIGHTS)
    squared = np.square(colours).sum(1)[:, None] + light * (light * square - 2 * product)
    return np.sqrt(np.maximum(squared.min(1), 0))


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
