"""Cuts off what hangs on one side of a found face: its shadow, its mirror image in the table, the side of the fruit.

Light may tint a shadow, and a white table too bright for the camera has no colour to compare it with; GrabCut then
takes the shadow for a part of the face. Two things give it away: it bulges out of an oval that the rest of the outline
follows, and it fades out, whereas the face under it ends in an edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.faces.completion import NEAR_BORDER
from training.faces.edges import EDGE_GAIN, MIXED, cheapest_path, edge_cost, edge_strength, rims_apart
from training.faces.rays import Rays, diameter_of

__all__ = ["without_bulges"]

BAND = 0.07, 0.015
"""How far inside and outside of the oval the outline is searched, as fractions of the face's diameter: deeper than
shadows hang. In the 29 photographs and 20 changed ones 0.05 inside and 0.025 outside cut off the same."""

ONE_SIDE = 0.5
"""Largest fraction of the way around a face that a bulge covers: 0.1 to 0.4 in changed photographs. A rind that is
hardly darker or paler than the table is all around."""


def without_bulges(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The face (H, W) in a picture (H, W, 3), range [0, 1], without the bulges under which the edge is, on
    average, EDGE_GAIN times as strong as around them: stalks, crowns and corners have strong edges around them."""
    if not mask.any():
        return mask
    cost = edge_cost(edge_strength(rgb))
    smooth = mask & _within_outline(cost, mask)
    parts, _ = ndimage.label(mask & ~smooth)
    width = depth_in(parts > 0)
    border = np.ones(mask.shape, bool)
    border[NEAR_BORDER:-NEAR_BORDER, NEAR_BORDER:-NEAR_BORDER] = False
    kept = mask.copy()
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        grown = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        part = parts[grown] == number
        if width[grown][part].max() < MIXED:
            continue  # both lie on one edge
        rims = rims_apart(part, mask[grown], smooth[grown])
        around, under = (cost[grown][rim & ~border[grown]] for rim in rims)  # the picture's border is no edge
        if len(around) and len(under) and around.mean() > EDGE_GAIN * under.mean():
            kept[grown] &= ~part
    return kept


def _within_outline(cost: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The pixels within the cheapest closed path around a face (H, W) near its oval, by dynamic programming
    over its directions (Amini et al. 1990); all pixels if the path is inside the face's outline on more than
    ONE_SIDE."""
    seen = Rays.of(mask, max(int(np.pi * diameter_of(mask)), 8))  # a pixel apart
    oval = seen.oval()
    steps = np.arange(-np.ceil(BAND[0] * seen.diameter), np.ceil(BAND[1] * seen.diameter) + 1)
    costs = seen.read(cost, oval + steps[:, None])
    # Twice around, keeping the middle: it is not known where to begin.
    count = len(oval)
    path = np.roll(cheapest_path(np.tile(costs, 2))[count // 2 : count // 2 + count], count // 2)
    radius = oval + steps[path]
    if (seen.reach - radius > MIXED).mean() > ONE_SIDE:
        return np.ones_like(mask)
    return seen.within(radius, mask.shape)
