"""Cubic splines on a grid of colours."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.threads import for_spans, side_by_side

__all__ = ["read_cubic", "spline_coefficients"]


def spline_coefficients(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """(X, Y, Z, 3). Coefficients of the cubic splines through colours (X, Y, Z, 3) at whole numbers."""

    def of(values: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(ndimage.spline_filter(values, order=3, mode="nearest", output=np.float32))

    return np.stack(side_by_side(of, [rgb[..., c] for c in range(3)]), -1)


def read_cubic(
    splines: NDArray[np.float32],  # [X, Y, Z, 3]
    at: NDArray[np.float64],  # [M, 3] in cells, cell centres at whole numbers
) -> NDArray[np.float32]:
    """(M, 3). The cubic splines with these coefficients on a grid; those of the border continue beyond it. Equals
    SciPy's map_coordinates of order 3 for each channel, summed in another order, in an eighth of its processor time."""
    out = np.empty(at.shape, np.float32)
    for_spans(_read_cubic, len(at), splines, at, out)
    return out


@njit(cache=True, nogil=True)
def _read_cubic(
    start: int,
    stop: int,
    splines: NDArray[np.float32],  # [X, Y, Z, 3]
    at: NDArray[np.float64],  # [M, 3] in cells, cell centres at whole numbers
    out: NDArray[np.float32],  # [M, 3]
) -> None:
    cells, weights = np.empty((3, 4), np.int64), np.empty((3, 4))
    for m in range(start, stop):
        for axis in range(3):
            below = np.floor(at[m, axis])
            y = at[m, axis] - below
            z = 1 - y
            weights[axis, 0] = z * z * z / 6
            weights[axis, 1] = (y * y * (y - 2) * 3 + 4) / 6
            weights[axis, 2] = (z * z * (z - 2) * 3 + 4) / 6
            weights[axis, 3] = 1 - weights[axis, 0] - weights[axis, 1] - weights[axis, 2]
            for k in range(4):
                cells[axis, k] = min(max(int(below) + k - 1, 0), splines.shape[axis] - 1)
        red, green, blue = 0.0, 0.0, 0.0
        for i in range(4):
            for j in range(4):
                r, g, b = 0.0, 0.0, 0.0
                for k in range(4):
                    values = splines[cells[0, i], cells[1, j], cells[2, k]]
                    r += values[0] * weights[2, k]
                    g += values[1] * weights[2, k]
                    b += values[2] * weights[2, k]
                weight = weights[0, i] * weights[1, j]
                red, green, blue = red + weight * r, green + weight * g, blue + weight * b
        out[m, 0], out[m, 1], out[m, 2] = red, green, blue
