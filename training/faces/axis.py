"""Where the axis of the thing meets its cut face, and what kind of cut the face is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from training.families import Kind

__all__ = ["CutGuess", "find_axis", "find_core", "guess_cut", "line_ends"]

SIDE = 96
"""Pixels to which a face is reduced: symmetry is a matter of its layout, and finer detail never repeats."""

MAX_LEAN = 30
"""Degrees from upright within which a core line is searched: people hold what they photograph upright."""

MAX_SHIFT = 0.1
"""Of the face's width, how far a core line may be from the middle."""

UPRIGHT = 0.15
"""How much worse a mirror image may be at MAX_LEAN than upright, and at MAX_SHIFT than in the middle, to be taken: in
a round face all lines through its middle are nearly as good."""

STALK = 0.04
"""Of the face's width, half that of what is stalk at the ends of a core line; a crown is wider."""


FILLS_BOX = 0.83
"""Of the box around it, what a face fills that may as well be a slice: an ellipse fills 0.785, apples and pumpkins cut
through the core up to 0.82, loaves and pieces of cake 0.825 to 0.93."""

LESS_ALIKE = 1.25
"""How many times less a face looks like itself turned than mirrored, where a radial cut is as likely as a horizontal
one. Of 26 photographs of fruit, the horizontal ones have 0.8 to 1.15 (one 1.5), the radial ones 1.24 to 29."""


@dataclass(frozen=True)
class CutGuess:
    """What kind of cut a face seems to be."""

    kind: Kind
    sureness: float
    """Probability-like, range [0, 1]: 0.5 where two kinds are equally likely."""


def find_core(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """(x, y) in pixels. Where the core of a horizontal cut is: the centroid of the face.

    Within 3 % of the width of marks by eye on 13 of 14 photographs, and 4 % on the last. Points where lines converge or
    rings centre were worse in oranges and melons, whose membranes are faint beside their rind.
    """
    rows, columns = np.nonzero(mask)
    return float(columns.mean()) + 0.5, float(rows.mean()) + 0.5


def find_axis(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(2, 2). Upper and lower end (x, y), in pixels, of the core line of a radial cut (H, W, 3), (H, W).

    The line by which the face is most like its mirror image; it ends where the face does, stalk left out. Its places
    are within 3 % of the width of marks by eye on 7 of 12 photographs, and within 9 % on all.
    """
    small, middle, scale = _reduced(rgb, mask)
    angles = np.arange(-MAX_LEAN, MAX_LEAN + 1, 1.5)
    shifts = np.arange(-round(MAX_SHIFT * SIDE), round(MAX_SHIFT * SIDE) + 1)  # in half pixels of the line
    best, lean, shift = np.inf, 0.0, 0.0
    for angle in angles:
        turned = ndimage.rotate(small, angle, reshape=False, order=1)
        flipped = turned[:, ::-1]
        for step in shifts * 2:
            moved = np.roll(flipped, step, axis=1)
            cost = float(np.square(turned - moved).sum())
            cost *= 1 + UPRIGHT * ((angle / MAX_LEAN) ** 2 + (step / 2 / (MAX_SHIFT * SIDE)) ** 2)
            if cost < best:
                best, lean, shift = cost, float(angle), step / 2
    # A picture turned by `lean` counter-clockwise has its line upright, `shift` to the right of the middle.
    turn = np.radians(lean)
    along = np.array([-np.sin(turn), np.cos(turn)])
    on_line = middle + scale * shift * np.array([np.cos(turn), np.sin(turn)])
    return line_ends(mask, on_line, along)


def line_ends(mask: NDArray[np.bool_], on_line: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 2). Where a line through a point in a direction enters and leaves the face, its stalk left out."""
    radius = max(1, round(STALK * (np.ptp(np.nonzero(mask)[1]) + 1)))
    steps = np.arange(-max(mask.shape), max(mask.shape) + 1.0)
    points = on_line + steps[:, None] * along
    opened = ndimage.binary_opening(np.pad(mask, 1), _disc(radius))[1:-1, 1:-1]
    for face in (opened, mask):
        inside = ndimage.map_coordinates(face.astype(np.float32), points.T[::-1] - 0.5, order=1) > 0.5
        if inside.any():
            found = np.flatnonzero(inside)
            return points[[found[0], found[-1]]]
    return np.stack([on_line, on_line])


def guess_cut(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> CutGuess:
    """What kind of cut a face (H, W, 3), (H, W) seems to be, from its outline and its symmetry.

    A slice fills the box around it more than an ellipse does. A horizontal cut looks alike when turned about its
    core by any angle, once its oval is made a circle; a radial one only in its mirror.
    """
    rows, columns = np.nonzero(mask)
    small = _reduced(rgb, mask, float(np.sqrt((np.ptp(rows) + 1) / (np.ptp(columns) + 1))))[0]
    box = float(mask.sum()) / ((np.ptp(rows) + 1) * (np.ptp(columns) + 1))
    slice_odds = (box - FILLS_BOX) / 0.02
    mirrored = float(np.square(small - small[:, ::-1]).mean())
    turned = [ndimage.rotate(small, angle, reshape=False, order=1) for angle in (36, 72, 108, 144)]
    worse = float(np.mean([np.square(small - other).mean() for other in turned])) / max(mirrored, 1e-9)
    radial_odds = np.log(max(worse, 1e-6) / LESS_ALIKE) / 0.15
    is_slice = 1 / (1 + np.exp(-np.clip(slice_odds, -30, 30)))
    is_radial = (1 - is_slice) / (1 + np.exp(-np.clip(radial_odds, -30, 30)))
    shares: dict[Kind, float] = {"parallel": is_slice, "radial": is_radial, "horizontal": 1 - is_slice - is_radial}
    kind = max(shares, key=lambda name: shares[name])
    return CutGuess(kind, float(shares[kind]))


def _disc(radius: int) -> NDArray[np.bool_]:
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return x * x + y * y <= radius * radius


def _reduced(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], tall: float = 1.0
) -> tuple[NDArray[np.float32], NDArray[np.float64], float]:
    """(SIDE, SIDE, 4) the face without its mean colour, 0 outside, and its mask with the weight of its contrast; the
    middle (x, y) of the face in pixels; and pixels of the picture in one of these.

    `tall`: how many times wider and lower than it is the face is drawn.
    """
    rows, columns = np.nonzero(mask)
    middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
    side = 1.2 * max(np.ptp(rows) / tall, np.ptp(columns) * tall)  # room to turn in
    half = side / 2 * np.array([1 / tall, tall])
    box = (*(middle - half), *(middle + half))
    contrast = float(rgb[mask].std(axis=0).mean())
    layers = [np.where(mask, rgb[..., c] - rgb[mask][:, c].mean(), 0) for c in range(3)]
    layers.append(np.where(mask, 2 * contrast, 0))
    channels = [
        Image.fromarray(np.ascontiguousarray(layer, np.float32)).transform(
            (SIDE * 4, SIDE * 4), Image.Transform.EXTENT, box, Image.Resampling.BILINEAR
        )
        for layer in layers
    ]
    small = [np.asarray(c.resize((SIDE, SIDE), Image.Resampling.BOX)) for c in channels]
    return np.stack(small, -1), middle, side / SIDE
