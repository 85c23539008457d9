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
        for_spans(_read_spline, len(out), self._splines, self._lengths, points, out)
        return out


@njit(cache=True, nogil=True)
def _read_spline(
    start: int,
    stop: int,
    coefficients: NDArray[np.float32],  # [X, Y, Z, C]
    lengths: NDArray[np.float32],  # [3] of the lattice's cells
    points: NDArray[np.floating],  # [M, 3]
    out: NDArray[np.float32],  # [M, C]
) -> None:
    """Quadratic B-splines (Unser 1999) at points; the coefficients of the lattice's border continue beyond it."""
    channels = coefficients.shape[3]
    last_x, last_y, last_z = coefficients.shape[0] - 1, coefficients.shape[1] - 1, coefficients.shape[2] - 1
    for m in range(start, stop):
        x, along_x = _spline(points[m, 0], lengths[0])
        y, along_y = _spline(points[m, 1], lengths[1])
        z, along_z = _spline(points[m, 2], lengths[2])
        z0, z1, z2 = min(max(z, 0), last_z), min(max(z + 1, 0), last_z), min(max(z + 2, 0), last_z)
        for c in range(channels):
            value = np.float32(0)
            for i in range(3):
                u = min(max(x + i, 0), last_x)
                for j in range(3):
                    v = min(max(y + j, 0), last_y)
                    line = along_z[0] * coefficients[u, v, z0, c]
                    line += along_z[1] * coefficients[u, v, z1, c]
                    line += along_z[2] * coefficients[u, v, z2, c]
                    value += along_x[i] * along_y[j] * line
            out[m, c] = value


@njit(cache=True, nogil=True, inline="always")
def _spline(place, length):  # type: ignore[no-untyped-def]
    """The first of three coefficients along an axis that count at a place, and their weights. `length`: of a cell."""
    half, at = np.float32(0.5), (np.float32(place) + np.float32(EXTENT)) / length + np.float32(1.5)
    middle = np.floor(at + half)
    t = at - middle
    return np.int64(middle) - 1, (half * (half - t) ** 2, np.float32(0.75) - t * t, half * (half + t) ** 2)
