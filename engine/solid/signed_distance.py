"""Signed depth below the skin to a fraction of a cell, from the inside cells and the Gaussians along their border."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.gaussians import Gaussians
from engine.scene.grid import Grid
from engine.scene.rotations import rotation_matrices
from engine.solid.distance_transform import nearest
from engine.solid.opacity_field import moments
from engine.threads import for_spans

__all__ = ["redistance", "signed_depth"]

Float = NDArray[np.float32]

SMOOTHING = 1.5
"""Cells. Sigma of the smoothing of the inside's indicator, whose gradient orients the skin."""

MIN_SLOPE = 0.08
"""Per cell. Least gradient of the smoothed indicator at a Gaussian of the skin. A flat skin has 0.27 on it and 0.08 at
2.3 cells from it; a sheet with the same on both sides (a mat, debris inside) has 0."""

WIDEN = 0.75
"""Cells. Least sigma of a Gaussian in the mean of the tangent planes, so that it reaches cells on both sides."""

SHIFT = 1.5
"""Cells. The tangent planes move the skin by at most this."""

BAND = 2.0
"""Cells. Within this distance of the skin the tangent planes decide the depth; beyond it, the distance to the skin."""


def signed_depth(
    inside: NDArray[np.bool_],  # [X, Y, Z]
    gaussians: Gaussians,
    grid: Grid,
) -> Float:
    """(X, Y, Z). Distance to the skin in world units, positive inside. Infinite if no cell or every cell is inside.

    Near the skin it is the mean height over the tangent planes of the nearby Gaussians, weighted by their density
    (implicit moving least squares, Kolluri 2008). Caps have no Gaussians; there it is the distance to the smoothed
    cells.
    """
    coarse = _coarse_distance(inside)
    skin, normals = _oriented_surface(inside, gaussians, grid)
    weight, height = moments(skin, grid, WIDEN * grid.cell, normals)
    covered = weight > 1e-4
    planes = np.where(covered, -height / np.where(covered, weight, 1), coarse)
    confidence = np.clip(weight / 0.05, 0, 1)  # where the planes fade out, the smoothed cells take over
    # Tangent planes extend beyond corners: they may shift the skin, but not create another one.
    planes = np.clip(planes, coarse - SHIFT, coarse + SHIFT)
    level = np.where(np.abs(coarse) <= BAND + 1, confidence * planes + (1 - confidence) * coarse, coarse)
    return redistance(level.astype(np.float32)) * np.float32(grid.cell)


def _coarse_distance(inside: NDArray[np.bool_]) -> Float:
    """(X, Y, Z). Signed distance in cells to the faces between inside and outside, smoothed by one cell."""
    depth = nearest(~inside)[0] - np.float32(0.5)
    height = nearest(inside)[0] - np.float32(0.5)
    return ndimage.gaussian_filter(np.where(inside, depth, -height), 1.0)


def _oriented_surface(inside: NDArray[np.bool_], gaussians: Gaussians, grid: Grid) -> tuple[Gaussians, Float]:
    """The Gaussians that make up the skin, and their outward unit normals (N, 3).

    The normal is the thinnest axis, turned outwards. A Gaussian without a thin axis, or lying across the skin, takes
    the direction in which the smoothed inside falls off.
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
    axes = rotation_matrices(skin.quats)
    order = np.argsort(skin.scales, axis=1)
    rows = np.arange(len(skin))
    thin = axes[rows, :, order[:, 0]]
    along = np.einsum("ni,ni->n", thin, outward)
    flat = skin.scales[rows, order[:, 0]] < 0.5 * skin.scales[rows, order[:, 1]]
    use = flat & (np.abs(along) > 0.5)
    normals = np.where(use[:, None], thin * np.sign(along)[:, None], outward).astype(np.float32)
    # The thicker a Gaussian, the less it says about where the skin lies.
    thickness = np.sqrt(np.einsum("nij,ni,nj->n", axes**2, normals**2, skin.scales**2)) / grid.cell
    opacities = (skin.opacities / (1 + thickness**2)).astype(np.float32)
    return Gaussians(skin.means, skin.scales, skin.quats, opacities, skin.sh), normals


def redistance(level: Float) -> Float:
    """(X, Y, Z). The distance in cells to the zero surface of `level`, with its sign (level set redistancing)."""
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
        before, owner, far = owner, np.empty_like(owner), np.empty(owner.shape, np.float32)
        for_spans(_jump_flood, len(owner), feet, before, step, owner, far, span=1)
    share = np.clip(far - BAND, 0, 1)
    clamped = np.minimum(np.abs(level), far + 1)
    return np.where(inside, 1, -1).astype(np.float32) * (clamped * (1 - share) + far * share)


STAR = ((0, 0, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


@njit(cache=True, nogil=True)
def _jump_flood(
    start: int,
    stop: int,
    feet: Float,  # [F, 3] points of the skin, in cells
    owner: NDArray[np.int32],  # [X, Y, Z] a foot near each cell
    step: int,
    best: NDArray[np.int32],  # [X, Y, Z], filled
    distance: Float,  # [X, Y, Z], filled
) -> None:
    """Fills in, for each cell, the nearest of its foot and those of its six neighbours at `step`, and the distance to
    it: one pass of jump flooding (Rong and Tan 2006)."""
    nx, ny, nz = owner.shape
    for i in range(start, stop):
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
