"""Rigid motions as plain numbers, so that documents with them can be compared and saved exactly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from engine.scene.plane import Plane
from engine.scene.rotations import rotation_entries

__all__ = ["STILL", "Motion", "Vec3", "vec3"]

Vec3 = tuple[float, float, float]


def vec3(values: ArrayLike) -> Vec3:
    """An array (3,) as three plain floats."""
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
        return np.array(rotation_entries(*self.turn)).reshape(3, 3)

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
        w, x, y, z = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True).tolist()
        return Motion((w, x, y, z), vec3(matrix[:3, 3]))

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
        turn = Rotation.from_quat(self.turn, scalar_first=True) * Rotation.from_quat(first.turn, scalar_first=True)
        w, x, y, z = turn.as_quat(scalar_first=True).tolist()
        return Motion((w, x, y, z), vec3(self.rotation @ np.asarray(first.shift) + np.asarray(self.shift)))

    def inverse(self) -> Motion:
        """The inverse motion."""
        w, x, y, z = self.turn
        back = Motion((w, -x, -y, -z))
        return Motion(back.turn, vec3(-(back.rotation @ np.asarray(self.shift))))

    def apply(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(..., 3). Points (..., 3) moved by this motion."""
        return np.asarray(points, np.float64) @ self.rotation.T + np.asarray(self.shift)

    def carried(self, plane: Plane) -> Plane:
        """The plane moved by this motion."""
        normal = self.rotation @ np.asarray(plane.normal)
        return Plane.of(normal, plane.offset - float(normal @ np.asarray(self.shift)))


STILL = Motion()
"""The identity."""
