"""Tells whether layers can go on through pictures: whether a horizontal and a radial one can show one thing in one
light, as they agree where they meet; and whether all that a radial one shows runs along the axis."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.priors.exemplar.pictures import Picture
from training.priors.exemplar.quilting.disc import Disc
from training.priors.exemplar.sampling import blurred

__all__ = ["disagreement", "runs_upwards", "show_one_thing"]

MOST_DISAGREEMENT = 0.295
"""Largest disagreement of two pictures of one thing. Four solids of our own have 0.10 to 0.28 with three seeds each,
pictures of two others of their kinds in other light 0.31 (pomegranates) to 0.84, eight pairs of photographs of two
fruits 0.49 to 1.3. Differences of colour alone do not tell: two pale apples differ less than two cuts of one
pomegranate."""

SAMPLES, EDGE = 96, 0.97
"""Points along a radius, and the share of it that is compared: the rim may be half background."""

TURNS = 240
"""Directions of the radial picture's plane that are tried; it is not known."""

HEIGHTS = np.linspace(-0.5, 0.5, 51)
"""Heights of the horizontal picture's plane that are tried."""

DETAILS = 0.008, 0.1
"""Standard deviations of two blurs, over the radius of a disc as large as the face, between which lie the details that
may be lines."""

WITHIN, NEARBY = 0.18, 0.1
"""Depth from which a face is looked at, as a rind runs along its rim, and standard deviation of the neighbourhoods in
which that is done, both over that radius."""

UPRIGHT, EVERYWHERE = 0.7, 0.25
"""Least share across the axis of the squared slope of details that run along it, and the quantile of neighbourhoods
that have it: a core runs along the axis as well. Twelve photographs of fruit have 0.32 to 0.51 there, drawn wood 0.98
and, as wavy and leaning as wood with knots, 0.81."""


def show_one_thing(horizontal: Sequence[Disc], radial: Sequence[Disc]) -> bool:
    """Whether every horizontal picture agrees with every radial one; at least one of each."""
    return all(disagreement(h, r) <= MOST_DISAGREEMENT for h, r in product(horizontal, radial))


def disagreement(horizontal: Disc, radial: Disc) -> float:
    """RMS RGB distance of the two pictures along the line where they meet, over their RMS contrast along it.

    Taken at the height and angle that suit best; 0 for equal pictures, sqrt(2) for two with only their mean in common.
    """
    radius = (np.arange(SAMPLES) + 0.5) / SAMPLES * EDGE
    angle = np.arange(TURNS) / TURNS * 2 * np.pi
    half = horizontal.read(radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle))
    lines = _smooth(np.concatenate([half, np.roll(half, -TURNS // 2, axis=1)]))
    distance, contrast = np.inf, 1.0
    for height in HEIGHTS:
        across = radius * np.sqrt(1 - height * height)
        level = np.full(SAMPLES, height)
        row = _smooth(np.concatenate([radial.read(across, level), radial.read(-across, level)]))
        distances = np.square(lines - row[:, None]).sum(-1).mean(0)
        nearest = int(distances.argmin())
        if distances[nearest] < distance:
            distance = float(distances[nearest])
            contrast = float(np.mean([line.var(0).sum() for line in (row, lines[:, nearest])]))
    return float(np.sqrt(distance / max(contrast, 1e-6)))


def runs_upwards(picture: Picture) -> bool:
    """Whether all that a radial picture shows runs along the axis, as the grain of wood does: the layers of a
    horizontal one go on through the object, whatever individual it shows."""
    radius = np.sqrt(picture.mask.sum() / np.pi)
    fine, coarse = (blurred(picture.rgb, sigma * radius) for sigma in DETAILS)
    inside = depth_in(picture.mask) > WITHIN * radius
    if not inside.any():
        return False  # so slim that there is nothing but a rim
    slopes = (np.square(s).sum(-1) * inside for s in np.gradient(fine - coarse, axis=(0, 1)))
    along, across = (blurred(s, NEARBY * radius)[inside] for s in slopes)
    return bool(np.quantile(across / np.maximum(along + across, 1e-12), EVERYWHERE) > UPRIGHT)


def _smooth(lines: NDArray[np.float32]) -> NDArray[np.float32]:
    """The lines, blurred along their length by the width of a sample: no outline is known to the pixel."""
    return np.asarray(ndimage.gaussian_filter1d(lines, 1.0, axis=0), np.float32)
