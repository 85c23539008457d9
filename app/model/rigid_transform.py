"""Rigid motions as plain numbers, so that documents with them can be compared and saved exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.scene.plane import Plane
from engine.scene.rotations import of_unit

__all__ = ["STILL", "Motion", "Vec3", "vec3"]

Vec3 = tuple[float, float, float]


def vec3(values: ArrayLike) -> Vec3:
    """Three plain floats of an array (3,)."""
    x, y, z = np.asarray(values, np.float64).tolist()
    return x, y, z


@dataclass(frozen=True)
class Motion:
    """A rotation, then a translation: x -> R x + t."""

    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """The rotation R as a unit quaternion, wxyz."""
    shift: Vec3 = (0.0, 0.0, 0.0)
    """The translation t, world units."""

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3). Rotation matrix."""
        return np.array(of_unit(*self.turn)).reshape(3, 3)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4). Homogeneous matrix."""
        result = np.eye(4)
        result[:3, :3] = self.rotation
        result[:3, 3] = self.shift
        return result

    @staticmethod
    def of(matrix: NDArray[np.floating]) -> Motion:
        """The motion closest to a matrix (4, 4): scale and shear are dropped."""
        left, _, right = np.linalg.svd(np.asarray(matrix, np.float64)[:3, :3])
        rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
        return Motion(_quaternion(rotation), vec3(matrix[:3, 3]))

    @staticmethod
    def about(point: ArrayLike, axis: ArrayLike, degrees: float) -> Motion:
        """Rotation about the line through a point (3,) along an axis (3,)."""
        a = np.asarray(axis, np.float64)
        a = a / np.linalg.norm(a)
        half = math.radians(degrees) / 2
        x, y, z = (math.sin(half) * a).tolist()
        turn = Motion((math.cos(half), x, y, z))
        centre = np.asarray(point, np.float64)
        return Motion(turn.turn, vec3(centre - turn.rotation @ centre))

    @staticmethod
    def by(shift: ArrayLike) -> Motion:
        """Translation by (3,)."""
        return Motion(shift=vec3(shift))

    def after(self, first: Motion) -> Motion:
        """The composition: `first`, then this motion."""
        a, b = self.turn, first.turn
        turn = np.array(
            [
                a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
            ]
        )
        w, x, y, z = (turn / np.linalg.norm(turn)).tolist()
        return Motion((w, x, y, z), vec3(self.rotation @ np.asarray(first.shift) + np.asarray(self.shift)))

    def inverse(self) -> Motion:
        """The inverse motion."""
        w, x, y, z = self.turn
        back = Motion((w, -x, -y, -z))
        return Motion(back.turn, vec3(-(back.rotation @ np.asarray(self.shift))))

    def apply(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(..., 3). Moves points (..., 3)."""
        return np.asarray(points, np.float64) @ self.rotation.T + np.asarray(self.shift)

    def carried(self, plane: Plane) -> Plane:
        """Moves a plane."""
        normal = self.rotation @ np.asarray(plane.normal)
        return Plane.of(normal, plane.offset - float(normal @ np.asarray(self.shift)))


STILL = Motion()
"""The identity."""


def _quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Unit wxyz of a rotation matrix, w >= 0: the eigenvector of Bar-Itzhack's symmetric matrix, stable everywhere."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [0, r[0, 0] - r[1, 1] - r[2, 2], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2]],
            [0, 0, r[1, 1] - r[0, 0] - r[2, 2], r[2, 1] + r[1, 2]],
            [0, 0, 0, r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    vectors = np.linalg.eigh(k, UPLO="U")[1]
    w, x, y, z = (vectors[:, 3] * (1.0 if vectors[0, 3] >= 0 else -1.0)).tolist()
    return w, x, y, z
