"""Moves scenes far from zero, as in map coordinates, to where float32 resolves them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["Vector", "origin_for"]

Vector = tuple[float, float, float]

FINE = 32
"""Least number of float32 steps in the size of a detail: positions are then off by at most 1/64 of it, which changes no
colour visibly. A scene ten times as far from zero as it is wide has thousands."""

FAR = 8.0
"""Distance from zero, in widths of the scene, at which moving it pays: it gains three bits per coordinate."""

FARTHEST = 1e11
"""World units from zero beyond which positions are meaningless: the earth's girth is 4e10 millimetres."""


def origin_for(path: Path, points: NDArray[np.floating], detail: float) -> tuple[Vector, list[str]]:
    """The offset to subtract from all positions before they become float32, and a line for the user if it is not 0.

    `points` (N, 3) are finite and in the file's precision; `detail` is the size of the smallest relevant detail, both
    in world units. The offset is a round number that a person can write down. A second line warns if the file's own
    precision is too coarse.
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
