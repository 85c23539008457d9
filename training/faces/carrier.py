"""A face that lies on something: a plate, a board, a saucer on a table.

What stands out from a picture's border is then the plate with the face on it. Its edge tells which it is: a face ends
in a skin, rind or crust, a third colour between its flesh and what is behind it; a plate ends in its own colour, and
its edge is a mixture of plate and table. What lies on a plate gives itself away too: it has a skin of its own, and dims
the plate beside it without changing its colour, whereas the parts of a fruit differ in colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.solid.distance_transform import depth_in
from training.faces.background import Background, find_background, find_main_surface, find_pattern, is_patterned
from training.faces.bulges import LOBE, find_bays, find_front
from training.faces.completion import NEAR_BORDER, find_oval
from training.faces.edges import BARE, HALF, MIXED, SKINNED, THIRD_COLOUR, largest_component, nearest, skin_share
from training.faces.outline import (
    CHANCE,
    MIN_CENTRAL,
    CutOffError,
    find_central,
    find_mask,
    is_dimmed_around,
    solidity,
    trace,
)
from training.faces.rays import diameter_of
from training.faces.shadow import SHADE, light_around
from training.faces.side import find_half

__all__ = ["SeenFace", "find_seen_face"]

LEVELS = 3
"""Number of stacked carriers that are looked through: a slice on a plate on a board on a table."""

RIM = 0.025
"""Width of a carrier's edge, which is neither plate nor table, as a fraction of its diameter."""

COMPARED = 192
"""Pixels along a carrier's longer side at which it is searched: a shadow and a skin of one hundredth are seen."""

TINT = 0.03
"""RGB distance by which a carrier may change colour in the shadow of what lies on it: plates change by 0.01, the rinds
of fruit by 0.1."""

NEAR = 0.1
"""How far from a face its shadow is looked for, as a fraction of its diameter."""

HANGING = 0.03
"""Radius of the disc that must fit into every part of a face in front of a pattern, as a fraction of the face's
diameter: it cuts off half or more of the squares that hang on the face, and all of a stalk."""

ONE_SIDED, LAID = 0.65, 0.1
"""How one-sided the shadow of something without a visible skin must be, and the least fraction of the carrier that it
must cover, to be taken for the face. Under light from a side they are 0.76 to 0.92, and a quarter or more, because
people fill their plates. The dark surroundings of a core have 0 to 0.5, and pips and holes cover a hundredth."""

GAP, FACING = 0.2, 0.3
"""Width of a gap between parts of one thing, as a fraction of a part's diameter, and the least fraction of its outline
that lies along one: 0.22 of two discs that touch, and 0.47 of the outermost of three layers of a cake. Of two squares
side by side it is 0.35: the larger is taken, as of any parts, and nothing is painted out."""

ARM = 1.15
"""Greatest thickness of an arm anywhere, over its width at the border."""

SOLID = 0.9
"""Fraction of its convex hull below which a face is not believed in silence: hand-made masks of 29 photographs fill
0.93 and more; two that were found with a strip of sea on both sides fill 0.84 and 0.85."""

SHADOWED = 15
"""Percentage of the way around a face that must be in shadow for it to be believed: a shadow falls to one side."""


@dataclass(frozen=True)
class SeenFace:
    """A cut face in a picture."""

    mask: NDArray[np.bool_]
    """(H, W). Its pixels."""
    note: str = ""
    """What the user should check, in a line; empty if nothing else explains the picture."""


@dataclass(frozen=True)
class _Within:
    """What stands out from a region's own ground."""

    region: NDArray[np.bool_]
    """(H, W). The region without its edge."""
    skinned: float
    """Fraction of its outline that has a skin. Range [0, 1]."""
    shadow: float
    """How one-sided its shadow is, 0 if it throws none: the fraction of the variance of the light around it that has
    one maximum and one minimum. Range [0, 1]."""
    share: float
    """Fraction of the region that it covers. Range (0, 1]."""


