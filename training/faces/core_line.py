"""The core line of a radial cut: where the axis of the thing lies in its face.

There are two kinds of evidence, each of which fails on its own. The face looks like its mirror image about the line,
but fruit grow lopsided. And where the axis leaves the face, the rim is unlike the rim elsewhere: there is a stalk, a
crown, a dent, a thicker rind, the end of a membrane; the outline alone shows the foot of a stalk or crown. Both are
added as log odds to what is expected of any picture; the result is the mean over all lines, weighted by their odds, so
that it is the upright middle if nothing tells more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.faces.reduced import SIDE, contrast_layers, reduce_face

__all__ = ["CoreLine", "find_core_line", "lean_of", "line_ends"]

MAX_LEAN, MAX_SHIFT = 30, 0.1
"""Largest lean and shift of the core lines that are searched: in degrees from upright, and from the middle as a
fraction of the face's width. People hold what they photograph upright."""

LEAN, SHIFT = 12.0, 0.04
"""Standard deviations of both in photographs. 11 of 12 lines marked by eye lean less than 4.5 degrees, one 10; eight
are within 2 % of the middle, the others within 7 %."""

SYMMETRY = 4.0
"""Power of the likeness of a face and its mirror image in the odds of a line. If all 9216 pixels were independent, it
would be half their number; but the differences in fruit are large and few."""

ENDS = 5.0
"""Power, in the same odds, of how much more the rim shows at the ends than elsewhere. By the rim and without outgrowths
SYMMETRY 2 to 5 and ENDS 3 to 6 give 8 to 10 of 12 lines within 3 % of marks by eye, about as many in altered copies,
and 7 of 8 in solids of our own; symmetry alone gives 7 of the 12. The striped rind of a melon, alike all around, leans
by 4 to 5 degrees by chance."""

ELSEWHERE = 90
"""Percentile of the rim's evidence beside the ends that counts as elsewhere: a striped rim changes everywhere."""

LEAST = 0.3
"""Least evidence that counts, as a fraction of the rim's median change: in a rim of plain noise no change is alike on
both sides of any place."""

STALK = 0.04
"""Half the width of a stalk at the ends of a core line, as a fraction of the face's width; a crown is wider."""

CROWN = 0.2
"""Radius, as a fraction of the face's width, below which what sticks out, or in, is no part of the body's own
outline."""

UNEVEN = 0.01
"""How far the outline of a body sticks out without a stalk or crown, as a fraction of the face's width: in horizontal
cuts of 13 photographs 0.004 to 0.007, in one with skin torn at its edge 0.014. Stalks reach 0.05 to 0.1, crowns 0.15 to
0.25."""

FOOT = 0.02
"""Standard deviation of the middle of an outgrowth's foot from the axis, as a fraction of the face's width."""

RAYS = 720
"""Directions in which the rim is sampled."""

OUTSIDE, INSIDE, LAYERS = 0.04, 0.14, 36
"""How far outside and inside of the body's outline the rim is looked at, as fractions of the face's width, and in how
many layers: stalks and crowns are outside; rind, dents and the ends of a core inside."""

FINE, WIDE, NEAR = 1.0, 12.0, 8.0
"""Degrees of the rim: changes finer than the first or wider than the second are not of an end; the third is how far
from its middle an end is compared with its mirror image."""

END_SECTOR = 60.0
"""Degrees from upright, seen from the middle, in which an end is searched: MAX_LEAN and MAX_SHIFT of the widest."""


@dataclass(frozen=True)
class CoreLine:
    """A core line and how sure it is."""

    ends: NDArray[np.float64]
    """(2, 2). Upper and lower end (x, y) in pixels, stalk left out."""
    spread: float
    """Standard deviation of the less sure end across the line, pixels. 0.01 to 0.05 of the face's width where the
    picture tells, about 0.1 where it does not."""
    evidence: float
    """Logarithm of how many times more the rim shows at an end than elsewhere, summed over both ends. 2 to 12 in radial
    cuts, 0.8 to 2.4 in others."""


