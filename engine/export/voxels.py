"""A body, or a part of it, in cells: colours, kinds, and how much of each cell is filled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.export.colours import Colours
from engine.scene.grid import Body, Grid
from engine.scene.inside import Kind
from engine.scene.plane import Plane

__all__ = ["MOST_VOXELS", "Voxels", "coarsened", "voxels_of"]

MOST_VOXELS = 1 << 28
"""Most voxels of a grid: 1 GB of colours and kinds."""

BESIDE = 1.0
"""Voxels. The colours continue this far outside the body, so that a reader who interpolates mixes in no black."""

BORDER = 1
"""Empty cells on each side: a reader that draws a surface finds it closed."""


@dataclass(frozen=True)
class Voxels:
    """What is in each cell of a grid."""

    grid: Grid
    rgb: NDArray[np.uint8]
    """(X, Y, Z, 3). sRGB as in the capture; black far outside."""
    kind: NDArray[np.uint8]
    """(X, Y, Z). `Kind` at the cell's centre."""
    share: NDArray[np.float32]
    """(X, Y, Z). Part of the cell that is filled, by the distance of its centre from what bounds it. Range [0, 1]."""


def voxels_of(body: Body, colours: Colours, planes: Sequence[Plane], step: float | None, name: str) -> Voxels:
    """The part of a body that planes keep, in cells of edge `step`, world units; None: as fine as the inside and
    MOST_VOXELS allow.

    Raises InputError, in a line that begins with `name`, if nothing is left, or if `step` gives too many cells.
    """
    low, high = body.bounds()
    extent = high - low
    most = float((extent.prod() / MOST_VOXELS) ** (1 / 3))
    cell = max(colours.detail, 1.05 * most) if step is None else step
    counts = np.ceil(extent / cell) + 2 * BORDER
    if counts.prod() > MOST_VOXELS:
        raise InputError(f"{name}: {counts.prod():.2g} voxels are too many; give an edge of at least {1.05 * most:.3g}")
    grid = Grid.around(np.stack([low, high]), cell, BORDER)
    rgb = np.zeros((*grid.shape, 3), np.uint8)
    kind = np.zeros(grid.shape, np.uint8)
    share = np.zeros(grid.shape, np.float32)
    axes = [grid.origin[i] + (np.arange(grid.shape[i]) + 0.5) * cell for i in range(3)]
    for layer, x in enumerate(axes[0]):  # one at a time: points take ten times the memory of what is kept
        points = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), -1)[0]
        depth = body.at(points)
        for plane in planes:
            depth = np.minimum(depth, -plane.distance(points).astype(np.float32))
        share[layer] = np.clip(depth / cell + 0.5, 0, 1)
        near, within = depth > -BESIDE * cell, depth > 0
        rgb[layer][near] = np.round(255 * colours.within(points[near], cell))
        kind[layer][within] = colours.kinds(points[within])
    if not kind.any():
        raise InputError(f"{name}: nothing to save; no part of the object is there")
    return Voxels(grid, rgb, kind, share)


def coarsened(voxels: Voxels) -> Voxels:
    """The same in cells twice as large: colours are means over the filled part, kinds those of the first filled
    cell."""
    x, y, z = (-(-side // 2) for side in voxels.grid.shape)
    ends = [(0, 2 * half - side) for half, side in zip((x, y, z), voxels.grid.shape, strict=True)]
    share = np.pad(voxels.share, ends).reshape(x, 2, y, 2, z, 2)
    weight = np.maximum(share, 1e-6)[..., None]
    rgb = np.pad(voxels.rgb, [*ends, (0, 0)]).reshape(x, 2, y, 2, z, 2, 3) * weight
    mean = rgb.sum((1, 3, 5)) / weight.sum((1, 3, 5))
    kind = np.pad(voxels.kind, ends).reshape(x, 2, y, 2, z, 2).transpose(0, 2, 4, 1, 3, 5).reshape(x, y, z, 8)
    first = np.take_along_axis(kind, (kind != Kind.OUTSIDE).argmax(-1)[..., None], -1)[..., 0]
    grid = replace(voxels.grid, cell=2 * voxels.grid.cell, shape=(x, y, z))
    return Voxels(grid, np.round(mean).astype(np.uint8), first, share.mean((1, 3, 5)))
