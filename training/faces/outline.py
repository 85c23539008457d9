"""Finds the pixels of a cut face in a photograph.

There are four steps, each for what the one before cannot see. The background is learnt from the picture's border, and a
shadow is a dimmed copy of it; what neither explains is a first guess. GrabCut (Rother et al. 2004) then learns the
colours of both sides. Where the outline found so far follows no edge, as in a reflection or in light that shines
through the fruit, the strongest edge near it is taken instead; and what still hangs on one side is cut off (`bulges`).

In front of a wall of bricks or a kitchen the border tells nothing, so guesses are ovals around the picture's middle
(`find_central`).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

from engine.errors import InputError
from engine.solid.distance_transform import depth_in
from engine.threads import side_by_side
from training.faces.background import Background, find_background
from training.faces.bulges import without_bulges
from training.faces.completion import NEAR_BORDER, find_oval
from training.faces.edges import (
    BARE,
    EDGE_GAIN,
    HALF,
    MIXED,
    edge_cost,
    edge_strength,
    largest_component,
    nearest,
    rims_apart,
    skin_share,
)
from training.faces.shadow import SECTORS, SHADE, light_around
from training.faces.side import without_side

__all__ = ["CHANCE", "MIN_CENTRAL", "CutOffError", "find_central", "find_mask", "is_dimmed_around", "solidity", "trace"]

MIN_SHARE = 0.02
"""Least fraction of the picture that a cut face covers; anything smaller is a crumb on an empty table."""

MAX_BORDER_SHARE = 0.25
"""Length of one side of the picture that a face may lie on, as a fraction of its width. A round face with such a chord
lacks 1.6 % of its width, which nobody sees; a stalk or a crumb at the border is narrower still."""

MIN_SOLIDITY = 0.7
"""Least fraction of its convex hull that a cut face fills. The 29 photographs with hand-checked masks fill 0.93 and
more; of a pale face that two sides cut off only the rind is found, an arc that fills less than half."""

MIN_KEPT = 0.5
"""Least fraction of the first guess's convex hull that a face covers. Shadows and reflections enlarge a guess, but are
smaller than what casts them; if a pale face is cut off, the guess is its rind, and the face found a seed."""

RIND, LIT_SIDE = 0.05, 85
"""How near to a face a rind is looked for that may have been taken for its shadow, as a fraction of the face's
diameter; and the percentile of the light around it that stands for the brightest side, which a shadow leaves as bright
as the table: it keeps 0.97 and more of its light in 26 photographs, 0.65 beside a face whose grey crust was left
out."""

UNSURE = 1.5
"""Pixels by which a found outline may be off: a face that lacks no more lacks nothing. For a face W pixels wide that is
a chord of sqrt(4 UNSURE W), which in small pictures is more than MAX_BORDER_SHARE."""

CORE = 0.3
"""Depth, over the greatest, beyond which GrabCut learns no colours. Seeds and stones are as dark as shadows; what
decides is how the face looks near its outline. Rinds and crusts are thinner, so flesh is still learnt."""

SURE = 0.5
"""Depth, over the greatest, beyond which a pixel is certainly the face's: a first guess that is wrong by half its
radius is no guess."""

ENOUGH = 256
"""Least number of pixels along the shorter side of the picture in GrabCut's first run, which learns the colours, while
the second finds the outline; it gets less than twice as many. With these, 29 photographs of 512 pixels overlap with
masks by hand by .9937 on average; with all pixels, by .9938."""

ROUNDS = 3
"""Alternations of GrabCut in each of two runs; its energy hardly falls after the third (Rother et al. 2004, fig. 5)."""

STARTS = 0.3, 0.45, 0.6, 0.75, 0.85, 0.95
"""Ovals around the picture's middle from which a face before a busy background is searched, as fractions of the
picture: what is photographed covers some of the middle and fills a good part of the picture, so one of them is mostly
face and has most of it. A face among others is often cropped tightly, and ovals within its rind lead to its flesh:
the last two reach beyond."""

AGREED = 0.9
"""Intersection over union from which two outlines are of one thing. One that two starts lead to is no accident."""

CENTRAL = 192
"""Most pixels along the shorter side at which they are searched: enough to tell things apart; the outline of the one
that is found is traced in the whole picture."""

MIN_CENTRAL = 0.08
"""Least fraction of the picture that a face before a busy background covers: a third of its side. What is smaller may
be the core of a face that the border cuts off."""

SHARED, BINS = 0.4, 8
"""Greatest intersection of the histograms of colours, with so many bins for each channel, of a face and of what is
around it: a piece of a cloth shares 0.45 with the rest, 29 photographed faces 0.04 with bricks and 0.33 with a
workshop."""

CHANCE = 1.5 / SECTORS
"""Fraction of the outline by which one of two has more of a skin by chance: one sector."""

COAT = 0.15
"""Least fraction of the outline by which a first guess has a skin where the face that is traced in it has lost one: a
cream cake of 96 to 320 pixels on white loses 0.2 to 0.6, photographed faces at most 0.03."""

REACH = 0.12
"""Depth, over the greatest, by which an outline may move to a stronger edge; a reflection or translucent rim is
narrower. More would reach the far side of a thick rind."""

SEPARATE = 0.1
"""Least RGB distance between face and background at which noise leaves the share of each in a mixed pixel known."""


class CutOffError(InputError):
    """The picture's border cuts off a face, or something beside it reaches there."""


