"""Moves, turns and scales Gaussians as a whole, with the colours that they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from engine.scene.gaussians import Gaussians
from engine.scene.sh import basis

__all__ = ["Z_UP", "moved", "rotated_quats", "rotated_sh", "sh_rotation", "upright"]

Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""(3, 3). Rotation from y up to z up."""

DIRECTIONS = 200
"""Number of directions in which the basis is compared with the rotated one: over ten times the unknowns of degree 3."""


def moved(
    gaussians: Gaussians,
    rotation: NDArray[np.float64],  # [3, 3]
    shift: ArrayLike = (0.0, 0.0, 0.0),
    factor: float = 1.0,
) -> Gaussians:
    """The Gaussians after x -> factor R x + shift; from the turned side, each looks as before."""
    means = factor * (gaussians.means.astype(np.float64) @ rotation.T) + np.asarray(shift, np.float64)
    return replace(
        gaussians,
        means=means.astype(np.float32),
        scales=(gaussians.scales * np.float32(factor)),
        quats=rotated_quats(gaussians.quats, rotation),
        sh=rotated_sh(gaussians.sh, rotation),
    )


def rotated_sh(
    sh: NDArray[np.float32],  # [N, (d+1)^2, 3]
    rotation: NDArray[np.float64],  # [3, 3]
) -> NDArray[np.float32]:
    """(N, (d+1)^2, 3). Spherical harmonics rotated with their object: what is seen along d is then seen along R d."""
    degree = round(sh.shape[1] ** 0.5) - 1
    if degree == 0 or np.array_equal(rotation, np.eye(3)):
        return sh
    matrix = sh_rotation(rotation, degree)[1:, 1:]
    rows = np.flatnonzero(sh[:, 1:].any(axis=(1, 2)))  # interior atoms, most of a solid, have degree 0 only
    result = sh.copy()
    result[rows, 1:] = np.einsum("jk,nkc->njc", matrix, sh[rows, 1:])
    return result


def sh_rotation(rotation: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """((d+1)^2, (d+1)^2). The matrix by which a rotation (3, 3) acts on coefficients.

    A rotation acts linearly on the basis, B(R^T d) = B(d) M. M is solved by least squares over more directions than
    unknowns, which is exact because such an M exists. It holds for reflections too. Degrees do not mix, so one that is
    zero stays zero.
    """
    directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    matrix = np.linalg.lstsq(basis(directions, degree), basis(directions @ rotation, degree), rcond=None)[0]
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return np.where(degrees[:, None] == degrees, matrix, 0.0)


def rotated_quats(quats: NDArray[np.floating], rotation: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, 4). Quaternions wxyz (N, 4) after a rotation (3, 3)."""
    w, x, y, z = Rotation.from_matrix(rotation).as_quat(scalar_first=True).tolist()
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return (quats @ left.T).astype(np.float32)


def upright(up: ArrayLike) -> NDArray[np.float64]:
    """(3, 3). The shortest rotation that turns a unit vector to +y; for -y, as in captures, the half turn about x."""
    u = np.asarray(up, np.float64) / np.linalg.norm(up)
    if u[1] < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula for the axis u x y.
    axis = np.array([-u[2], 0.0, u[0]])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + u[1])
