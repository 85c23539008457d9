"""Restores the sharpness that interpolation between voxels takes from a volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import read_cells
from engine.threads import for_each, side_by_side
from training.priors.exemplar.frames import ScaledPicture, Space, View
from training.priors.exemplar.patches import OVER, RADIAL

__all__ = ["sharpen", "sharpen_layer"]

EDGE_SIGMA = 0.8
"""Standard deviation, in cells, of the unsharp mask: about the blur of trilinear interpolation."""

MAX_GAIN = 2.5
"""Largest gain; more has no effect, as voxels are clipped to their neighbours' range."""

TARGET = 1.25
"""Target sharpness over that of the pictures. Clipping voxels to their neighbours' range takes away half of the gain;
cuts of atoms then are 0.9 to 1.0 times as sharp as the truth."""

MIN_DEPTH = 0.15
"""Depth in inradii below which sharpness is compared; the rind would dominate it."""

SAMPLES = 30_000

Read = Callable[[NDArray[np.floating], NDArray[np.floating]], NDArray[np.float32]]


def sharpen(space: Space, rgb: NDArray[np.float32], views: Sequence[View]) -> float:
    """Sharpens the grid (X, Y, Z, 3) in place until its cuts are about as sharp as the pictures; returns the gain.

    Sharpness is the RMS Laplacian of grey, one cell wide, interpolated between voxels as in any cut. An unsharp mask is
    linear in its gain, so the gain solves a quadratic equation in three sums.
    """
    channels = [np.ascontiguousarray(rgb[..., c]) for c in range(3)]
    edges = side_by_side(lambda values: values - ndimage.gaussian_filter(values, EDGE_SIGMA), channels)
    greys = side_by_side(lambda three: (three[0] + three[1] + three[2]) / np.float32(3), (channels, edges))
    core = space.cells[space.depth > MIN_DEPTH]
    core = core[:: max(1, len(core) // SAMPLES)]
    wanted, sums = 0.0, np.zeros(3)
    for view in views:
        scaled = view.pictures[0]
        column, row = (scaled.xy * OVER + 0.5).astype(int).T
        x, y = scaled.xy[scaled.depth[row, column] > MIN_DEPTH].T
        wanted += TARGET**2 * float((_laplacian(_picture_reader(scaled), x, y) ** 2).mean())
        plain, edge = (_laplacian(_grid_reader(grey, core, view), *np.zeros((2, 1))) for grey in greys)
        sums += [(plain**2).mean(), (plain * edge).mean(), (edge**2).mean()]
    a, b, c = sums
    gain = (-b + np.sqrt(max(b * b - c * (a - wanted), 0))) / c if c > 0 and a < wanted else 0.0
    gain = float(np.clip(gain, 0, MAX_GAIN))

    for n, (values, edge) in enumerate(zip(channels, edges, strict=True)):
        for_each(sharpen_layer, len(values), values, edge, np.float32(gain), rgb[..., n])
    return gain


@njit(cache=True, nogil=True)
def sharpen_layer(
    x: int,
    values: NDArray[np.float32],  # [X, Y, Z]
    edge: NDArray[np.float32],  # [X, Y, Z]
    gain: float,
    out: NDArray[np.float32],  # [X, Y, Z]
) -> None:
    """Adds `gain` times the edge to a layer, within the range of the 3x3x3 cells around each. Overshoot beyond it would
    show as seams beside membranes and as coarser crumb."""
    nx, ny, nz = values.shape
    low, high = np.empty(nz, np.float32), np.empty(nz, np.float32)
    for y in range(ny):
        low[:], high[:] = np.inf, -np.inf
        for i in range(max(x - 1, 0), min(x + 2, nx)):
            for j in range(max(y - 1, 0), min(y + 2, ny)):
                for z in range(nz):
                    low[z], high[z] = min(low[z], values[i, j, z]), max(high[z], values[i, j, z])
        for z in range(nz):
            a, b = max(z - 1, 0), min(z + 1, nz - 1)
            least, most = min(min(low[a], low[z]), low[b]), max(max(high[a], high[z]), high[b])
            sharp = min(max(values[x, y, z] + gain * edge[x, y, z], least), most)
            out[x, y, z] = min(max(sharp, np.float32(0)), np.float32(1))


def _picture_reader(scaled: ScaledPicture) -> Read:
    """A reader of a picture's grey values."""
    return lambda x, y: scaled.read(x, y).mean(-1)


def _grid_reader(grey: NDArray[np.float32], core: NDArray[np.int16], view: View) -> Read:
    """A reader of a grid around core voxels, in planes like the view's but rotated off the axes of the grid."""
    a, b = view.basis[0], view.basis[2 if view.kind == RADIAL else 1]
    first, second = 0.8 * a + 0.6 * b, 0.8 * b - 0.6 * a

    def read(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        return read_cells(grey, (core.T + 0.37 + x * first[:, None] + y * second[:, None]).T)

    return read


def _laplacian(read: Read, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M,). The five-point Laplacian at positions in cells."""
    return read(x - 1, y) + read(x + 1, y) + read(x, y - 1) + read(x, y + 1) - 4 * read(x, y)
