"""Where the core of a horizontal cut is, and what kind of cut a face shows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.core_line import find_core_line, lean_of
from training.faces.reduced import reduce_face
from training.families import Kind

__all__ = ["CutGuess", "find_core", "guess_cut"]

FILLS_BOX = 0.83
"""Fraction of the smallest box around it that a face fills when it is as likely a slice as not: an ellipse fills 0.785,
apples and pumpkins cut through the core up to 0.82, loaves and pieces of cake 0.82 to 0.93."""

SECTIONS = (2, 3, 4, 5, 6, 8, 10)
"""Numbers of equal sections that a horizontal cut may have: turned by one section, it looks like itself."""

OFF_CENTRE = 6
"""Pixels, of a reduced face's SIDE, by which the middle of its sections may be off the middle of the box around it."""

LESS_ALIKE_SPREAD = 0.2
"""Step in the logarithm of how many times less a face looks like itself turned than mirrored, by which the odds of a
radial cut change by e; at 0 both kinds are equally likely. Of 26 photographs of fruit the horizontal ones have -0.76 to
-0.03, the radial ones 0.09 to 2.1; turned by 20 degrees, -1.05 to 0.03 and 0.01 to 1.9."""

EQUAL_ENDS, ENDS_WEIGHT = 2.2, 0.4
"""Evidence in the rim for the ends of a core line at which both kinds are equally likely, and its weight, low because a
shadow or a stalk beside a horizontal cut gives as much. The 14 horizontal cuts have 0.8 to 2.4, the 12 radial ones 2 to
12; values of 1.5 to 3 and 0.2 to 0.4 tell them apart as well."""


@dataclass(frozen=True)
class CutGuess:
    """What kind of cut a face seems to be."""

    kind: Kind
    sureness: float
    """Probability-like, range [0, 1]: 0.5 where two kinds are equally likely."""


def find_core(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """(x, y) in pixels. Where the core of a horizontal cut is: the centroid of the face.

    Within 3 % of the width of marks by eye on 13 of 14 photographs, and 4 % on the last; 1.4 % in the mean. The point
    about which the inside looks most like itself turned is 1.1 % away from them, within 3 % on the same 13, but it
    moves the other pictures off their own outline by as much. Points where lines converge or rings centre were worse.
    """
    rows, columns = np.nonzero(mask)
    return float(columns.mean()) + 0.5, float(rows.mean()) + 0.5


def guess_cut(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> CutGuess:
    """What kind of cut a face (H, W, 3), (H, W) seems to be, from its outline and its symmetry.

    A slice fills the smallest box around it more than an ellipse does. A horizontal cut, its oval made a circle, looks
    as much like itself turned by one of its sections as mirrored about the likeliest core line; a radial one shows the
    two ends of that line in its rim. The face's orientation in the picture does not count.
    """
    line = find_core_line(rgb, mask)
    upright, upright_mask = (ndimage.rotate(a, lean_of(line.ends), order=1, mode="nearest") for a in (rgb, mask * 1.0))
    rows, columns = np.nonzero(upright_mask > 0.5)
    tall = float(np.sqrt((np.ptp(rows) + 1) / (np.ptp(columns) + 1)))
    small = reduce_face(upright, upright_mask > 0.5, "curved", tall)[0]
    places = np.argwhere(mask).astype(np.float32)
    sides = np.array(cv2.minAreaRect(places)[1]) + 1
    slice_odds = (mask.sum() / sides.prod() - FILLS_BOX) / 0.02
    mirrored = _least_difference(small, small[:, ::-1], (0, OFF_CENTRE))
    turns = [ndimage.rotate(small, 360 / sections, reshape=False, order=1) for sections in SECTIONS]
    turned = min(_least_difference(small, other, (OFF_CENTRE, OFF_CENTRE)) for other in turns)
    less_alike = max(turned, 1e-6) / max(mirrored, 1e-6)
    radial_odds = np.log(less_alike) / LESS_ALIKE_SPREAD
    radial_odds += ENDS_WEIGHT * (line.evidence - EQUAL_ENDS)
    is_slice = 1 / (1 + np.exp(-np.clip(slice_odds, -30, 30)))
    is_radial = (1 - is_slice) / (1 + np.exp(-np.clip(radial_odds, -30, 30)))
    shares: dict[Kind, float] = {"parallel": is_slice, "radial": is_radial, "horizontal": 1 - is_slice - is_radial}
    kind = max(shares, key=lambda name: shares[name])
    return CutGuess(kind, float(shares[kind]))


def _least_difference(a: NDArray[np.float32], b: NDArray[np.float32], reach: tuple[int, int]) -> float:
    """The least sum of squared differences between a (S, S, C) and b (S, S, C) moved by up to `reach` (rows, columns)
    pixels, over the squares of both. The move wraps around, but the margins are empty. Range [0, 2]."""
    spectrum = (np.fft.rfft2(a, axes=(0, 1)) * np.conj(np.fft.rfft2(b, axes=(0, 1)))).sum(-1)
    alike = np.roll(np.fft.irfft2(spectrum, a.shape[:2]), reach, (0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1]
    squares = float(np.square(a).sum() + np.square(b).sum())
    return max(squares - 2 * float(alike.max()), 0.0) / max(squares, 1e-9)
