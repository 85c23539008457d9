"""Seeds of a face: closed things that lie apart in calm ground, found whole.

A thing stands out by some contrast from what is left where it has ended (`relief`). Regions above a contrast form a
tree, as in stable regions (Matas et al. 2002): where several things touch, one region holds all of them, and higher up
each has its own. The lowest regions that are as round as things are taken; pixels below join the nearest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import regionprops
from skimage.morphology import h_maxima
from skimage.segmentation import expand_labels, watershed

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.quilting.disc import DISC_PIXELS, PIXEL, REACH, Disc, disc_grid, disc_radius, to_pixels
from training.priors.exemplar.quilting.relief import Relief
from training.priors.exemplar.quilting.things.core import CORE
from training.priors.exemplar.quilting.things.stamps import Things
from training.priors.exemplar.sampling import opened

__all__ = ["Seeds"]

SURE = 1.7
"""Least mean contrast of a thing (`Relief.contrast`): drops of juice in six oranges have 1.0 to 1.8, vessels in three
apples 1.2 to 2.0, four fifths of the seeds in five melons 1.7 to 3.8. Laid anew, none of the three looks wrong."""

RAISED = 1.25
"""Factor of the contrast from one level of the tree to the next."""

LEVELS = 9
"""Levels of the tree: up to six times the least contrast."""

HALF_WIDTHS, LONGEST = (0.011, 0.12), 4.0
"""Least and largest half axes of a thing in radii, and their largest ratio. The medians that tell texture from things
take anything narrower for texture; anything wider hardly closes."""

SOLID = 0.8
"""Least share of a thing's convex hull that it fills: a disc fills 0.97 and more, two that touch up to 0.83, three in a
row up to 0.80."""

GROWN = 2
"""Pixels by which a thing grows into the region that it was found in, where its edge is."""

NECK = 1.0
"""Pixels by which a thing is wider than the neck to the next one that it touches, in half widths."""

EDGE = 0.5
"""Least contrast of a thing's pixels over its median contrast: a half is where a blurred edge is. What is fainter is
its shadow or what clings to it."""


@dataclass(frozen=True)
class Seeds:
    """The seeds of one picture, if there are any."""

    parts: NDArray[np.int32]
    """(P, P). Number of the seed at each pixel of the disc, from 1; 0 for none."""
    places: NDArray[np.float64]
    """(B, 2). Places of their middles on the disc."""
    axes: NDArray[np.float64]
    """(B, 2). Half axes in radii of the disc, the longer first."""
    turns: NDArray[np.float64]
    """(B,). Angle from the disc's x axis to the longer axis, radians."""
    regions: NDArray[np.bool_]
    """(P, P). Where they are, and what stands out together with them."""

    @classmethod
    def of(cls, relief: Relief, is_horizontal: bool, rind: float, core: float = CORE) -> Seeds:
        """The seeds of a face with this relief and a rind of this depth in radii. What reaches closer to the axis than
        `core`, in radii, is no seed."""
        x, y = disc_grid()
        radius = disc_radius()
        from_core = np.hypot(x, y * is_horizontal)
        contrast = relief.contrast()
        left, found = contrast, np.zeros(radius.shape, np.int32)
        roots = None

        def is_whole(region) -> bool:  # type: ignore[no-untyped-def]
            rows = tuple(region.coords.T)
            return radius[rows].max() < 1 - rind and _is_a_thing(region) and contrast[rows].mean() > SURE

        for level in range(LEVELS):
            regions, _ = ndimage.label(opened(left >= RAISED**level))
            roots = regions if roots is None else roots
            left = left.copy()
            for region in regionprops(regions):
                rows = tuple(region.coords.T)
                if from_core[rows].min() < core and not level:
                    left[rows] = 0
                elif is_whole(region):
                    left[rows] = 0
                    if _from_core(region, is_horizontal) > core:
                        found[rows] = found.max() + 1
        assert roots is not None
        rest = (left >= 1) & (roots > 0) & ~np.isin(roots, roots[found > 0])
        for region in regionprops(_parted(np.where(rest, roots, 0), contrast)):
            if is_whole(region) and _from_core(region, is_horizontal) > core:
                found[tuple(region.coords.T)] = found.max() + 1
        under_rind = np.setdiff1d(roots[found > 0], roots[radius > 1 - rind])
        together = np.isin(roots, under_rind) | (found > 0)
        found = _trimmed(np.where(roots > 0, expand_labels(found, GROWN), 0), contrast)
        facts = [
            (*((np.array(r.centroid) + 0.5) * PIXEL - REACH), *_half_axes(r), r.orientation) for r in regionprops(found)
        ]
        table = np.array(facts, np.float64).reshape(-1, 5)
        return cls(found, table[:, :2], table[:, 2:4], table[:, 4], together)

    @classmethod
    def none(cls) -> Seeds:
        """The seeds of a face without any."""
        pairs = np.empty((0, 2))
        nothing = np.zeros((DISC_PIXELS, DISC_PIXELS), np.int32)
        return cls(nothing, pairs, pairs, np.empty(0), nothing > 0)

    def within(self, region: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """(B,). Whether their middles lie in a region (P, P)."""
        rows = tuple(np.round(to_pixels(self.places.T[0], self.places.T[1], DISC_PIXELS)).astype(int))
        return np.asarray(region[rows])

    def chosen(self, kept: NDArray[np.bool_]) -> Seeds:
        """Some of them (B,)."""
        if kept.all():
            return self
        numbers = np.concatenate([[0], np.where(kept, np.cumsum(kept), 0)]).astype(np.int32)
        return Seeds(numbers[self.parts], self.places[kept], self.axes[kept], self.turns[kept], self.regions)

    def and_also(self, others: Seeds) -> Seeds:
        """These and others of the same picture, elsewhere in it."""
        places, axes, turns = (
            np.concatenate([getattr(self, name), getattr(others, name)]) for name in ("places", "axes", "turns")
        )
        parts = np.where(others.parts > 0, others.parts + np.int32(len(self.places)), self.parts)
        return Seeds(parts, places, axes, turns, self.regions | others.regions)

    def things(self, disc: Disc) -> Things:
        """The seeds as the disc, which is this face in some light, shows them."""
        return Things.of(disc, self.places, self.axes, self.turns, self.parts)


def _parted(regions: NDArray[np.int32], contrast: NDArray[np.floating]) -> NDArray[np.int32]:
    """(P, P). The numbered regions (P, P) of things, without what is faint in them, parted at their necks: things of
    one colour that touch are one region at every contrast."""
    out = np.zeros(regions.shape, np.int32)
    for n, box in enumerate(ndimage.find_objects(regions)):
        if box is None:
            continue
        here = regions[box] == n + 1
        usual = np.median(contrast[box][here])
        if usual > SURE:
            sure = np.pad(here & (contrast[box] > EDGE * usual), 1)
            depth = depth_in(sure)
            tops, _ = ndimage.label(h_maxima(depth, NECK))
            parts = watershed(-depth, tops, mask=sure)[1:-1, 1:-1]
            out[box] = np.where(parts > 0, parts + out.max(), out[box])
    return out


def _trimmed(parts: NDArray[np.int32], contrast: NDArray[np.floating]) -> NDArray[np.int32]:
    """(P, P). Each of the parts (P, P) without what is faint in it, in one piece."""
    out = np.zeros(parts.shape, np.int32)
    for n, box in enumerate(ndimage.find_objects(parts)):
        here = parts[box] == n + 1
        pieces, _ = ndimage.label(here & (contrast[box] > EDGE * np.median(contrast[box][here])))
        out[box][pieces == np.bincount(pieces[pieces > 0]).argmax()] = n + 1
    return out


def _middle(region) -> NDArray[np.float64]:  # type: ignore[no-untyped-def]
    """(2,). Middle of a region, on the disc."""
    return (np.array(region.centroid) + 0.5) * PIXEL - REACH


def _from_core(region, is_horizontal: bool) -> float:  # type: ignore[no-untyped-def]
    """How far from the axis a thing twice as long as this region ends, in radii."""
    turn, reach = region.orientation, np.array([[2], [-2]]) * _half_axes(region)[0]
    ends = _middle(region) + reach * [np.cos(turn), np.sin(turn)]
    return float(np.hypot(ends[:, 0], ends[:, 1] * is_horizontal).min())


def _half_axes(region) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Half axes, in radii, of the ellipse with the moments of a region."""
    return region.axis_major_length / 2 * PIXEL, max(region.axis_minor_length, 1) / 2 * PIXEL


def _is_a_thing(region) -> bool:  # type: ignore[no-untyped-def]
    """Whether a region of a picture has the size and the shape of a thing."""
    long, short = _half_axes(region)
    return HALF_WIDTHS[0] < short <= long < min(HALF_WIDTHS[1], LONGEST * short) and region.solidity > SOLID
