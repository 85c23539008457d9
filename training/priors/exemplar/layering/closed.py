"""How tall the closed structures of a horizontal picture are: a closed thing is about as tall as it is long.

A chamber, a hollow or a stone that lies in the flesh is closed. A structure that reaches the rind, goes around the axis
or contains it, is long for its width or very large is a wall, a shell, a core or a zone, and runs through.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in

__all__ = ["RUNS_THROUGH", "closed_heights"]

RUNS_THROUGH = 1.0
"""Height in inradii that stands for a structure without an end."""

MAX_ELONGATION = 4.0
"""Largest half length over inscribed half width of a closed structure, as for details."""

MAX_HALF_LENGTH = 0.35
"""Largest half length of a closed structure, in inradii: a zone is longer. The chambers of apples and pears have up to
0.25."""

CORE = 0.06
"""Least radius in inradii of the core along the axis: things that meet only there, as chambers may, are separate."""

ALL_AROUND = 0.7
"""Least share of a circle around the axis that a core covers. With it the arms of four of five photographed stars are
separate; the fifth runs through."""

EDGE = 3
"""Pixels around a structure that belong to its soft edge."""


def closed_heights(
    structure: NDArray[np.float32], flesh: NDArray[np.bool_], middle: tuple[float, float]
) -> NDArray[np.float32]:
    """(H, W). Height over its own plane up to which each pixel of a picture shows a structure, in inradii.

    `structure` (H, W): opacity. `flesh` (H, W): what is under the rind. `middle`: row and column of the axis. A closed
    structure is half an ellipsoid over its inscribed width; its height in the middle is its half length.
    """
    heights = np.full(structure.shape, RUNS_THROUGH, np.float32)
    inradius = float(depth_in(flesh).max())
    row, column = np.ogrid[: structure.shape[0], : structure.shape[1]]
    radius = np.hypot(row - middle[0], column - middle[1])
    solid = (structure > 0.5) & flesh
    ring = np.minimum(radius, inradius).astype(np.int64).ravel()
    covered = np.bincount(ring, solid.ravel()) / np.bincount(ring)
    rings = np.flatnonzero(covered[: int(MAX_HALF_LENGTH * inradius)] > ALL_AROUND)
    core = max(CORE * inradius, float(rings.max(initial=0) + 1))
    solid &= radius > core
    parts, _ = ndimage.label(solid)
    depth = depth_in(solid)
    under_rind = ndimage.binary_erosion(flesh, iterations=EDGE)
    for number, box in enumerate(ndimage.find_objects(parts), start=1):
        own = parts[box] == number
        if not under_rind[box][own].all():
            continue
        rows, columns = np.nonzero(ndimage.binary_fill_holes(own))
        width = float(depth[box][own].max())
        if len(rows) < 5 or radius[box][rows, columns].min() <= 0.5 * core:
            continue
        length = 2 * float(np.sqrt(np.linalg.eigvalsh(np.cov(np.stack([rows, columns])))[1]))
        if length > MAX_ELONGATION * width or length > MAX_HALF_LENGTH * inradius:
            continue
        wide = tuple(slice(max(side.start - EDGE, 0), side.stop + EDGE) for side in box)
        near = ndimage.binary_dilation(parts[wide] == number, iterations=EDGE)
        share = np.minimum(depth[wide] / width, 1)
        dome = length / inradius * np.sqrt(1 - (1 - share) ** 2)
        heights[wide][near] = np.minimum(heights[wide][near], dome[near])
    return heights
