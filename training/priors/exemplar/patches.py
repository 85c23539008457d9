"""Local frames of voxels per family, and the kernels that read and compare patches along them.

A patch is 7x7 samples along two directions. Grid coordinates are in cells with cell centres at integers; picture
coordinates are in cells too, with `OVER` pixels per cell.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["FIXED", "HALF", "OVER", "PATCH", "POLAR", "RADIAL", "frame_at", "posterior", "read_patches"]

HALF = 3
"""Samples to each side of a patch's centre."""

PATCH = (2 * HALF + 1) ** 2 * 3
"""Values in a patch."""

OVER = 2
"""Pixels of a scaled picture per voxel: interpolated samples stay sharp."""

POLAR, RADIAL, FIXED = 0, 1, 2
"""Kinds of frame: (e_r, e_theta), (e_r, up), two fixed axes."""

_F0 = np.float32(0)
_F1 = np.float32(1)


@njit(cache=True, inline="always")
def frame_at(
    kind: int,
    basis: NDArray[np.float32],  # [3, 3] rows e1, e2, up for the round kinds; a, b, normal for a fixed one
    centre: NDArray[np.float32],  # [3] of the body, cells
    x: np.float32,
    y: np.float32,
    z: np.float32,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Directions a and b, (ax, ay, az, bx, by, bz), of a kind of frame at a grid point."""
    if kind == FIXED:
        return basis[0, 0], basis[0, 1], basis[0, 2], basis[1, 0], basis[1, 1], basis[1, 2]
    dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
    p = dx * basis[0, 0] + dy * basis[0, 1] + dz * basis[0, 2]
    q = dx * basis[1, 0] + dy * basis[1, 1] + dz * basis[1, 2]
    r = np.sqrt(p * p + q * q)
    if r > np.float32(1e-3):
        p, q = p / r, q / r
    else:
        p, q = _F1, _F0
    ax = p * basis[0, 0] + q * basis[1, 0]
    ay = p * basis[0, 1] + q * basis[1, 1]
    az = p * basis[0, 2] + q * basis[1, 2]
    if kind == RADIAL:
        return ax, ay, az, basis[2, 0], basis[2, 1], basis[2, 2]
    bx = p * basis[1, 0] - q * basis[0, 0]
    by = p * basis[1, 1] - q * basis[0, 1]
    bz = p * basis[1, 2] - q * basis[0, 2]
    return ax, ay, az, bx, by, bz


@njit(cache=True, nogil=True)
def read_patches(
    start: int,
    stop: int,
    picture: NDArray[np.float32],  # [H, W, 3]
    xy: NDArray[np.float32],  # [M, 2] centres, pixels
    ab: NDArray[np.float32],  # [M, 4] directions a and b, pixels
    out: NDArray[np.float32],  # [M, PATCH]
) -> None:
    """Reads patches at the nearest pixels; interpolation would weaken the noise in them."""
    height, width = picture.shape[0], picture.shape[1]
    for m in range(start, stop):
        n = 0
        for i in range(-HALF, HALF + 1):
            for j in range(-HALF, HALF + 1):
                x = xy[m, 0] + np.float32(i) * ab[m, 0] + np.float32(j) * ab[m, 2]
                y = xy[m, 1] + np.float32(i) * ab[m, 1] + np.float32(j) * ab[m, 3]
                column = min(max(int(np.floor(x + np.float32(0.5))), 0), width - 1)
                row = min(max(int(np.floor(y + np.float32(0.5))), 0), height - 1)
                for c in range(3):
                    out[m, n] = picture[row, column, c]
                    n += 1


@njit(cache=True, nogil=True)
def posterior(
    start: int,
    stop: int,
    queries: NDArray[np.float32],  # [M, D]
    lists: NDArray[np.int64],  # [M] candidate list of each
    starts: NDArray[np.int64],  # [L + 1]
    members: NDArray[np.int32],  # [T] candidates, list after list
    features: NDArray[np.float32],  # [P, D]
    colours: NDArray[np.float32],  # [P, 3]
    sigma: float,
    out: NDArray[np.float32],  # [M, 3]
) -> None:
    """Mean colour of the candidates under the weights exp(-|query - candidate|^2 / 2 sigma^2).

    That is E[x | x + sigma n] for x uniform over the candidates.
    """
    dims = queries.shape[1]
    scale = np.float32(-0.5 / (sigma * sigma))
    for m in range(start, stop):
        start, stop = starts[lists[m]], starts[lists[m] + 1]
        gaps = np.empty(stop - start, np.float32)
        least = np.float32(3e38)
        for c in range(stop - start):
            p = members[start + c]
            gap = _F0
            for k in range(dims):
                d = queries[m, k] - features[p, k]
                gap += d * d
            gaps[c] = gap
            least = min(least, gap)
        total = _F0
        r = _F0
        g = _F0
        b = _F0
        for c in range(stop - start):
            weight = np.exp(scale * (gaps[c] - least))
            if weight > np.float32(1e-6):
                p = members[start + c]
                total += weight
                r += weight * colours[p, 0]
                g += weight * colours[p, 1]
                b += weight * colours[p, 2]
        out[m, 0], out[m, 1], out[m, 2] = r / total, g / total, b / total