def find_mask(
    rgb: NDArray[np.float32],
    name: object,
    background: Background | None = None,
) -> NDArray[np.bool_]:
    """(H, W). The cut face in a picture (H, W, 3), range [0, 1], in front of a background, which is searched unless it
    is given. Equal pictures give equal masks.

    If one side of the picture cuts a little off a round face, the mask is the part that the picture shows;
    `complete_face` completes it. When two sides did, the rim was often taken for background, and the face came out too
    small. Raises CutOffError, naming the picture `name`, if the border cuts off more; InputError if there is no face.
    """
    cut_off = CutOffError(
        f"{name}: the cut face, or something beside it, reaches the picture's border; take all of it with plain "
        "background around it, or cut it out"
    )
    if background is None:
        background = find_background(rgb)
    if background is None:
        raise cut_off
    behind = background.shaded
    guess, whole = (largest_component(ndimage.binary_opening(~m, iterations=2)) for m in (behind, background.lit))
    if guess.sum() < MIN_KEPT * whole.sum():
        # A shadow is smaller than what casts it: this is a grey face, or a grey picture.
        guess, behind = whole, background.lit
    if guess.mean() < MIN_SHARE:
        raise InputError(f"{name}: no cut face stands out from the background; use a plain background, or cut it out")
    mask = trace(rgb, guess)
    if behind is background.shaded and is_dimmed_around(rgb, mask):
        guess, behind = whole, background.lit
        mask = trace(rgb, guess)
    if mask.mean() < MIN_SHARE:
        raise InputError(f"{name}: no cut face stands out from the background; use a plain background, or cut it out")
    reaching = _joined(mask, ~behind & _like_the_face(rgb, mask))
    # A reflection lies on one side of a face; what reaches two sides is the face.
    second = sorted(_along_sides(_joined(mask, ~behind)))[-2]
    across = max(np.ptp(places) + 1 for places in np.nonzero(mask))
    allowed = max(MAX_BORDER_SHARE * across, (4 * UNSURE * across) ** 0.5)
    crosses = max(_along_border(reaching, background.corners), second) > allowed
    if solidity(mask) < MIN_SOLIDITY or (crosses and find_oval(mask, 1) is None):
        raise cut_off
    if mask.sum() < MIN_KEPT * guess.sum() / solidity(guess):
        raise cut_off
    return mask


def find_central(rgb: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """(H, W). What stands out in the middle of a picture (H, W, 3), range [0, 1], whose border tells nothing of the
    background; None if searches from several ovals around the middle do not agree on anything with a skin, or if that
    goes on around it."""
    scale = min(CENTRAL / min(rgb.shape[:2]), 1)
    height, width = (round(scale * side) for side in rgb.shape[:2])
    small = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.float32)
    rows, columns = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    inner = np.zeros((height, width), bool)
    inner[NEAR_BORDER:-NEAR_BORDER, NEAR_BORDER:-NEAR_BORDER] = True
    if not (inner & (np.hypot(rows, columns) < min(STARTS))).any():
        return None  # a strip of a few pixels

    def search(start: float) -> NDArray[np.bool_]:
        labels = np.where(inner, cv2.GC_PR_BGD, cv2.GC_BGD).astype(np.uint8)
        labels[inner & (np.hypot(rows, columns) < start)] = cv2.GC_PR_FGD
        return trace(small, _cut(small, labels))

    masks = side_by_side(search, STARTS)
    found = [mask for mask in masks if mask.mean() >= MIN_CENTRAL and not (mask & ~inner).any()]
    found = [mask for mask in found if solidity(mask) >= MIN_SOLIDITY]
    agreed = [one for one in found if sum((one & o).sum() > AGREED * (one | o).sum() for o in found) > 1]
    skins = [skin_share(small, one) for one in agreed]
    if max(skins, default=0) < BARE:
        return None
    # Flesh ends at the rind with an edge as strong as the rind's own, but without a skin, unless the rind is so thick
    # that it has a third colour itself. Then its outline is more ragged, as is that of a face with things beside it.
    skinned = [one for one, skin in zip(agreed, skins, strict=True) if skin > max(skins) - CHANCE]
    best = max(skinned, key=solidity)
    mask = trace(rgb, _resized(best, rgb.shape[:2]))
    if mask.mean() < MIN_CENTRAL:
        return None
    # One of its kind that it touches reaches a bit of the border.
    across = max(np.ptp(places) + 1 for places in np.nonzero(mask))
    goes_on = max(_along_sides(_joined(mask, _like_the_face(rgb, mask)))) > MAX_BORDER_SHARE * across
    return None if goes_on or _shared_colours(rgb, mask) > SHARED else mask