def find_seen_face(rgb: NDArray[np.float32], name: object) -> SeenFace:
    """The cut face in a picture (H, W, 3), range [0, 1], and whether it may be something else: as `find_mask`, but
    without what the face lies on. Raises InputError as `find_mask` does."""
    plain = find_background(rgb)
    without = None if plain is None or is_patterned(plain) else _without_others(rgb, plain)
    if without is None:
        return _find_alone(rgb, name, plain)
    seen = _find_alone(without, name, find_background(without))
    return SeenFace(seen.mask, seen.note or _BESIDE)


def _find_alone(rgb: NDArray[np.float32], name: object, plain: Background | None) -> SeenFace:
    """The same in a picture without other things apart from the face, before this background, if it is `plain`."""
    patterned = is_patterned(plain)
    mask, refusal = (None, None) if patterned else _found_or_refused(rgb, name, plain)
    if mask is None:
        # Where a plate crosses the border, the face on it may well not.
        on_it = _on_what_crosses_the_border(rgb, plain)
        if on_it is not None:
            return SeenFace(on_it, _TAKEN_OFF)
        if refusal is None:
            before_pattern = _before_pattern(rgb)
            if before_pattern is not None:
                return SeenFace(before_pattern, _PATTERN)
            mask, refusal = _found_or_refused(rgb, name, plain)
    if isinstance(refusal, CutOffError):
        # Before bricks or a kitchen, what reaches the border may be no part of the face.
        mask, patterned = find_central(rgb), True
    if mask is None:
        assert refusal is not None
        raise refusal
    front = find_front(rgb, mask)
    mask, note = _without_arm(mask) if front is None else (front, _TOUCHING)
    half = find_half(rgb, mask)
    if half is not None:
        traced = trace(rgb, half)
        mask, note = (traced if traced.sum() > half.sum() / 2 else half), _SIDE
    if patterned:
        note = note or _PATTERN
    elif solidity(mask) < SOLID and not note:
        central = find_central(rgb)  # without a third surface behind the face, such as the sea between sky and sand
        mask, note = (mask, _BAYS) if central is None or solidity(central) < SOLID else (central, _PATTERN)
    if np.percentile(np.ptp(rgb[mask], axis=1), 95) < THIRD_COLOUR:
        return SeenFace(mask, note)  # grey: there is no third colour, whatever it is
    for _ in range(LEVELS):
        within, skinned = _look_within(rgb, mask), skin_share(rgb, mask)
        lies = 0 if within is None else int(within.skinned > HALF) + int(within.shadow > 0)
        is_carrier = within is not None and skinned < BARE and (within.skinned > HALF or _is_laid_on(within))
        found = _search(rgb, within.region) if within is not None and is_carrier else None
        if found is None:
            if skinned < HALF:
                note = note or _BARE
            elif skinned < SKINNED and len(find_bays(mask)[1]) > 1:
                note = note or _BAYS
            elif lies > (skinned >= SKINNED):
                note = note or _MAY_BE
            elif skinned < SKINNED:
                note = note or _PARTLY
            break
        mask, note = found, _TAKEN_OFF
    return SeenFace(mask, note or (_RIM if is_dimmed_around(rgb, mask) else ""))


def _found_or_refused(
    rgb: NDArray[np.float32], name: object, plain: Background | None
) -> tuple[NDArray[np.bool_] | None, InputError | None]:
    """(H, W). The face before a plain background, or why there is none."""
    try:
        return find_mask(rgb, name, plain), None
    except InputError as error:
        return None, error


