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

__all__ = ["oval_of", "reach_of", "without_bulges"]

BAND = 0.07, 0.015
"""How far inside and outside of the oval the outline is searched, as fractions of the face's diameter: deeper than
shadows hang. In the 29 photographs and 20 changed ones 0.05 inside and 0.025 outside cut off the same."""

ONE_SIDE = 0.5
"""Largest fraction of the way around a face that a bulge covers: 0.1 to 0.4 in changed photographs. A rind that is
hardly darker or paler than the table is all around."""

OUTLYING = 4.0
"""Spreads outside of the oval from which a place does not count in fitting it; twice as many inside of it, where a face
may have a dent, but no bulge."""

LEAST_SPREAD = 0.003
"""Least spread as a fraction of the radius: half a pixel of a small face."""

FITS = 30
"""Rounds of fitting, each with weights from the one before."""


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
    diameter = float(np.sqrt(4 / np.pi * mask.sum()))
    middle = np.array([places.mean() for places in np.nonzero(mask)])
    turns = np.linspace(0, 2 * np.pi, max(int(np.pi * diameter), 8), endpoint=False)  # a pixel apart
    rays = np.stack([np.sin(turns), np.cos(turns)])
    reach = reach_of(mask, middle, rays)
    oval = oval_of(turns, reach)
    steps = np.arange(-np.ceil(BAND[0] * diameter), np.ceil(BAND[1] * diameter) + 1)
    radii = oval + steps[:, None]
    costs = ndimage.map_coordinates(cost, middle[:, None, None] + rays[:, None] * radii, order=1, mode="nearest")
    # Twice around, keeping the middle: it is not known where to begin.
    count = len(turns)
    path = np.roll(cheapest_path(np.tile(costs, 2))[count // 2 : count // 2 + count], count // 2)
    radius = oval + steps[path]
    if (reach - radius > MIXED).mean() > ONE_SIDE:
        return np.ones_like(mask)
    rows, columns = (axis - start for axis, start in zip(np.indices(mask.shape), middle, strict=True))
    turn = np.arctan2(rows, columns) % (2 * np.pi)
    return np.hypot(rows, columns) <= np.interp(turn, turns, radius, period=2 * np.pi)


def reach_of(mask: NDArray[np.bool_], middle: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,). How far a mask (H, W) reaches from a place (2,) along rays (2, N), pixels, at least one."""
    steps = np.arange(1, int(np.hypot(*mask.shape)))
    places = np.round(middle[:, None, None] + rays[:, None] * steps[:, None]).astype(int)
    size = np.array(mask.shape)[:, None, None]
    seen = ((places >= 0) & (places < size)).all(0)
    rows, columns = np.clip(places, 0, size - 1)
    return (steps[:, None] * (seen & mask[rows, columns])).max(0).clip(1).astype(np.float64)


def oval_of(turns: NDArray[np.float64], reach: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,). The radius of an oval that most of an outline follows; the more a place stands out, the less it counts."""
    basis = np.stack([np.ones_like(turns), *(f(k * turns) for k in (1, 2) for f in (np.cos, np.sin))], -1)
    wanted, weights = np.log(reach), np.ones_like(reach)
    for _ in range(FITS):
        found = basis @ np.linalg.lstsq(basis * weights[:, None], wanted * weights, rcond=None)[0]
        apart = wanted - found
        spread = max(float(1.48 * np.median(np.abs(apart))), LEAST_SPREAD)
        outlying = apart / (OUTLYING * spread)
        weights = np.clip(1 - np.square(np.where(apart > 0, outlying, outlying / 2)), 1e-3, 1)  # Tukey's
    return np.exp(found)
