"""What reading between voxels takes from an inside, put back by as much as the pictures say."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.frames import Sheet, Space, View
from training.priors.exemplar.patches import OVER, RADIAL

__all__ = ["sharpen"]

SIGMA = 0.8
"""Blur in cells against which edges are measured: about that of trilinear reading."""

MOST = 2.5
"""Greatest gain; of more, nothing is left once voxels are held to their neighbours' range."""

TARGET = 1.25
"""Share of the pictures' sharpness to aim at. Holding voxels to their neighbours' range takes half of the gain away:
cuts of atoms then come out 0.9 to 1.0 times as sharp as the truth."""

CORE = 0.15
"""Depth in inradii from which sharpness is compared: the rind would decide it alone."""

SAMPLES = 30_000

Read = Callable[[NDArray[np.floating], NDArray[np.floating]], NDArray[np.float32]]


def sharpen(space: Space, rgb: NDArray[np.float32], views: Sequence[View]) -> float:
    """Sharpens the grid (X, Y, Z, 3) in place until its cuts are nearly as sharp as the pictures; returns the gain.

    Sharpness is the RMS Laplacian of grey, one cell wide, read between the voxels as any cut is. An unsharp mask is
    linear in its gain, so the gain follows from three sums.
    """
    edges = rgb - np.stack([ndimage.gaussian_filter(rgb[..., c], SIGMA) for c in range(3)], -1)
    core = space.cells[space.depth > CORE]
    core = core[:: max(1, len(core) // SAMPLES)]
    wanted, sums = 0.0, np.zeros(3)
    for view in views:
        sheet = view.sheets[0]
        column, row = (sheet.xy * OVER + 0.5).astype(int).T
        x, y = sheet.xy[sheet.depth[row, column] > CORE].T
        wanted += TARGET**2 * float((_laplacian(_picture(sheet), x, y) ** 2).mean())
        plain, edge = (_laplacian(_cut(grid.mean(-1), core, view), *np.zeros((2, 1))) for grid in (rgb, edges))
        sums += [(plain**2).mean(), (plain * edge).mean(), (edge**2).mean()]
    a, b, c = sums
    gain = (-b + np.sqrt(max(b * b - c * (a - wanted), 0))) / c if c > 0 and a < wanted else 0.0
    gain = float(np.clip(gain, 0, MOST))
    for channel in range(3):
        values = rgb[..., channel]
        # A voxel that left the range of its neighbours would show as a seam beside a membrane, and as coarser crumb.
        low = ndimage.minimum_filter(values, 3)
        high = ndimage.maximum_filter(values, 3)
        rgb[..., channel] = np.clip(np.clip(values + gain * edges[..., channel], low, high), 0, 1)
    return gain


def _picture(sheet: Sheet) -> Read:
    """Reads the grey of a sheet."""
    return lambda x, y: sheet.read(x, y).mean(-1)


def _cut(grey: NDArray[np.float32], core: NDArray[np.int16], view: View) -> Read:
    """Reads a grid around core voxels in a plane like the view's, but not along the axes of the grid."""
    a, b = view.basis[0], view.basis[2 if view.kind == RADIAL else 1]
    first, second = 0.8 * a + 0.6 * b, 0.8 * b - 0.6 * a

    def read(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        at = core.T + 0.37 + x * first[:, None] + y * second[:, None]
        return ndimage.map_coordinates(grey, at, order=1, mode="nearest", output=np.float32)

    return read


def _laplacian(read: Read, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M,). The five-point Laplacian at places in cells."""
    return read(x - 1, y) + read(x + 1, y) + read(x, y - 1) + read(x, y + 1) - 4 * read(x, y)
