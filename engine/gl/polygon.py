"""The polygon that a plane shows within a piece: its section with a box, clipped by the piece's other planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.plane import frame

__all__ = ["face_polygons"]

Double = NDArray[np.float64]


def face_polygons(planes: Double, centre: Double, radius: float) -> list[Double]:
    """One convex polygon (V, 3) for each of the planes (P, 4); (0, 3) where it does not bound the piece.

    The piece is where all planes keep, within the cube of half side `radius` about `centre`.
    """
    polygons = []
    for j, (normal, offset) in enumerate(zip(planes[:, :3], planes[:, 3], strict=True)):
        e1, e2, n = frame(normal)
        foot = centre - n * float(n @ centre + offset)
        # The cube's half diagonal is sqrt(3) radius: a square with that half side covers every section.
        reach = 1.75 * radius
        polygon = foot + reach * np.array([-e1 - e2, e1 - e2, e1 + e2, -e1 + e2])
        for axis in np.eye(3):
            polygon = clip(polygon, axis, -float(axis @ centre) - radius)
            polygon = clip(polygon, -axis, float(axis @ centre) - radius)
        for m, other in enumerate(planes):
            if m != j and len(polygon):
                alike = other[:3] @ n > 1 - 1e-12 and abs(other[3] - offset) < 1e-12 * radius
                if alike and m > j:
                    continue  # a plane given twice: its first mention shows it, the others nothing
                if alike:
                    polygon = polygon[:0]
                polygon = clip(polygon, other[:3], float(other[3]))
        polygons.append(polygon)
    return polygons


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
