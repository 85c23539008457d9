"""Cuts off what hangs on one side of a found face: its shadow, its mirror image in the table, the side of the fruit;
and the other half of the fruit, or whatever else touches it.

Light may tint a shadow, and a white table too bright for the camera has no colour to compare it with; GrabCut then
takes the shadow for a part of the face. Two things give it away: it bulges out of an oval that the rest of the outline
follows, and it fades out, whereas the face under it ends in an edge. Things that touch have a neck between them, and
the edge of the one in front runs through.
"""

from __future__ import annotations

from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.faces.completion import NEAR_BORDER, Oval, fit_oval
from training.faces.edges import (
    BARE,
    EDGE_GAIN,
    HALF,
    MIXED,
    cheapest_path,
    colours_apart,
    edge_cost,
    edge_strength,
    largest_component,
    nearest,
    rims_apart,
    skin_share,
)
from training.faces.rays import Rays, diameter_of

__all__ = ["LOBE", "find_bays", "find_front", "without_bulges"]

BAND = 0.07, 0.015
"""How far inside and outside of the oval the outline is searched, as fractions of the face's diameter: deeper than
shadows hang. In the 29 photographs and 20 changed ones 0.05 inside and 0.025 outside cut off the same."""

ONE_SIDE = 0.5
"""Largest fraction of the way around a face that a bulge covers: 0.1 to 0.4 in changed photographs. A rind that is
hardly darker or paler than the table is all around."""

NECK, LOBE = 0.85, 0.5
"""Greatest half width of a neck over the depth of the things on both sides of it, and least depth of these over the
greatest. Crowns, stalks and the shoulders of bread are shallower, or have no neck: none of 29 photographed faces is
taken for two; two that overlap by a third of their width are."""

NECKS = np.linspace(0.2, NECK, 27)
"""Half widths of necks that are looked for, over the greatest depth."""

AWAY = 0.15
"""Distance from where two things meet, over the neck's half width, from which an outline is surely one's own."""

BAY, BAYS = 0.02, 4
"""Least depth of a bay between two things that overlap, as a fraction of the diameter of both, and how many of the
deepest are looked at. Of two equal discs, bays are 0.063 deep where one hides a third of the other, and 0.033 where it
hides half."""

OVAL = 0.07
"""Greatest misfit of the oval of either of them. Photographed faces before whole fruit have 0.004 to 0.04, the fruit up
to 0.056; both parts of a single face between two bays only where it is a loaf (0.09), a pomegranate with a crown
(0.096), or an apple's halves, between which there is no edge."""

RIM, INSIDE = 0.05, 0.12
"""Depths, as fractions of a thing's diameter, up to which its colours are those of its outline, and from which they are
those of its inside."""

UNLIKE, LIGHTS = 0.08, (0.4, 2.5)
"""RGB distance of a colour inside from nine in ten along the outline from which it is another one, and the factors by
which the light on a whole fruit varies. In small photographs up to 0.06 of what is seen of nine whole fruits is such,
of an onion 0.2; and 0.3 to 0.7 of a mangosteen, onion, jackfruit and wood-apple cut open."""

WHOLE = 0.9
"""Fraction of a mask from which a thing in it is all but a stalk or a crown, which are no things of their own."""

FRONT = 0.1
"""How far from its oval the edge of a thing in front of another is searched, as a fraction of its diameter. At half of
that an edge costs twice as much, as the inner edge of a skin may be as strong as the outer one."""

ALIKE = 1.1
"""Costs of two edges, one over the other, up to which both things may be in front, as where they merely touch: then the
face is one with a skin, or the larger one. Of photographed faces that overlap, those behind have edges 1.14 to 9 times
as costly."""