_LOOK = "see whether its outline is right"
_ARM = f"what reaches from the border to the cut face is left out; {_LOOK}"
_TOUCHING = f"something else seems to touch the cut face or to lie behind it, and is left out; {_LOOK}"
_BESIDE = f"something else lies beside the cut face, and is left out; {_LOOK}"
_SIDE = f"the side of the object is seen beside its cut face, and is left out; {_LOOK}"
_BAYS = f"the outline of what was found has bays, as where something beside the cut face is taken for a part; {_LOOK}"
_TAKEN_OFF = f"the cut face seems to lie on a plate or board, which is left out; {_LOOK}"
_PATTERN = f"what is behind the cut face has several colours, which a face may share; {_LOOK}"
_RIM = f"it is dark on all sides of the cut face, where a rind or crust in the colour of the table may be; {_LOOK}"
_BARE = (
    "hardly a skin or rind is seen around what was found, which may be a plate, a board, or only a part of the face; "
    f"{_LOOK}"
)
_PARTLY = f"no skin or rind is seen on one side of what was found, where it may be seen from outside; {_LOOK}"
_MAY_BE = f"what was found may be a plate or board with the cut face on it; {_LOOK}"


def _without_others(rgb: NDArray[np.float32], plain: Background) -> NDArray[np.float32] | None:
    """(H, W, 3). The picture without the things that lie apart from the face before a `plain` background; None if there
    are none. The face is the largest of those with most of a skin: a whole fruit has one colour."""
    parts, _ = ndimage.label(ndimage.binary_fill_holes(ndimage.binary_opening(~plain.shaded, iterations=2)))
    peaks = ndimage.maximum(depth_in(parts > 0), parts, np.arange(parts.max() + 1))
    things = [parts == number for number in np.flatnonzero(peaks > LOBE * peaks.max(initial=0))]
    if len(things) < 2 or any(_is_part(thing, np.any(things, axis=0) & ~thing) for thing in things):
        return None
    skins = [skin_share(rgb, thing) for thing in things]
    largest = skins[int(np.argmax([thing.sum() for thing in things]))]
    if max(skins) < min(SKINNED, largest + BARE):  # pieces of a face in the table's colour, maybe
        return None
    face = max((t for t, skin in zip(things, skins, strict=True) if skin > max(skins) - CHANCE), key=np.sum)
    others = ndimage.binary_dilation(np.any([t for t in things if t is not face], axis=0), iterations=2 * MIXED)
    ground = nearest(plain.shaded & ~others & ~ndimage.binary_dilation(face, iterations=2 * MIXED))
    return np.where((others & ~face)[..., None], rgb[tuple(ground)], rgb)


def _is_part(thing: NDArray[np.bool_], others: NDArray[np.bool_]) -> bool:
    """Whether much of a thing's outline (H, W) runs beside others (H, W), as between layers in the table's colour."""
    rim = thing & ~ndimage.binary_erosion(thing)
    return bool((depth_in(~others)[rim] < GAP * diameter_of(thing)).mean() > FACING)


def _on_what_crosses_the_border(rgb: NDArray[np.float32], plain: Background | None) -> NDArray[np.bool_] | None:
    """(H, W). The face on a ground that covers no corner of the picture, or that is itself only partly seen beside a
    `plain` background; None if nothing on it both has a skin and throws a shadow: what is found may be the seeds of a
    face that the border cuts off."""
    regions = [find_main_surface(rgb)]
    if plain is not None:
        regions.append(ndimage.binary_opening(~plain.shaded, iterations=2))
    for region in regions:
        within = _look_within(rgb, largest_component(region))
        if within is not None and within.shadow > 0 and within.skinned > HALF:
            return _search(rgb, within.region)
    return None


