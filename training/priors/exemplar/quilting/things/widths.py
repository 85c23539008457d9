"""How wide radial pictures show a core at every height."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import DISC_PIXELS, PIXEL, Disc, disc_grid, disc_radius
from training.priors.exemplar.quilting.things.core import SMOOTH, stands_out

__all__ = ["MOST", "shown_along", "widths_along"]

MOST = 1.5
"""Largest width over that at the height of the horizontal picture, and largest distance from the axis over that in this
picture: what is wider is joined to the core, such as a membrane."""


def widths_along(along: Sequence[Disc], reach: float, height: float) -> NDArray[np.float64]:
    """(P,). Mean width in pixels, at the heights of a disc's pixels, at which radial faces of even tones show a core
    that reaches out to this radius at this height."""
    wide = np.mean([shown_along(one, reach, height).sum(0) for one in along], axis=0)
    return np.asarray(ndimage.gaussian_filter1d(wide, SMOOTH / PIXEL))


def shown_along(disc: Disc, reach: float, height: float) -> NDArray[np.bool_]:
    """(P, P). What stands out in a radial face around the axis, as far out as it may reach, in one piece: a shell
    around it that stands out as well is another."""
    near = np.abs(disc_grid()[0]) < MOST * reach
    parts, _ = ndimage.label(stands_out(disc, reach, height) & near & (disc_radius() < 1))
    middle = slice(DISC_PIXELS // 2 - 1, DISC_PIXELS // 2 + 1)
    sizes = np.bincount(parts[middle].ravel(), minlength=2)
    sizes[0] = 0
    if not sizes.any():
        return np.zeros(parts.shape, np.bool_)
    return np.asarray(ndimage.binary_fill_holes(parts == sizes.argmax()))
