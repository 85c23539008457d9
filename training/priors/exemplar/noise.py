"""Smooth random functions of position."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import for_spans

__all__ = ["Noise"]

EXTENT = 1.3
"""Half a side of the cube that is covered; the values of its border continue beyond it."""


class Noise:
    """Smooth random functions on the ball with mean 0 and standard deviation about 1."""

    def __init__(self, lengths: tuple[float, ...], count: int, rng: np.random.Generator) -> None:
        shape = [int(np.ceil(2 * EXTENT / length)) + 4 for length in lengths]
        self._lengths = np.array(lengths, np.float32)
        splines = [ndimage.spline_filter(rng.standard_normal(shape), 2, np.float32) for _ in range(count)]
        # Interpolation leaves 0.55 of the standard deviation.
        self._splines = (np.stack(splines, -1) / 0.55).astype(np.float32)

    def at(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M, count). The values at points (M, 3)."""
        out = np.empty((len(points), self._splines.shape[3]), np.float32)
        at = ((points + EXTENT) / self._lengths + 1.5).astype(np.float32)
        for_spans(_read_spline, len(out), self._splines, at, out)
        return out


@njit(cache=True, nogil=True)
def _read_spline(
    start: int,
    stop: int,
    coefficients: NDArray[np.float32],  # [X, Y, Z, C]
    at: NDArray[np.float32],  # [M, 3] in cells
    out: NDArray[np.float32],  # [M, C]
) -> None:
    """Quadratic B-splines (Unser 1999) at points; the coefficients of the lattice's border continue beyond it."""
    channels = coefficients.shape[3]
    weights, first = np.empty((3, 3), np.float32), np.empty(3, np.int64)
    for m in range(start, stop):
        for a in range(3):
            middle = np.floor(at[m, a] + np.float32(0.5))
            t = at[m, a] - middle
            first[a] = np.int64(middle) - 1
            weights[a, 0] = np.float32(0.5) * (np.float32(0.5) - t) ** 2
            weights[a, 1] = np.float32(0.75) - t * t
            weights[a, 2] = np.float32(0.5) * (np.float32(0.5) + t) ** 2
        for c in range(channels):
            value = np.float32(0)
            for i in range(3):
                x = min(max(first[0] + i, 0), coefficients.shape[0] - 1)
                for j in range(3):
                    y = min(max(first[1] + j, 0), coefficients.shape[1] - 1)
                    line = np.float32(0)
                    for k in range(3):
                        z = min(max(first[2] + k, 0), coefficients.shape[2] - 1)
                        line += weights[2, k] * coefficients[x, y, z, c]
                    value += weights[0, i] * weights[1, j] * line
            out[m, c] = value
