"""Quaternions (wxyz) as rotation matrices: one formula for arrays, kernels and tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["facing", "normalised_quats", "rotation_entries", "rotation_matrices"]


def rotation_entries(w: Any, x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """The nine entries, by rows, of a unit quaternion's rotation matrix, whose columns are the rotated axes.

    Takes numbers, arrays or tensors; numba compiles it for numbers and lanes.
    """
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


def rotation_matrices(quats: NDArray[np.floating]) -> NDArray[np.floating]:
    """(N, 3, 3). Rotation matrices of unit quaternions (N, 4), of the same float type."""
    return np.stack(rotation_entries(*quats.T), axis=-1).reshape(len(quats), 3, 3)


def facing(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 4). Quaternions that turn z to unit normals (N, 3), by half a turn about the direction half way between.

    A normal within 5e-4 radians of -z, finer than float32 normals resolve, counts as -z.
    """
    at_pole = normals[:, 2:] < -1 + 1e-7
    half = normals + np.where(at_pole, [1.0, 0, 1], [0.0, 0, 1])  # at -z any direction across will do
    return np.column_stack([np.zeros(len(half)), half / np.linalg.norm(half, axis=1, keepdims=True)])


def normalised_quats(quats: NDArray[np.floating]) -> NDArray[np.float64]:
    """(N, 4). The quaternions (N, 4) normalised; a zero quaternion becomes the identity."""
    q = quats.astype(np.float64)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(length > 1e-12, q / np.maximum(length, 1e-12), np.array([1.0, 0, 0, 0]))