def trace(rgb: NDArray[np.float32], guess: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The face, traced from a first guess (H, W)."""
    moved = _move_to_edges(rgb, _grab_cut(rgb, guess))
    mask = _settle_mixed_pixels(rgb, without_side(rgb, without_bulges(rgb, moved)))
    # A coat nearly in the colour of the table, such as cream on white, is nearer to it than to the face.
    rim = guess & ~ndimage.binary_erosion(guess)
    if mask.any() and guess.sum() - mask.sum() > UNSURE * rim.sum():
        left = skin_share(rgb, mask)
        if left < HALF and skin_share(rgb, guess) > max(HALF, left + COAT):
            return guess
    return mask


def is_dimmed_around(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> bool:
    """Whether what is beside a face (H, W) is dark on all sides. A shadow falls to one side; this is a rind or crust
    that has the table's colour."""
    around = light_around(rgb, mask, ~mask, RIND) if mask.any() else None
    if around is None or len(around.lights) < SECTORS / 2:
        return False
    return bool(np.percentile(around.lights, LIT_SIDE) < SHADE)


def solidity(mask: NDArray[np.bool_]) -> float:
    """Fraction of its convex hull that a mask (H, W), not empty, fills. Range (0, 1]."""
    rims = mask & ~ndimage.binary_erosion(mask)
    corners = np.argwhere(rims)[:, None] + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # of pixels, so none is flat
    return float(mask.sum() / ConvexHull(corners.reshape(-1, 2)).volume)


def _grab_cut(rgb: NDArray[np.float32], guess: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The guess, corrected by the colours of either side and by where they change.

    The picture's border is background, whatever it shows, and so are the colours of a reflection that reaches it.
    """
    found, small = guess, _reduced(rgb)
    coarse = len(rgb) // len(small)
    for learns, picture, rim in ((True, small, -(-2 // coarse)), (False, rgb, 2)):
        found = _resized(found, picture.shape[:2])
        border = np.ones(found.shape, bool)
        border[rim:-rim, rim:-rim] = False
        labels = np.where(found, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        labels[border] = cv2.GC_BGD
        depth = _depth(found)
        if not learns:
            labels[depth > SURE * depth.max()] = cv2.GC_FGD
        if (found | (labels == cv2.GC_BGD)).all() or not found.any():
            break
        found = _cut(_nearest(picture, depth <= CORE * depth.max()), labels)
    return _resized(found, guess.shape)


def _cut(rgb: NDArray[np.float32], labels: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(H, W). The face that GrabCut finds in a picture (H, W, 3) from its labels (H, W), which it changes."""
    cv2.setNumThreads(1)  # sums of several threads would differ from run to run
    cv2.setRNGSeed(0)  # GrabCut starts its clusters at random
    cv2.grabCut(
        np.ascontiguousarray(rgb * 255 + 0.5).astype(np.uint8),
        labels,
        (0, 0, 0, 0),  # unused: the labels say where to start
        np.zeros((1, 65)),
        np.zeros((1, 65)),
        ROUNDS,
        cv2.GC_INIT_WITH_MASK,
    )
    face = (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)
    return largest_component(ndimage.binary_opening(face, iterations=2))


def _reduced(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """The picture (H, W, 3) reduced by the largest whole number that leaves ENOUGH pixels along its shorter side."""
    coarse = max(min(rgb.shape[:2]) // ENOUGH, 1)
    height, width = (side // coarse for side in rgb.shape[:2])
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _resized(mask: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W). A mask of another size."""
    if mask.shape == shape:
        return mask
    return np.asarray(cv2.resize(mask.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)) > 0


def _move_to_edges(rgb: NDArray[np.float32], found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The mask with the parts of its outline that follow no edge moved to the strongest one within REACH.

    A watershed (Beucher and Lantuejoul 1979) between what is surely inside and surely outside is the rival outline.
    A part takes the outline that is shorter in the sense of geodesic active contours (Caselles et al. 1997), where a
    pixel counts the less, the stronger its edge is.
    """
    if not found.any():
        return found
    depth, away = _depth(found), depth_in(~found)
    reach = REACH * depth.max()
    strength = edge_strength(rgb)
    markers = np.where(depth > reach, 1, np.where(away > reach, 2, 0)).astype(np.int16)
    border = np.ones(found.shape, bool)
    border[1:-1, 1:-1] = False
    markers[border & ~found] = 2
    levels = (strength / max(float(strength.max()), 1e-6) * 65535).astype(np.uint16)
    rival = ndimage.watershed_ift(levels, markers) == 1
    parts, _ = ndimage.label(rival ^ found)
    width = depth_in(parts > 0)
    cost = edge_cost(strength)
    moved = found.copy()
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        grown = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        part, ours, theirs = parts[grown] == number, found[grown], rival[grown]
        if width[grown][part].max() < MIXED:
            continue  # both lie on one edge
        costs = [cost[grown][rim].sum() for rim in rims_apart(part, ours, theirs)]
        if min(costs) > 0 and costs[0] > EDGE_GAIN * costs[1]:
            moved[grown][part] = theirs[part]
    return largest_component(ndimage.binary_opening(moved, iterations=2))


def _settle_mixed_pixels(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). The mask, with each pixel near its outline put on the side that it shows more of."""
    if not mask.any():
        return mask
    signed = depth_in(mask) - depth_in(~mask)
    smooth = ndimage.gaussian_filter(rgb, (0.7, 0.7, 0))  # less than the lens does, enough for grain
    if not (signed > MIXED).any() or not (signed < -MIXED).any():
        return mask
    face, behind = _nearest(smooth, signed > MIXED), _nearest(smooth, signed < -MIXED)
    contrast = np.square(face - behind).sum(-1)
    share = ((rgb - behind) * (face - behind)).sum(-1) / np.maximum(contrast, 1e-4)
    known = (np.abs(signed) < MIXED) & (contrast > SEPARATE**2)
    settled = ndimage.median_filter(np.where(known, share > 0.5, mask).astype(np.uint8), 5) > 0
    return largest_component(settled)


def _like_the_face(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). Pixels outside the mask with the colour of the face nearby: no edge separates them from it."""
    smooth = ndimage.gaussian_filter(rgb, (1.5, 1.5, 0))
    return np.linalg.norm(smooth - _nearest(smooth, ndimage.binary_erosion(mask, iterations=2)), axis=-1) < SEPARATE


def _shared_colours(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """How much the colours of a face (H, W) are those around it: the intersection of both histograms. Range [0, 1]."""
    bins = np.minimum(rgb * BINS, BINS - 1).astype(int) @ [BINS * BINS, BINS, 1]
    face, around = (np.bincount(bins[there], minlength=BINS**3) / max(there.sum(), 1) for there in (mask, ~mask))
    return float(np.minimum(face, around).sum())


def _joined(mask: NDArray[np.bool_], more: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W). A mask and the parts of `more` that touch it. A streak of wood elsewhere in the face's colour is left
    out, and so is one joined to the mask by a thread of pixels."""
    parts, _ = ndimage.label(mask | ndimage.binary_opening(more, iterations=2))
    return np.isin(parts, np.unique(parts[mask]))


def _depth(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(H, W). Distance of each pixel of a mask from its outside, in pixels; what is beyond the picture is outside."""
    return depth_in(np.pad(mask, 1))[1:-1, 1:-1]


def _nearest(rgb: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W, 3). The picture with every pixel that is not `known` replaced by the nearest one that is."""
    return rgb[tuple(nearest(known))]


def _along_sides(found: NDArray[np.bool_]) -> list[int]:
    """(4). Number of `found` (H, W) pixels on each side of the picture without its corners; clockwise from the top."""
    rims = ndimage.binary_opening(found, iterations=2)  # without the specks of a textured table
    return [int(side.sum()) for side in (rims[2, 2:-2], rims[2:-2, -3], rims[-3, 2:-2], rims[2:-2, 2])]


def _along_border(found: NDArray[np.bool_], plain: NDArray[np.bool_]) -> int:
    """Length in pixels of the longest piece of the picture's border that runs from one `found` pixel (H, W) to another
    past no corner that is background, `plain` (4,).

    Of a pale face that the border cuts off only the rind may stand out: it lies at the two ends of this piece.
    """
    # One pixel in: the outermost ring is taken for background.
    sides = [found[1, 1:-1], found[1:-1, -2], found[-2, -2:0:-1], found[-2:0:-1, 1]]  # clockwise from the top left
    first = int(np.argmax(plain))  # at least one is background
    pieces: list[NDArray[np.bool_]] = []
    for k in range(4):
        side = sides[(first + k) % 4]
        if plain[(first + k) % 4]:
            pieces.append(side)
        else:
            pieces[-1] = np.concatenate([pieces[-1], side])
    return max(int(np.ptp(np.flatnonzero(piece))) + 1 if piece.any() else 0 for piece in pieces)