def find_front(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(H, W). That of several things in a mask (H, W) which is in front of the others, in a picture (H, W, 3), range
    [0, 1]; None if there is one thing."""
    front = _next_front(rgb, mask)
    # It may be several things again: without the others, the face has a skin on more of its outline.
    while front is not None and (further := _next_front(rgb, front)) is not None:
        if skin_share(rgb, further) <= skin_share(rgb, front):
            break
        front = further
    return front


def _next_front(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(H, W). One step of it: the part of a mask (H, W) in front, which may be several things itself."""
    lobes = _lobes(mask)
    guesses = lobes or _between_bays(mask)
    if not guesses:
        return None
    cost = edge_cost(edge_strength(rgb))
    edges = [_front_edge(cost, mask, guess) for guess in guesses]
    if not lobes:
        edges = [(along, face) for along, face in edges if _runs_through(cost, mask, face)]
    edges = [(along, face) for along, face in edges if face.any()]
    if not edges:
        return None
    # The face, not a whole fruit: this has one colour, outside and within.
    shown = [skin_share(rgb, face) for _, face in edges]
    if max(shown) <= HALF:
        shown = [max(skin, _coloured_share(rgb, face)) for skin, (_, face) in zip(shown, edges, strict=True)]
    found = [(*one, share) for one, share in zip(edges, shown, strict=True) if share > max(shown) - BARE]
    least = min(along for along, _, _ in found)
    likely = [one for one in found if one[0] <= ALIKE * least]
    return max(likely, key=lambda one: (one[2] > HALF, one[1].sum()))[1]


def _coloured_share(rgb: NDArray[np.float32], thing: NDArray[np.bool_]) -> float:
    """Fraction of the inside of a thing (H, W) in a picture (H, W, 3) that has a colour unlike those along its outline,
    in any light. Range [0, 1]."""
    depth, across = depth_in(thing), diameter_of(thing)
    smooth = ndimage.gaussian_filter(rgb, (1, 1, 0))
    rim, inside = smooth[(depth >= MIXED) & (depth < RIM * across)], smooth[depth > INSIDE * across]
    if not len(rim) or not len(inside):
        return 0.0
    rim, inside = (some[:: max(len(some) // count, 1)] for some, count in ((rim, 300), (inside, 2000)))
    return float((np.quantile(colours_apart(inside, rim, LIGHTS), 0.1, axis=1) > UNLIKE).mean())


def _lobes(mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """(H, W) each. Guesses of the things in a mask (H, W) that has necks between them."""
    apart = _apart(mask)
    if apart is None:
        return []
    owner, neck = apart
    rim = mask & ~ndimage.binary_erosion(mask)
    guesses = []
    for lobe in np.unique(owner[mask]):
        own = mask & (owner == lobe)
        away = depth_in(~(mask & ~own))
        rows, columns = np.nonzero(rim & own & (away > max(MIXED, AWAY * neck)))
        oval = fit_oval(np.stack([columns, rows], -1))
        if oval is not None:
            guesses.append(largest_component(mask & (_within(oval, mask.shape) | (own & (away > neck)))))
    return [guess for guess in guesses if guess.any()]


def _between_bays(mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """(H, W) each. Guesses of the two things in a mask (H, W) that overlap by so much that there is no neck: both parts
    of its outline between two of its deepest bays are those of ovals."""
    outline, bays = find_bays(mask)
    near = round(BAY * diameter_of(mask))
    guesses = []
    for first, last in combinations(bays, 2):
        halves = np.roll(outline, -first, 0)[: last - first], np.roll(outline, -last, 0)[: len(outline) + first - last]
        parts = [half[near : len(half) - near] for half in halves]
        ovals = [oval for part in parts if (oval := fit_oval(part)) is not None and oval.misfit(part) < OVAL]
        both = [largest_component(mask & _within(oval, mask.shape)) for oval in ovals]
        if len(both) == len(parts) and all(1 - WHOLE < guess.sum() / mask.sum() < WHOLE for guess in both):
            guesses += both
    return guesses


def find_bays(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], list[int]]:
    """(N, 2). The outline of a mask (H, W) as (x, y), and where in it the deepest bays are, in order."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = np.asarray(max(outlines, key=len)[:, 0], np.int32)
    # Where an outline passes a place twice, the hull's corners may come out of order, which OpenCV refuses.
    corners = np.sort(cv2.convexHull(outline[:, None], returnPoints=False), axis=0)
    defects = cv2.convexityDefects(outline[:, None], corners) if len(corners) > 3 else None
    if defects is None:
        return outline, []
    _, _, at, depth = defects.reshape(-1, 4).T
    deepest = np.argsort(depth, kind="stable")[-BAYS:]
    return outline, sorted(at[deepest][depth[deepest] / 256 > BAY * diameter_of(mask)].tolist())  # in fixed point


def _within(oval: Oval, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W). The pixels of a picture in an oval."""
    return oval.contains(np.moveaxis(np.indices(shape, np.float64)[::-1], 0, -1) + 0.5)


def _runs_through(cost: NDArray[np.float64], mask: NDArray[np.bool_], face: NDArray[np.bool_]) -> bool:
    """Whether a face (H, W) in a mask (H, W) ends there in an edge like that of the mask, by what its pixels cost."""
    rim = face & ~ndimage.binary_erosion(face)
    through = rim & (depth_in(np.pad(mask, 1))[1:-1, 1:-1] > 2 * MIXED)
    outer = rim & ~through
    return bool(through.any() and outer.any() and cost[through].mean() < EDGE_GAIN * cost[outer].mean())


def _apart(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int32], float] | None:
    """(H, W) and pixels. The thing that each pixel is nearest to and the half width of the neck, if a mask (H, W) has
    several with a neck between them."""
    depth = depth_in(np.pad(mask, 1))[1:-1, 1:-1]
    deep = depth > LOBE * depth.max()
    for neck in NECKS * depth.max():
        parts, count = ndimage.label(depth > neck)
        peaks = np.zeros(count + 1, depth.dtype)
        np.maximum.at(peaks, parts[deep], depth[deep])
        things = np.flatnonzero(neck < NECK * peaks)
        if len(things) > 1:
            return parts[tuple(nearest(np.isin(parts, things)))], float(neck)
    return None


def _front_edge(
    cost: NDArray[np.float64], mask: NDArray[np.bool_], guess: NDArray[np.bool_]
) -> tuple[float, NDArray[np.bool_]]:
    """What an edge costs in the mean, (H, W), that bounds one thing (H, W) of a mask (H, W) within it; and the thing
    (H, W) with this edge in place of its guessed one."""
    seen = Rays.of(guess, max(int(np.pi * diameter_of(guess)), 8))  # a pixel apart
    beyond = seen.reach + MIXED + 1
    within = seen.read(mask.astype(np.float32), beyond[None])[0] > 0.5
    steps = np.arange(-np.ceil(FRONT * seen.diameter), np.ceil(FRONT * seen.diameter) + 1)
    off = np.abs(steps)[:, None]
    weights = 1 + np.square(2 * off / (FRONT * seen.diameter))
    costs = np.where(within, weights * seen.read(cost, seen.reach + steps[:, None]), off * cost.max())
    path = _closed_path(costs)
    along = costs[path, np.arange(len(path))][within]
    face = mask & seen.within(seen.reach + steps[path], mask.shape)
    return float(along.mean()) if len(along) else np.inf, largest_component(ndimage.binary_opening(face, iterations=2))


def _closed_path(costs: NDArray[np.floating]) -> NDArray[np.int64]:
    """(N,). The cheapest path across costs (R, N) whose last column is beside its first."""
    count = costs.shape[1]
    # Twice around, keeping the middle: it is not known where to begin.
    return np.roll(cheapest_path(np.tile(costs, 2).astype(np.float64))[count // 2 : count // 2 + count], count // 2)


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
    radius = oval + steps[_closed_path(costs)]
    if (seen.reach - radius > MIXED).mean() > ONE_SIDE:
        return np.ones_like(mask)
    return seen.within(radius, mask.shape)
