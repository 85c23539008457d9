"""How far coarse atoms are from the colours they stand for, in NumPy and SciPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.octree import CONTRAST, CONTRAST_FLOOR, blocks

__all__ = ["approximation_error"]


def approximation_error(rgb: NDArray[np.floating], size: int) -> NDArray[np.float64]:
    """(X / size, ...). `engine.solid.octree.approximation_error`, channel by channel."""
    error, variance = 0.0, 0.0
    for channel in np.moveaxis(rgb.astype(np.float64), -1, 0):
        means = blocks(channel, size).mean(axis=(1, 3, 5))
        lattice = ndimage.zoom(means, size, order=1, mode="nearest", grid_mode=True)
        error = error + blocks((lattice - channel) ** 2, size).mean(axis=(1, 3, 5)) / 3
        variance = variance + (blocks(channel**2, size).mean(axis=(1, 3, 5)) - means**2) / 3
    contrast = np.sqrt(ndimage.maximum_filter(np.maximum(variance, 0), 3) + CONTRAST_FLOOR**2)
    return np.asarray(error * (CONTRAST / contrast))
