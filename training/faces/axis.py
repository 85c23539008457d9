"""Where the core of a horizontal cut is, and what kind of cut a face shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.faces.reduced import reduce_face
from training.families import Kind

__all__ = ["CutGuess", "find_core", "guess_cut"]

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


def guess_cut(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> CutGuess:
    """What kind of cut a face (H, W, 3), (H, W) seems to be, from its outline and its symmetry.

    A slice fills the box around it more than an ellipse does. A horizontal cut looks alike when turned about its
    core by any angle, once its oval is made a circle; a radial one only in its mirror.
    """
    rows, columns = np.nonzero(mask)
    small = reduce_face(rgb, mask, float(np.sqrt((np.ptp(rows) + 1) / (np.ptp(columns) + 1))))[0]
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
