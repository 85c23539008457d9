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


SLAB = 0.02
"""Of the radius: half the thickness of the slab whose surface points make an outline. Ten thousand points on a ball
have two hundred in the slab at its equator."""


def outline(solid: Solid, plane: Plane, rows: NDArray[np.intp] | None = None) -> NDArray[np.float64] | None:
    """(K, 3). A closed line where a plane meets the solid, or the part of it in `rows`; None where it misses.

    It is the hull of the surface points near the plane, and a hull knows no hollows: a guide to the eye. The cut itself
    is exact.
    """
    points = solid.points if rows is None else solid.points[rows]
    distance = plane.distance(points)
    if not len(points) or (distance > 0).all() or (distance < 0).all():
        return None
    skin = points[: solid.skin] if rows is None else solid.points[rows[rows < solid.skin]]
    if solid.skin < 1000:
        skin = points
    near = skin[np.abs(plane.distance(skin)) <= max(SLAB * solid.radius, 0.5 * solid.spacing if skin is points else 0)]
    if len(near) < 8:
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
    found = (outline(solid, plane) for plane in planes)
    return [line for line in found if line is not None]
