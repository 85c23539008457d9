"""How a thing dims what it lies on: a shadow takes light away, leaves the colour, and falls to one side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.solid.distance_transform import depth_in

__all__ = ["SECTORS", "SHADE", "LightAround", "light_around", "sectors_of"]

SECTORS = 36
"""Sectors of an outline that are looked at one by one: a tenth of a radian averages enough noise."""

SHADE = 0.92
"""Largest fraction of its light that the ground keeps in a shadow. Under soft light plates keep 0.79 to 0.9."""

END = 0.2
"""How far a thing's shadow reaches at most, as a fraction of its diameter; where the ground is narrower, its outer half
stands for what the shadow does not reach."""

DARKEST = 0.1
"""Brightest channel of a ground that is too dark to show a shadow."""


@dataclass(frozen=True)
class LightAround:
    """What is left of the light, and how the colour changes, on the ground in the directions around a thing."""

    turns: NDArray[np.float64]
    """(N,). Directions in radians of the sectors in which ground is seen."""
    lights: NDArray[np.float64]
    """(N,). The fraction that is left of the light farther off."""
    tints: NDArray[np.float64]
    """(N,). RGB distance from the dimmed colour."""


def light_around(
    rgb: NDArray[np.float32], found: NDArray[np.bool_], ground: NDArray[np.bool_], near: float
) -> LightAround | None:
    """The light on the ground (H, W) of a picture (H, W, 3) beside a thing (H, W), up to `near` of its diameter away;
    None if too little ground is seen, or only black ground."""
    across = np.sqrt(4 / np.pi * found.sum())
    away = depth_in(~found)
    room = away[ground & (away > 2)]
    if not len(room):
        return None
    end = min(END * across, float(np.median(room)))
    far, beside = ground & (away > end), ground & (away > 2) & (away < min(near * across + 2, end))
    if not beside.any() or not far.any() or rgb[far].mean(0).max() < DARKEST:
        return None
    y, x = np.indices(found.shape) / max(found.shape)
    basis = np.stack([np.ones_like(x), x, y], -1)  # light from one side
    lit = basis[beside] @ np.linalg.lstsq(basis[far], rgb[far], rcond=None)[0]
    colours = rgb[beside]
    light = (colours * lit).sum(-1) / ((lit * lit).sum(-1) + 1e-3)
    tint = np.linalg.norm(colours - light[..., None] * lit, axis=-1)
    sector = sectors_of(found, np.nonzero(beside))
    count = np.bincount(sector, minlength=SECTORS)
    seen = count > 2
    if not seen.any():
        return None
    lights, tints = (np.bincount(sector, a, SECTORS)[seen] / count[seen] for a in (light, tint))
    return LightAround(np.flatnonzero(seen) / SECTORS * 2 * np.pi, lights, tints)


def sectors_of(mask: NDArray[np.bool_], at: tuple[NDArray, ...]) -> NDArray[np.int64]:
    """(N,). Which of SECTORS equal angles about the middle of a mask (H, W) each place (rows, columns) lies in."""
    y, x = (place - middle.mean() for place, middle in zip(at, np.nonzero(mask), strict=True))
    return (np.arctan2(y, x) / (2 * np.pi) % 1 * SECTORS).astype(int) % SECTORS
