"""Tells whether a horizontal and a radial picture can show one thing in one light: whether they agree where they
meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import Disc

__all__ = ["disagreement", "show_one_thing"]

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


def _smooth(lines: NDArray[np.float32]) -> NDArray[np.float32]:
    """The lines, blurred along their length by the width of a sample: no outline is known to the pixel."""
    return np.asarray(ndimage.gaussian_filter1d(lines, 1.0, axis=0), np.float32)
