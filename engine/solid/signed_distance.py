"""Signed depth under the skin: from which cells are inside to where exactly, between the cells, the skin runs."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.gaussians import Gaussians
from engine.scene.grid import Grid
from engine.scene.rotations import matrices
from engine.solid.distance_transform import nearest
from engine.solid.opacity_field import moments

__all__ = ["signed_depth"]

Float = NDArray[np.float32]

SMOOTHING = 1.5
"""Cells. Sigma at which the inside's indicator is smoothed before its gradient orients the skin."""

MIN_SLOPE = 0.08
"""Per cell. Least gradient of the smoothed indicator at a Gaussian of the skin: a flat skin has 0.27 on it and 0.08
at 2.3 cells; sheets with the same on both sides (a mat, debris inside) have 0."""

WIDEN = 0.75
"""Cells. Least sigma of a Gaussian in the mean of the tangent planes: reaches the cells on both sides of the skin."""

SHIFT = 1.5
"""Cells. Farthest that the tangent planes move the skin."""

BAND = 2.0
"""Cells. Around the skin the tangent planes decide; farther away the distance to it."""


def signed_depth(
    inside: NDArray[np.bool_],  # [X, Y, Z]
    gaussians: Gaussians,
    grid: Grid,
) -> Float:
    """(X, Y, Z). Distance to the skin in world units, positive inside. Infinite if nothing or all is inside.

    Near the skin it is the mean height over the tangent planes of the Gaussians around (weighted by their density, as
    implicit moving least squares do, Kolluri 2008); on caps, where there are none, over the smoothed cells.
    """
    rough = _rough(inside)
    skin, normals = _oriented(inside, gaussians, grid)
    weight, height = moments(skin, grid, WIDEN * grid.cell, normals)
    found = weight > 1e-4
    planes = np.where(found, -height / np.where(found, weight, 1), rough)
    sure = np.clip(weight / 0.05, 0, 1)  # the faint skirts of the last planes fade into the smoothed cells
    # Planes of a corner go on behind it: they may move the skin between cells, not make a new one.
    planes = np.clip(planes, rough - SHIFT, rough + SHIFT)
    level = np.where(np.abs(rough) <= BAND + 1, sure * planes + (1 - sure) * rough, rough)
    return _redistanced(level.astype(np.float32)) * np.float32(grid.cell)


def _rough(inside: NDArray[np.bool_]) -> Float:
    """Signed distance in cells to the faces between inside and outside, smoothed by one cell."""
    depth = nearest(~inside)[0] - np.float32(0.5)
    height = nearest(inside)[0] - np.float32(0.5)
    return ndimage.gaussian_filter(np.where(inside, depth, -height), 1.0)


def _oriented(inside: NDArray[np.bool_], gaussians: Gaussians, grid: Grid) -> tuple[Gaussians, Float]:
    """The Gaussians that make the skin, and their outward unit normals (N, 3).

    The normal is the thin axis, turned outwards; a blob without one, or a Gaussian that lies across the skin, takes
    the direction in which the inside ends.
    """
    smooth = ndimage.gaussian_filter(inside.astype(np.float32), SMOOTHING)
    index = grid.index(gaussians.means).T
    slope = np.stack(
        [
            ndimage.map_coordinates(np.gradient(smooth, axis=a), index, order=1, mode="nearest", output=np.float32)
            for a in range(3)
        ],
        axis=1,
    )
    size = np.linalg.norm(slope, axis=1)
    keep = size >= MIN_SLOPE
    skin, outward = gaussians[keep], -slope[keep] / size[keep, None]
    axes = matrices(skin.quats)
    order = np.argsort(skin.scales, axis=1)
    rows = np.arange(len(skin))
    thin = axes[rows, :, order[:, 0]]
    along = np.einsum("ni,ni->n", thin, outward)
    flat = skin.scales[rows, order[:, 0]] < 0.5 * skin.scales[rows, order[:, 1]]
    use = flat & (np.abs(along) > 0.5)
    normals = np.where(use[:, None], thin * np.sign(along)[:, None], outward).astype(np.float32)
    # A thick Gaussian says less about where the skin runs than a thin one.
    thickness = np.sqrt(np.einsum("nij,ni,nj->n", axes**2, normals**2, skin.scales**2)) / grid.cell
    opacities = (skin.opacities / (1 + thickness**2)).astype(np.float32)
    return Gaussians(skin.means, skin.scales, skin.quats, opacities, skin.sh), normals


def _redistanced(level: Float) -> Float:
    """The same zero surface with the true distance to it everywhere, in cells."""
    inside = level > 0
    if inside.all() or not inside.any():
        return np.where(inside, np.inf, -np.inf).astype(np.float32)
    border = np.flatnonzero(inside ^ ndimage.binary_erosion(inside) | ~inside & ndimage.binary_dilation(inside))
    cells = np.stack(np.unravel_index(border, level.shape), axis=1)
    slope = np.stack([np.gradient(level, axis=a).ravel()[border] for a in range(3)], axis=1)
    feet = (cells - slope * (level.ravel()[border] / np.maximum((slope**2).sum(1), 0.25))[:, None]).astype(np.float32)
    mask = np.zeros(level.size, bool)
    mask[border] = True
    _, index = nearest(mask.reshape(level.shape))
    owner = (np.cumsum(mask, dtype=np.int32) - 1)[index]
    for step in (4, 2, 1):
        owner, far = _nearer(feet, owner, step)
    share = np.clip(far - BAND, 0, 1)
    own = np.minimum(np.abs(level), far + 1)
    return np.where(inside, 1, -1).astype(np.float32) * (own * (1 - share) + far * share)


STAR = ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


@njit(cache=True, parallel=True)
def _nearer(
    feet: Float,  # [F, 3] points of the skin, in cells
    owner: NDArray[np.int32],  # [X, Y, Z] a foot near each cell
    step: int,
) -> tuple[NDArray[np.int32], Float]:
    """The nearest of the feet of a cell and of its six neighbours at `step`, and the distance to it (jump flooding)."""
    nx, ny, nz = owner.shape
    best = np.empty_like(owner)
    distance = np.empty(owner.shape, np.float32)
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                least = np.float32(np.inf)
                for di, dj, dk in STAR:
                    a = min(max(np.int64(i) + step * di, 0), nx - 1)
                    b = min(max(np.int64(j) + step * dj, 0), ny - 1)
                    c = min(max(np.int64(k) + step * dk, 0), nz - 1)
                    f = owner[a, b, c]
                    dx, dy, dz = feet[f, 0] - i, feet[f, 1] - j, feet[f, 2] - k
                    squared = np.float32(dx * dx + dy * dy + dz * dz)
                    if squared < least:
                        least = squared
                        best[i, j, k] = f
                distance[i, j, k] = math.sqrt(least)
    return best, distance
