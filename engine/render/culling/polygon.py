"""The polygon of a plane within a piece: its section with a box, clipped by the piece's other planes."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from engine.scene.plane import frame

__all__ = ["corners_within", "face_polygons", "section_of_box", "subtract"]

Double = NDArray[np.float64]

SLACK = 1e-9
"""Share of a box's farthest coordinate by which planes are moved outwards where corners are looked for: far more than
rounding, which else puts a section's corners on either side of its own plane, far less than a pixel."""

Result = TypeVar("Result")


def cached(function: Callable[[Double, Double, Double], Result]) -> Callable[[Double, Double, Double], Result]:
    """Caches results for planes (P, 4) and a box, which mostly stay the same from frame to frame."""

    @lru_cache(maxsize=64)
    def compute(planes: bytes, low: bytes, high: bytes) -> Result:
        return function(np.frombuffer(planes).reshape(-1, 4), np.frombuffer(low), np.frombuffer(high))

    @wraps(function)
    def call(planes: Double, low: Double, high: Double) -> Result:
        return compute(*(np.ascontiguousarray(a, np.float64).tobytes() for a in (planes, low, high)))

    return call


@cached
def face_polygons(planes: Double, low: Double, high: Double) -> list[Double]:
    """One convex polygon (V, 3) for each of the planes (P, 4); (0, 3) where it does not bound the piece.

    The piece is the intersection of all half-spaces, within the box from low (3,) to high (3,).
    """
    size = float(np.linalg.norm(high - low))
    polygons = []
    for j, plane in enumerate(planes):
        polygon = section_of_box(plane, low, high)
        for m, other in enumerate(planes):
            if m != j and len(polygon):
                alike = other[:3] @ plane[:3] > 1 - 1e-12 and abs(other[3] - plane[3]) < 1e-12 * size
                if alike and m > j:
                    continue  # a plane given twice: only the first one has a face
                polygon = polygon[:0] if alike else clip(polygon, other[:3], float(other[3]))
        polygons.append(polygon)
    return polygons


def section_of_box(plane: Double, low: Double, high: Double) -> Double:
    """(V, 3). The polygon in which a plane (4,) meets the box from low (3,) to high (3,); (0, 3) where it does not."""
    e1, e2, normal = frame(plane[:3])
    middle = (low + high) / 2
    foot = middle - normal * float(normal @ middle + plane[3])
    # No point of the box is farther from its middle than half its diagonal.
    reach = float(np.linalg.norm(high - low)) / 2
    polygon = foot + reach * np.array([-e1 - e2, e1 - e2, e1 + e2, -e1 + e2])
    for axis, least, most in zip(np.eye(3), low, high, strict=True):
        polygon = clip(polygon, axis, -float(most))
        polygon = clip(polygon, -axis, float(least))
    return polygon


@cached
def corners_within(planes: Double, low: Double, high: Double) -> Double:
    """(V, 3). The corners of what planes (P, 4) keep of the box from low (3,) to high (3,), to SLACK; some occur twice
    or more often."""
    slack = SLACK * float(np.abs([low, high]).max())
    sides = [
        np.append(sign * axis, -sign * end[i])
        for i, axis in enumerate(np.eye(3))
        for sign, end in ((1, high), (-1, low))
    ]
    polygons = []
    for plane in [*sides, *planes]:
        polygon = section_of_box(plane, low, high)
        for other in planes:
            polygon = clip(polygon, other[:3], float(other[3]) - slack)
        polygons.append(polygon)
    return np.concatenate(polygons)


def subtract(polygon: Double, planes: Double, tolerance: float) -> list[Double]:
    """The part of a convex polygon (V, 3) outside the convex solid bounded by planes (P, 4), in convex parts.

    The solid is grown by the tolerance, so that what touches it counts as inside.
    """
    left = []
    for normal, offset in zip(planes[:, :3], planes[:, 3], strict=True):
        outside = clip(polygon, -normal, tolerance - float(offset))
        if len(outside) >= 3:
            left.append(outside)
        polygon = clip(polygon, normal, float(offset) - tolerance)
        if len(polygon) < 3:
            break
    return left


def clip(polygon: Double, normal: Double, offset: float) -> Double:
    """The part of a convex polygon (V, 3) with normal.x + offset <= 0 (Sutherland and Hodgman 1974)."""
    if not len(polygon):
        return polygon
    height = polygon @ normal + offset
    inside = height <= 0
    if inside.all():
        return polygon
    if not inside.any():
        return polygon[:0]
    corners = []
    for i in range(len(polygon)):
        k = (i + 1) % len(polygon)
        if inside[i]:
            corners.append(polygon[i])
        if inside[i] != inside[k]:
            t = height[i] / (height[i] - height[k])
            corners.append(polygon[i] + t * (polygon[k] - polygon[i]))
    return np.array(corners)