def _before_pattern(rgb: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """(H, W). The face in front of a cloth or board of several colours, or among others; None if hardly anything stands
    out.

    Squares of the cloth have edges as strong as the face's, and those in its shadow have colours of their own: what the
    pattern explains, and what hangs on the face by a corner, is no part of it.
    """
    pattern = find_pattern(rgb)
    if pattern is None:
        return None
    try:
        mask = find_mask(rgb, "", pattern)
    except InputError:
        return None
    unlike = ndimage.binary_opening(~pattern.shaded, iterations=2)
    mask &= ndimage.binary_dilation(largest_component(unlike), iterations=2)
    radius = HANGING * np.sqrt(4 / np.pi * mask.sum())
    deep = depth_in(mask) > radius
    face = largest_component(depth_in(~deep) <= radius) if deep.any() else deep
    if face.mean() < MIN_CENTRAL:
        return None
    # Other faces on all sides are a pattern, too, and what they do not explain is a piece of this one.
    skinned = skin_share(rgb, face)
    central = find_central(rgb) if skinned < SKINNED else None
    return face if central is None or skin_share(rgb, central) < skinned + BARE else central


def _without_arm(mask: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], str]:
    """The mask (H, W) without a finger, a fork or a stalk by which it reaches the border, and a note if there was one.

    Where a face itself lies on the border, no part of it there is longer than half its width.
    """
    border = np.ones(mask.shape, bool)
    border[NEAR_BORDER:-NEAR_BORDER, NEAR_BORDER:-NEAR_BORDER] = False
    touching = mask & border
    if not touching.any() or find_oval(mask, 1) is not None:
        return mask, ""
    wide = max(int(np.ptp(places)) + 1 for places in np.nonzero(touching))
    depth = depth_in(np.pad(mask, 1))[1:-1, 1:-1]
    broad = depth > ARM / 2 * wide
    if not broad.any():
        return mask, ""
    parts, _ = ndimage.label(mask & (depth_in(~broad) > ARM / 2 * wide))
    arms = [n for n in np.unique(parts[touching]) if n and (parts == n).sum() > wide * wide / 2]
    if not arms:
        return mask, ""
    return largest_component(mask & ~np.isin(parts, arms)), _ARM


def _look_within(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> _Within | None:
    """What stands out within a thing (H, W) from the colours along its own edge; None if nothing does."""
    if not mask.any():
        return None
    across = max(np.ptp(places) + 1 for places in np.nonzero(mask))
    region = ndimage.binary_erosion(mask, iterations=max(3, round(RIM * across)), border_value=1)
    if not region.any():
        return None
    rows, columns = np.nonzero(region)
    # With a margin, as any picture has, to learn the ground from.
    box = tuple(slice(max(a.min() - across // 8, 0), a.max() + 1 + across // 8) for a in (rows, columns))
    own, picture = region[box], _alone(rgb, region)[box]
    scale = min(1.0, COMPARED / max(own.shape))
    size = max(16, round(own.shape[1] * scale)), max(16, round(own.shape[0] * scale))
    small = np.asarray(cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_AREA), np.float32)
    own = cv2.resize(own.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    try:
        found = find_mask(small, "") & own
    except InputError:
        return None
    if not found.any():
        return None
    return _Within(region, skin_share(small, found), _shadow(small, found, own), found.sum() / own.sum())


def _is_laid_on(within: _Within) -> bool:
    """Whether what stands out within a thing lies on it, judged by its shadow alone: a shadow falls to one side."""
    return within.shadow > ONE_SIDED and within.share > LAID


def _search(rgb: NDArray[np.float32], region: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(H, W). What stands out from the colours of a region (H, W) within it, None if nothing does."""
    try:
        found = find_mask(_alone(rgb, region), "") & region
    except InputError:
        return None
    return largest_component(found) if found.any() else None


def _shadow(rgb: NDArray[np.float32], found: NDArray[np.bool_], ground: NDArray[np.bool_]) -> float:
    """How one-sided the shadow of a found thing (H, W) is on the ground (H, W), which it dims without changing its
    colour; 0 if there is none. Range [0, 1]."""
    around = light_around(rgb, found, ground, NEAR)
    if around is None or np.percentile(around.lights, SHADOWED) >= SHADE or np.median(around.tints) >= TINT:
        return 0.0
    waves = np.stack([np.ones_like(around.turns), np.cos(around.turns), np.sin(around.turns)], -1)
    left = around.lights - waves @ np.linalg.lstsq(waves, around.lights, rcond=None)[0]
    return float(max(1 - left.var() / max(around.lights.var(), 1e-9), 1e-6))


def _alone(rgb: NDArray[np.float32], region: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, 3). The picture with the nearest colour of a region (H, W) outside it."""
    return rgb[tuple(nearest(region))]
