"""Scenes far from zero, as in map coordinates, moved to where float32 holds them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["Vector", "origin_for"]

Vector = tuple[float, float, float]

FINE = 32
"""Steps of float32 that the size of a detail should have: places are then off by at most 1/64 of it, which moves no
colour by more than a screen shows. A scene ten times as far from zero as it is wide has thousands."""

FAR = 8.0
"""Widths of the scene from zero at which moving it begins to gain: three bits of each place."""

FARTHEST = 1e11
"""World units from zero beyond which places mean nothing: the earth's girth in millimetres is less than half of it."""


def origin_for(path: Path, points: NDArray[np.floating], detail: float) -> tuple[Vector, list[str]]:
    """What to take off all places of a scene before they become float32, and a line for the user where that is not 0.

    `points` (N, 3) are finite, in the precision they came in; `detail` is the size of the smallest thing that matters,
    both in world units. The offset is round, so that a person can write it down, and the same for the same points. A
    second line says where the points' own precision was too coarse before.
    """
    zero = (0.0, 0.0, 0.0)
    if not len(points) or not detail > 0:
        return zero, []
    with np.errstate(over="ignore", invalid="ignore"):  # files may hold anything
        centre = np.median(points, axis=0).astype(np.float64)
        width = float(np.median(np.abs(points - centre).max(axis=1)))
    distance = float(np.abs(centre).max())
    if not FAR * width < distance <= FARTHEST:  # true for NaN
        return zero, []
    step = float(np.spacing(np.float32(distance)))
    if step * FINE <= detail:
        return zero, []
    unit = 10.0 ** math.floor(math.log10(max(width, detail)))
    x, y, z = (float(round(c / unit) * unit) if abs(c) > FAR * width else 0.0 for c in centre)
    offset = ", ".join(f"{-c:.12g}" if c else "0" for c in (x, y, z))
    lines = [f"{path}: moved by ({offset}): that far from zero, places would be rounded to {step:.2g} units"]
    if points.dtype == np.float32 and step > detail:
        lines.append(
            f"{path}: the file itself holds places only to {step:.2g} units, and its details have {detail:.2g}; "
            "export it in double precision, or nearer to zero"
        )
    return (x, y, z), lines
