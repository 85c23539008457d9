"""The first guess of an inside: the picture across the axis drawn out along it, corrected by what others know of height.

Noise as a start loses membranes and seeds (DESIGN 5.1, step 3).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.exemplar.frames import Sheet, Space

__all__ = ["SLABS", "extruded", "height_correction", "revolved", "rind_depth"]

SLABS = (np.inf, 0.3, 0.2, 0.14, 0.1, 0.07)
"""Thicknesses of slabs to choose from, in radii."""


def rind_depth(sheet: Sheet) -> float:
    """Depth, over the body's inradius, at which the layers along the skin end.

    The first depth from which the median colour holds for a while.
    """
    step = 0.02
    bands = [sheet.rgb[(sheet.depth > step * i) & (sheet.depth <= step * (i + 1))] for i in range(25)]
    medians = np.array([np.median(b, axis=0) if len(b) else np.full(3, np.nan) for b in bands])
    for i in range(1, 18):
        gap = np.linalg.norm(medians[i : i + 6] - medians[i], axis=1)
        if np.nanmax(gap) < 0.08:
            return step * (i + 0.5)
    return 0.15


def extruded(
    space: Space,
    sheets: list[Sheet],
    rind: float,
    slab: float,
    rng: np.random.Generator,
    rows: NDArray[np.intp] | slice = slice(None),
) -> NDArray[np.float32]:
    """(N, 3). The horizontal picture at every height, in slabs of `slab` cells that are turned at random.

    Near the skin a voxel reads the picture at its own depth, deeper at its own share of the slice's radius. With
    several pictures the slabs take turns; without slabs the first is taken.
    """
    p = space.planar[rows]
    angle = np.arctan2(p[:, 1], p[:, 0])
    which = np.zeros(len(p), int)
    if np.isfinite(slab):
        level = np.floor((p[:, 2] - space.planar[:, 2].min()) / slab).astype(int)
        turns = rng.uniform(0, 2 * np.pi, level.max() + 1)
        angle = angle + turns[level]
        which = rng.permutation(level.max() + 1)[level] % len(sheets)
    share = np.minimum(space.radius[rows] / space.rim[rows], 1)
    depth = space.depth[rows]
    out = np.empty((len(p), 3), np.float32)
    for n, sheet in enumerate(sheets):
        mine = which == n
        a = angle[mine]
        rim = sheet.rim(a)
        by_depth = np.clip(1 - depth[mine] * space.inradius / rim, 0, 1)
        near = _near_skin(depth[mine], rind)
        r = (near * by_depth + (1 - near) * share[mine]) * rim
        out[mine] = sheet.read(sheet.middle[0] + r * np.cos(a), sheet.middle[1] - r * np.sin(a))
    return out


def _near_skin(depth: NDArray[np.float32], rind: float) -> NDArray[np.float32]:
    """1 in the rind, falling to 0 over as much again and a little."""
    t = np.clip((depth - 1.1 * rind) / (0.7 * rind + 0.1), 0, 1)
    return 1 - t * t * (3 - 2 * t)


def radial_place(space: Space, sheet: Sheet, rind: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(N,), (N,). Where each voxel lies in the right half of a radial picture: from its middle to the right and up, cells.

    Places correspond by direction and share of the way to the edge, and near the skin by depth.
    """
    widest = float(space.rim.max())
    across, up = space.radius / widest, space.height
    angle = np.arctan2(up * sheet.half[1], across * sheet.half[0])
    rim = sheet.rim(angle)
    length = np.hypot(across * sheet.half[0], up * sheet.half[1])
    by_depth = np.maximum(rim - space.depth * space.inradius, 0)
    # Bodies and pictures whose outlines agree need no stretching; those that do not take the skin from the depth.
    near = _near_skin(space.depth, rind)
    r = np.minimum(near * by_depth + (1 - near) * length, rim)
    return r * np.cos(angle), r * np.sin(angle)


def revolved(space: Space, sheet: Sheet, rind: float) -> NDArray[np.float32]:
    """(N, 3). The right half of a radial picture turned about the axis."""
    x, up = radial_place(space, sheet, rind)
    return sheet.read(sheet.middle[0] + x, sheet.middle[1] - up)


def height_correction(space: Space, sheets: list[Sheet], rind: float) -> NDArray[np.float32]:
    """(N, 3). What radial pictures know about height: colours to add.

    The halves of all pictures are looks at the same (radius, height) map. What they agree on is the map (Wiener's
    weight), what they do not is chance. Its median over the heights is taken off: the extrusion knows that already.
    """
    halves = []
    n = 128
    t, h = np.meshgrid((np.arange(n // 2) + 0.5) / (n // 2), np.linspace(-1, 1, n), indexing="ij")
    for sheet in sheets:
        for side in (1, -1):
            x, y = sheet.middle[0] + side * t * sheet.half[0], sheet.middle[1] - h * sheet.half[1]
            halves.append(sheet.read(x, y))
    looks = np.stack(halves)
    mean = ndimage.gaussian_filter(looks.mean(0), (1.0, 0.7, 0))
    chance = ndimage.gaussian_filter(looks.var(0, ddof=1).sum(-1), 2.0) / len(looks)
    change = mean - np.median(mean, axis=1, keepdims=True)
    power = ndimage.gaussian_filter((change**2).sum(-1), 2.0)
    weight = np.clip(1 - 2 * chance / np.maximum(power, 1e-6), 0, 1)[..., None]
    change = change * weight
    widest = float(space.rim.max())
    at = np.stack([space.radius / widest * (n // 2) - 0.5, (space.height + 1) / 2 * (n - 1)])
    out = np.stack([ndimage.map_coordinates(change[..., c], at, order=1, mode="nearest") for c in range(3)], -1)
    # The rind follows the skin, not the height.
    return (out * (1 - _near_skin(space.depth, rind))[:, None]).astype(np.float32)
