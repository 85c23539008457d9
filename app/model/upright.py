"""Stands the object on a face that the user points at, or turns it freely: both only change which way is up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.model.camera_control import project_points
from engine.scene.camera import Camera, equator

__all__ = ["face_normal", "point_under", "turn_between"]

Vector = NDArray[np.float64]

PATCH = 0.06
"""Radius of the patch that the first plane is fitted to, in radii of the object: a fingertip on a melon."""

FACE = 0.25
"""Radius, in radii of the object, within which points on that plane belong to the same face: a longer lever makes the
normal more exact."""

THICKNESS = 0.01
"""Half the thickness of a face, in radii of the object: skins of captures are that uneven."""

FEWEST = 12
"""Fewest points that a plane is fitted to."""

POINTER = 8.0
"""Radius around the pointer, in pixels, in which points count as pointed at."""


def point_under(points: NDArray[np.floating], camera: Camera, at: tuple[float, float]) -> Vector | None:
    """(3,). The foremost of the points (N, 3) under a point of the picture, in pixels; None if there is none.

    Up to one in ten of the points there may float in front of the object.
    """
    pixels, depth = project_points(camera, points)
    rows = np.flatnonzero((depth > camera.near) & (np.hypot(*(pixels - at).T) < POINTER))
    if not len(rows):
        return None
    order = rows[np.argsort(depth[rows], kind="stable")]
    return np.asarray(points[order[len(order) // 10]], np.float64)


def face_normal(points: NDArray[np.floating], at: Vector, eye: Vector, radius: float) -> Vector | None:
    """(3,). The unit normal of the face at a point (3,), towards the eye (3,); None where there are too few points.

    `points` (N, 3) are on the surface of an object of this `radius`.
    """
    distance = np.linalg.norm(points - at, axis=1)
    patch = points[distance < PATCH * radius].astype(np.float64)
    face = points[distance < FACE * radius].astype(np.float64)
    if len(patch) < FEWEST:
        return None
    for _ in range(4):
        middle = patch.mean(axis=0)
        normal: Vector = np.linalg.svd(patch - middle, full_matrices=False)[2][2]
        flat = face[np.abs((face - middle) @ normal) < THICKNESS * radius]
        if len(flat) < FEWEST:
            break
        patch = flat
    return normal if normal @ (eye - at) > 0 else -normal


def turn_between(start: Vector, end: Vector) -> NDArray[np.float64]:
    """(3, 3). The shortest rotation that takes one unit vector (3,) to another; half a turn is about the first vector
    of the equator."""
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < -1 + 1e-9:
        across = equator(start)[0]
        return 2 * np.outer(across, across) - np.eye(3)
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: NDArray[np.float64] = np.eye(3) + skew + skew @ skew / (1 + cosine)
    return turn
