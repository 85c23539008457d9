"""Cuts off the side of a round thing that is seen beside its cut face.

A camera that looks down on a halved fruit at an angle sees its skin below the face, as a crescent that ends in an edge
as sharp as the face's own. Colour tells them apart: all around a face lies what lies under its outline on the far side,
but the crescent has a colour that the far side shows no deeper than its skin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.bulges import oval_of, reach_of
from training.faces.edges import MIXED, edge_strength

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
    diameter = float(np.sqrt(4 / np.pi * mask.sum()))
    middle = np.array([places.mean() for places in np.nonzero(mask)])
    turns = np.linspace(0, 2 * np.pi, TURNS, endpoint=False)
    rays = np.stack([np.sin(turns), np.cos(turns)])
    reach = reach_of(mask, middle, rays)
    if np.sqrt(np.square(reach - oval_of(turns, reach)).mean()) > ROUND * diameter:
        return mask
    depths = np.arange(round(DEEPEST * diameter))
    at = middle[:, None, None] + rays[:, None] * (reach - depths[:, None])
    smooth = ndimage.gaussian_filter(rgb, (1, 1, 0))
    colours = np.stack([ndimage.map_coordinates(smooth[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
    skin = max(round(SKIN * diameter), MIXED + 1)
    found = max((_side(colours, skin, first) for first in range(0, TURNS, TURNS // 12)), key=np.sum)
    for _ in range(2):  # once more, seen from its own middle
        if not found.any():
            return mask
        found = _side(colours, skin, _middle(found))
    wide = np.flatnonzero(found)
    if found.mean() < LEAST * diameter or found.max() > len(depths) - 2 * MIXED:
        return mask
    strength = edge_strength(rgb)
    under, around = (_steepness(rgb, strength, middle, rays[:, wide], reach[wide] - deep) for deep in (found[wide], 0))
    if around > FADES * under:
        return mask
    rows, columns = (axis - start for axis, start in zip(np.indices(mask.shape), middle, strict=True))
    turn = np.arctan2(rows, columns) % (2 * np.pi)
    inner = np.where(found > 0, reach - found, np.inf)
    return mask & (np.hypot(rows, columns) <= np.interp(turn, turns, np.minimum(inner, reach + 2), period=2 * np.pi))


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
    parts, _ = ndimage.label(np.roll(wider, -towards - TURNS // 2) > MIXED)  # in the middle, so that none is torn
    if not parts.any():
        return np.zeros(TURNS)
    largest = ndimage.sum_labels(np.roll(wider, -towards - TURNS // 2), parts, np.arange(1, parts.max() + 1)).argmax()
    return np.where(np.roll(parts, towards + TURNS // 2) == largest + 1, wider, 0.0)


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


def _steepness(
    rgb: NDArray[np.float32],
    strength: NDArray[np.float32],
    middle: NDArray[np.float64],
    rays: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> float:
    """How steep the edge is along an outline of these radii (N,) along rays (2, N), at the steepest place nearby: its
    change of colour in a pixel over that across all of it."""

    def at(image: NDArray[np.float32], steps: NDArray[np.int64]) -> NDArray[np.float32]:
        places = middle[:, None, None] + rays[:, None] * (radii + steps[:, None])
        return np.asarray(ndimage.map_coordinates(image, places, order=1, mode="nearest"))

    steepest = at(strength, np.arange(-MIXED, MIXED + 1)).max(0)
    ends = np.stack([at(rgb[..., c], np.array([-2 * MIXED, 2 * MIXED])) for c in range(3)], -1)
    return float(steepest.sum() / np.linalg.norm(ends[0] - ends[1], axis=-1).sum())
