"""The opacity field of a set of Gaussians on a grid (paper, section 3.1, equation 2)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.scene.gaussians import Gaussians
from engine.scene.grid import Grid
from engine.scene.rotations import rotation_matrices
from engine.threads import for_each

__all__ = ["moments", "opacity_field"]

Float = NDArray[np.float32]

CUTOFF = 3.0
"""Standard deviations at which a Gaussian is cut off."""

MIN_SIGMA = 1e-3
"""Cells. Least sigma: keeps the inverse covariance of a degenerate Gaussian finite."""

BLOCK = 1 << 18
"""Gaussians whose matrices are in memory at once, about 50 MB."""

SLAB = 4
"""Cell layers that one thread sums at a time: few enough to balance the work. No two threads write to the same cell, so
the sums have a fixed order and are bit-equal."""


def opacity_field(gaussians: Gaussians, grid: Grid, widen: float = 0.0) -> Float:
    """(X, Y, Z). d(x) = sum_p opacity_p exp(-1/2 (x - x_p)^T Sigma_p^-1 (x - x_p)), cut off at 3 sigma.

    Axes shorter than `widen` (world units) count as `widen` long at the same opacity. A skin thinner than a cell then
    reaches the cell centres beside it instead of slipping between them, and d on the skin is the sum of the opacities
    along a ray that crosses it.
    """
    return moments(gaussians, grid, widen, np.zeros((len(gaussians), 3), np.float32))[0]


def moments(
    gaussians: Gaussians,
    grid: Grid,
    widen: float,
    normals: Float,  # [N, 3]
) -> tuple[Float, Float]:
    """(X, Y, Z) twice. The opacity field d(x), and sum_p d_p(x) n_p.(x - x_p) / cell, in one pass.

    The second over the first is the mean height of x over the tangent planes of the nearby Gaussians, in cells.
    """
    assert normals.shape == (len(gaussians), 3), normals.shape
    weight = np.zeros(grid.shape, np.float32)
    height = np.zeros(grid.shape, np.float32)
    for first in range(0, len(gaussians), BLOCK):  # one after another, to keep the order of the sums
        rows = slice(first, first + BLOCK)
        _add_moments(weight, height, gaussians[rows], grid, widen, normals[rows])
    return weight, height


def _add_moments(weight: Float, height: Float, gaussians: Gaussians, grid: Grid, widen: float, normals: Float) -> None:
    """Adds some Gaussians to both sums of `moments`."""
    sigma = np.maximum(gaussians.scales / np.float32(grid.cell), np.float32(max(widen / grid.cell, MIN_SIGMA)))
    axes = rotation_matrices(gaussians.quats)
    inverse = np.einsum("nij,nj,nkj->nik", axes, sigma**-2, axes)
    centres = grid.index(gaussians.means).astype(np.float32)
    reach = CUTOFF * np.sqrt(np.einsum("nij,nj->ni", axes**2, sigma**2))
    low = np.clip(np.ceil(centres - reach), 0, grid.shape).astype(np.int32)
    high = np.clip(np.floor(centres + reach) + 1, 0, grid.shape).astype(np.int32)
    slabs = -(-grid.shape[0] // SLAB)
    for_each(_accumulate, slabs, weight, height, centres, inverse, gaussians.opacities, normals, low, high)


@njit(cache=True, nogil=True)
def _accumulate(
    slab: int,
    weight: Float,  # [X, Y, Z], added to
    height: Float,  # [X, Y, Z], added to
    centres: Float,  # [N, 3] in cells
    inverse: Float,  # [N, 3, 3] inverse covariances, cells^-2
    opacities: Float,  # [N]
    normals: Float,  # [N, 3]
    low: NDArray[np.int32],  # [N, 3] first cell of each Gaussian's box
    high: NDArray[np.int32],  # [N, 3] cell after the last
) -> None:
    """Sums one slab of the grid; visits all Gaussians in order."""
    limit = np.float32(CUTOFF * CUTOFF)
    half = np.float32(-0.5)
    zero = np.float32(0)
    first, end = slab * SLAB, min((slab + 1) * SLAB, weight.shape[0])
    for p in range(len(centres)):
        if low[p, 0] >= end or high[p, 0] <= first:
            continue
        a = inverse[p]
        cx, cy, cz = centres[p, 0], centres[p, 1], centres[p, 2]
        nx, ny, nz = normals[p, 0], normals[p, 1], normals[p, 2]
        for i in range(max(low[p, 0], first), min(high[p, 0], end)):
            dx = np.float32(i) - cx
            for j in range(low[p, 1], high[p, 1]):
                dy = np.float32(j) - cy
                # Along z the distance is the parabola a22 dz^2 + 2 b dz + c; only its part under the limit is
                # visited, so a large flat Gaussian costs the cells it covers, not its bounding box.
                b = a[0, 2] * dx + a[1, 2] * dy
                c = a[0, 0] * dx * dx + a[1, 1] * dy * dy + np.float32(2) * a[0, 1] * dx * dy
                root = b * b - a[2, 2] * (c - limit)
                if root <= zero:
                    continue
                spread = math.sqrt(root) / a[2, 2]
                middle = cz - b / a[2, 2]
                start = max(low[p, 2], np.int32(math.ceil(middle - spread)))
                stop = min(high[p, 2], np.int32(math.floor(middle + spread)) + 1)
                for k in range(start, stop):
                    dz = np.float32(k) - cz
                    d = opacities[p] * math.exp(half * (c + dz * (np.float32(2) * b + a[2, 2] * dz)))
                    weight[i, j, k] += d
                    height[i, j, k] += d * (nx * dx + ny * dy + nz * dz)
