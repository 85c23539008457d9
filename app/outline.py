"""Where a plane meets the object, as a line to draw: the hull of the points that lie near the plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from app.pieces import Solid
from engine.body import Body
from engine.plane import Plane, frame
from training.families import Family

__all__ = ["body_of", "family_outlines", "outline"]


def outline(points: NDArray[np.float64], plane: Plane, spacing: float) -> NDArray[np.float64] | None:
    """(K, 3). A closed line on the plane around points (N, 3) nearer to it than `spacing`; None where it misses them.

    A hull knows no hollows: it is a guide to the eye, the cut itself is exact.
    """
    distance = plane.distance(points)
    near = points[np.abs(distance) <= spacing]
    if len(near) < 8 or (distance > 0).all() or (distance < 0).all():
        return None
    e1, e2, n = frame(plane.normal)
    flat = near @ np.stack([e1, e2]).T
    try:
        hull = ConvexHull(flat)
    except QhullError:
        return None
    corners = flat[hull.vertices]
    return corners[:, :1] * e1 + corners[:, 1:] * e2 - n * plane.offset


def body_of(solid: Solid) -> Body:
    """The solid on a coarse grid, exact to half the spacing of its points, for what asks for a body."""
    cell = solid.spacing / 2
    if not len(solid.points):
        return Body(np.zeros(3), 1.0, np.full((1, 1, 1), -1.0, np.float32))
    low, high = solid.points.min(0), solid.points.max(0)
    shape = np.ceil((high - low) / cell).astype(int) + 1
    depth = np.full(tuple(shape), -cell, np.float32)
    depth[tuple(((solid.points - low) / cell).astype(int).T)] = cell
    return Body(low - cell / 2, cell, depth)


def family_outlines(
    family: Family, solid: Solid, body: Body, up: Sequence[float], most: int = 40
) -> list[NDArray[np.float64]]:
    """Outlines of a family's planes as they will be trained; of every second or third where there are very many."""
    planes = family.planes(body, np.asarray(up, np.float64))
    planes = planes[:: max(1, -(-len(planes) // most))]
    found = (outline(solid.points, plane, solid.spacing) for plane in planes)
    return [line for line in found if line is not None]