def find_core_line(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> CoreLine:
    """The core line of a radial cut: picture (H, W, 3), range [0, 1], and mask (H, W), not empty.

    Within 3 % of the width of marks by eye on 10 of 12 photographs, and 4.4 % at most.
    """
    small, middle, scale = reduce_face(rgb, mask, "plane")
    leans = np.arange(-MAX_LEAN, MAX_LEAN + 1, 1.5)
    shifts = np.arange(-round(MAX_SHIFT * SIDE), round(MAX_SHIFT * SIDE) + 1)
    unlike = _mirror_costs(small, leans, shifts)
    odds = -SYMMETRY * np.log(np.maximum(unlike / max(float(unlike.min()), 1e-9), 1))
    odds -= 0.5 * ((leans[:, None] / LEAN) ** 2 + (shifts / (SHIFT * SIDE)) ** 2)
    places, evidence = _rim_evidence(rgb, mask)
    feet, heights = _outgrowths(mask)
    # A picture turned by `lean` counter-clockwise has its line upright, `shift` to the right of the middle.
    turns = np.radians(leans)
    across = np.stack([np.cos(turns), np.sin(turns)], -1)
    offsets = (across @ middle)[:, None] + scale * shifts
    from_upright = (np.arange(RAYS) + RAYS // 2) % RAYS - RAYS // 2
    upper = np.flatnonzero(np.abs(from_upright) <= RAYS * END_SECTOR / 360)
    beside = np.abs(np.abs(from_upright) - RAYS // 4) < RAYS * (90 - END_SECTOR) / 360
    evidence = evidence / max(float(np.percentile(evidence[beside], ELSEWHERE)), LEAST)
    off = ((across @ feet.T)[:, None] - offsets[..., None]) / (FOOT * (np.ptp(np.nonzero(mask)[1]) + 1))
    outgrowths = heights * np.exp(-0.5 * np.square(off))
    ends, shown = [], np.zeros_like(odds)
    for sector, above in ((upper, True), ((upper + RAYS // 2) % RAYS, False)):
        away = np.abs((across @ places[sector].T)[:, None] - offsets[..., None])
        hit = sector[away.argmin(-1)]
        own = (feet[:, 1] < places[:, 1].mean()) == above
        shown += np.log1p(evidence[hit] + outgrowths[..., own].sum(-1))
        ends.append(places[hit])
    odds += ENDS * shown
    share = np.exp(odds - odds.max())
    share /= share.sum()
    first, last = ((share[..., None] * end).sum((0, 1)) for end in ends)
    along = (last - first) / max(float(np.linalg.norm(last - first)), 1e-9)
    normal = np.array([along[1], -along[0]])
    variance = max(float((share * np.square((end - first) @ normal)).sum()) for end in ends)
    return CoreLine(line_ends(mask, first, along), variance**0.5, float((share * shown).sum()))


def lean_of(ends: NDArray[np.floating]) -> float:
    """Degrees by which a line from its upper to its lower end, (2, 2) in (x, y), leans to the right."""
    x, y = ends[1] - ends[0]
    return float(np.degrees(np.arctan2(-x, y)))


def line_ends(mask: NDArray[np.bool_], point: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 2). Where the line through a point in the direction `along` enters and leaves the face, stalk left out."""
    radius = max(1, round(STALK * (np.ptp(np.nonzero(mask)[1]) + 1)))
    steps = np.arange(-max(mask.shape), max(mask.shape) + 1.0)
    points = point + steps[:, None] * along
    for face in (_opened(mask, radius), mask):
        inside = ndimage.map_coordinates(face.astype(np.float32), points.T[::-1] - 0.5, order=1) > 0.5
        if inside.any():
            found = np.flatnonzero(inside)
            return points[[found[0], found[-1]]]
    return np.stack([point, point])


def _mirror_costs(small: NDArray[np.float32], leans: NDArray, shifts: NDArray) -> NDArray[np.float64]:
    """(len(leans), len(shifts)). How much a reduced face differs from its mirror image about each line."""
    costs = np.empty((len(leans), len(shifts)))
    width = small.shape[1]
    difference = np.empty_like(small)  # one array for all lines: making anew takes as long as what is done with it
    for i, lean in enumerate(leans):
        turned = ndimage.rotate(small, lean, reshape=False, order=1)
        flipped = np.concatenate([turned[:, ::-1]] * 2, axis=1)
        for j, shift in enumerate(shifts):
            first = -2 * shift % width
            np.subtract(turned, flipped[:, first : first + width], out=difference)
            costs[i, j] = np.square(difference, out=difference).sum()
    return costs


def _rim_evidence(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(RAYS, 2) places (x, y) around the outline of the body, clockwise from the top, and (RAYS,) how many times more
    than elsewhere the rim changes there, counting only changes that are alike on both sides."""
    rows, columns = np.nonzero(mask)
    width = float(np.ptp(columns) + 1)
    body = _opened(mask, CROWN * width)
    if not body.any():  # a slice lower than a crown
        body = mask
    middle = np.array([columns.mean(), rows.mean()]) + 0.5
    angles = np.arange(RAYS) / RAYS * 2 * np.pi
    rays = np.stack([np.sin(angles), -np.cos(angles)], -1)
    reach = np.arange(0, np.hypot(*mask.shape), 0.5)
    at = middle + reach[:, None, None] * rays - 0.5
    smooth = ndimage.gaussian_filter(body.astype(np.float32), 1)
    inside = ndimage.map_coordinates(smooth, np.moveaxis(at, -1, 0)[::-1], order=1) > 0.5
    radius = reach[len(reach) - 1 - np.argmax(inside[::-1], axis=0)]
    step = (OUTSIDE + INSIDE) / LAYERS * width
    depths = (np.arange(LAYERS) + 0.5) * step - OUTSIDE * width
    at = middle + (radius - depths[:, None])[..., None] * rays - 0.5
    layers = ndimage.gaussian_filter(contrast_layers(rgb, mask, "plane"), (*[max(0.5 * step, 0.5)] * 2, 0))
    strip = np.stack([ndimage.map_coordinates(layers[..., c], np.moveaxis(at, -1, 0)[::-1], order=1) for c in range(4)])
    degree = RAYS / 360
    fine, wide = (ndimage.gaussian_filter1d(strip, sigma * degree, mode="wrap") for sigma in (FINE, WIDE))
    changes = fine - wide
    power = ndimage.gaussian_filter1d(np.square(changes).sum(0).mean(0), NEAR / 2 * degree, mode="wrap")
    steps = np.arange(1, round(3 * NEAR * degree) + 1)
    weights = np.exp(-0.5 * (steps / (NEAR * degree)) ** 2)
    weights /= weights.sum()
    alike = np.zeros(RAYS)
    for n, weight in zip(steps, weights, strict=True):
        alike += weight * (np.roll(changes, -n, axis=-1) * np.roll(changes, n, axis=-1)).sum(0).mean(0)
    return middle + radius[:, None] * rays, np.maximum(alike, 0) / max(float(np.median(power)), 1e-9)


def _outgrowths(mask: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, 2) the middles (x, y) of the feet of stalks and crowns, and (N,) how far the outline sticks out there, as a
    multiple of UNEVEN. However bent a stalk or lopsided a crown is, it grows on the axis."""
    width = float(np.ptp(np.nonzero(mask)[1]) + 1)
    body = _opened(mask, CROWN * width)
    feet, heights = [np.zeros((0, 2))], []
    if body.any():
        away, nearest = ndimage.distance_transform_edt(~body, return_indices=True)
        parts, _ = ndimage.label(mask & ~body)
        for number, box in enumerate(ndimage.find_objects(parts), start=1):
            part = parts[box] == number
            height = float(away[box][part].max()) / (UNEVEN * width)
            if height > 1:
                rows, columns = nearest[:, box[0], box[1]][:, part]
                feet.append(np.array([[columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]]) / 2)
                heights.append(height)
    return np.concatenate(feet), np.array(heights)


def _opened(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """(H, W). The part of a mask that is covered by discs of this radius, in pixels, that lie within it."""
    deep = depth_in(np.pad(mask, 1)) > radius
    if not deep.any():
        return np.zeros_like(mask)
    return (depth_in(~deep) <= radius)[1:-1, 1:-1]
