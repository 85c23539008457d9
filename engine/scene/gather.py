"""Merges the Gaussians of a very large capture into fewer that look nearly the same.

A capture of a few million has a hundred of them per square pitch of a standard solid. Making it solid takes time and
memory for each Gaussian, and cannot tell them apart.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from engine.scene.gaussians import Gaussians
from engine.scene.rotations import rotation_entries
from engine.threads import for_each

__all__ = ["gathered"]

Float = NDArray[np.float32]

SAMPLE = 1 << 17
"""Number of Gaussians sampled to find the object's extent, to a thousandth."""

LATTICE = 1 << 10
"""Most cells along the longest side of the object: a bit for each cell takes 180 MB."""

FEWEST_CELLS = 64
"""Fewest cells along the longest side: cells coarser than those of the smallest body would round its shape."""

ROUNDS = 8
"""Bisection steps on the number of cells, which give the count to 2 %."""

SIZE = 1.5
"""Cells. A Gaussian with an axis longer than this is left as it is: there are few of them. Smaller ones keep their
common shape, because the merged Gaussian has their covariance."""

SMOOTH = 0.45
"""Cells. The Gaussians of a sheet, merged, have a sigma of about 0.29, which would leave a ripple of a third; kernels
this wide, one cell apart, ripple by a few per cent."""

MOST_ALPHA = 0.99
"""Most light that a Gaussian stops, as in the renderer."""

BLOCK = 1 << 14
"""Cells in a task."""


def gathered(gaussians: Gaussians, most: int) -> Gaussians:
    """Gaussians that show the same as a larger capture of more than `most`; the same object if there are no more.

    All small ones in a cell of a lattice become one with their mean, their covariance, the light that they stop
    together, and their mean colour: about `most` of them at most. Large ones, and strays, stay as they are. The merged
    ones come first, in lattice order, then the others in the capture's order. Bit-equal for the same input.
    """
    if len(gaussians) <= most:
        return gaussians
    few = gaussians.means[:: -(-len(gaussians) // SAMPLE)]
    low, high = np.percentile(few, [1, 99], axis=0).astype(np.float64)
    side = float((high - low).max())
    if not side > 0:
        return gaussians
    low, high = low - 0.05 * side, high + 0.05 * side
    cell = _cell_size(gaussians.means, low, high, side, most)
    near = ((gaussians.means >= low) & (gaussians.means < high)).all(1)
    small = np.flatnonzero(near & (gaussians.scales.max(1) < SIZE * cell))
    cells = np.floor((gaussians.means[small] - low) / cell).astype(np.int64)
    key = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
    del cells
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.concatenate([[True], np.diff(key[order]) != 0, [True]])) if len(small) else np.zeros(1)
    rows = small[order]
    alone = np.ones(len(gaussians), bool)
    alone[rows] = False
    groups = _merge(gaussians, rows, starts.astype(np.int64), cell)
    rest = gaussians[alone]
    arrays = (
        np.concatenate([getattr(groups, name), getattr(rest, name)])
        for name in ("means", "scales", "quats", "opacities", "sh")
    )
    return Gaussians(*arrays, origin=gaussians.origin)


def _cell_size(means: Float, low: NDArray[np.float64], high: NDArray[np.float64], side: float, most: int) -> float:
    """Edge of the finest cells, world units, of which the Gaussians occupy no more than `most`."""
    fine, coarse = float(LATTICE), float(FEWEST_CELLS)
    if _occupied(means, low, high, side / fine) <= most:
        return side / fine
    for _ in range(ROUNDS):
        middle = math.sqrt(fine * coarse)
        if _occupied(means, low, high, side / middle) > most:
            fine = middle
        else:
            coarse = middle
    return side / coarse


def _occupied(means: Float, low: NDArray[np.float64], high: NDArray[np.float64], cell: float) -> int:
    """Number of cells between two corners (3,) that hold a centre."""
    shape = np.ceil((high - low) / cell).astype(np.int64) + 1
    bits = np.zeros(-(-int(shape.prod()) // 8), np.uint8)
    return int(_mark(means, low, high, cell, shape, bits))


@njit(cache=True, error_model="numpy", nogil=True)
def _mark(means, low, high, cell, shape, bits):
    """Sets the bit of every cell that holds one of the means (N, 3); returns how many were set."""
    count = 0
    for i in range(len(means)):
        at = 0
        for axis in range(3):
            place = np.float64(means[i, axis])
            if not low[axis] <= place < high[axis]:
                at = -1
                break
            at = at * shape[axis] + np.int64((place - low[axis]) / cell)
        if at >= 0 and not bits[at >> 3] >> (at & 7) & 1:
            bits[at >> 3] |= np.uint8(1 << (at & 7))
            count += 1
    return count


def _merge(gaussians: Gaussians, rows: NDArray[np.intp], starts: NDArray[np.int64], cell: float) -> Gaussians:
    """One Gaussian for each group rows[starts[g]:starts[g + 1]]."""
    count, bands = len(starts) - 1, gaussians.sh.shape[1]
    means, light = np.empty((count, 3), np.float32), np.empty(count, np.float64)
    covariances, sh = np.empty((count, 3, 3), np.float64), np.empty((count, bands, 3), np.float32)
    for_each(
        _sum_groups, -(-count // BLOCK), rows, starts, gaussians.means, gaussians.scales, gaussians.quats,
        gaussians.opacities, gaussians.sh, means, covariances, light, sh,
    )  # fmt: skip
    scales, quats = np.empty((count, 3), np.float32), np.empty((count, 4), np.float32)
    opacities = np.empty(count, np.float32)
    for first in range(0, count, BLOCK):
        part = slice(first, min(first + BLOCK, count))
        variances, axes = np.linalg.eigh(covariances[part])
        sizes = np.sqrt(np.maximum(variances, 1e-12 * variances[:, 2:]))
        wide = np.minimum(SMOOTH / 0.29 * sizes, np.maximum(sizes, SMOOTH * cell))
        several = np.diff(starts[first : part.stop + 1]) > 1
        sizes[several, 1:] = wide[several, 1:]
        axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
        scales[part], quats[part] = sizes, Rotation.from_matrix(axes).as_quat(scalar_first=True)
        opacities[part] = -np.expm1(-light[part] / (sizes[:, 1] * sizes[:, 2]))
    return Gaussians(means, scales, quats, np.minimum(opacities, np.float32(MOST_ALPHA)), sh)


_rotation = njit(cache=True, error_model="numpy")(rotation_entries)


@njit(cache=True, error_model="numpy", nogil=True)
def _sum_groups(block, rows, starts, in_means, in_scales, in_quats, in_opacities, in_sh, means, covariances, light, sh):
    """Mean (3,), covariance (3, 3), stopped light and colours (K, 3) of each group of a block.

    The light that a Gaussian stops is its optical depth times the product of its two longest axes; it is its weight.
    """
    count = len(starts) - 1
    for g in range(block * BLOCK, min(block * BLOCK + BLOCK, count)):
        total = 0.0
        middle = np.zeros(3)
        colours = np.zeros((in_sh.shape[1], 3))
        for k in range(starts[g], starts[g + 1]):
            weight = _light(rows[k], in_scales, in_opacities)
            total += weight
            for axis in range(3):
                middle[axis] += weight * in_means[rows[k], axis]
            for band in range(in_sh.shape[1]):
                for c in range(3):
                    colours[band, c] += weight * in_sh[rows[k], band, c]
        middle /= total
        spread = np.zeros((3, 3))
        for k in range(starts[g], starts[g + 1]):
            i = rows[k]
            weight = _light(i, in_scales, in_opacities) / total
            e = _rotation(
                np.float64(in_quats[i, 0]), np.float64(in_quats[i, 1]), np.float64(in_quats[i, 2]),
                np.float64(in_quats[i, 3]),
            )  # fmt: skip
            for a in range(3):
                for b in range(3):
                    value = (in_means[i, a] - middle[a]) * (in_means[i, b] - middle[b])
                    for axis in range(3):
                        value += e[3 * a + axis] * e[3 * b + axis] * np.float64(in_scales[i, axis]) ** 2
                    spread[a, b] += weight * value
        light[g] = total
        # Number by number: for whole rows numba would also compile an error message, which takes seconds.
        for a in range(3):
            means[g, a] = middle[a]
            for b in range(3):
                covariances[g, a, b] = spread[a, b]
        for band in range(in_sh.shape[1]):
            for c in range(3):
                sh[g, band, c] = colours[band, c] / total


@njit(cache=True, error_model="numpy", nogil=True)
def _light(i, scales, opacities):
    """Light that Gaussian i stops, as in `_sum_groups`; never 0, so that a group of invisible Gaussians has a mean."""
    a, b, c = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
    area = max(a * b, a * c, b * c)
    return max(-math.log1p(-min(np.float64(opacities[i]), MOST_ALPHA)), 1e-9) * max(area, 1e-30)
