"""The cut faces of a piece that can be seen, and the atoms that each shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.chunks import near_plane
from engine.render.culling.look import Look
from engine.render.culling.polygon import face_polygons, without
from engine.render.culling.store import Ellipsoids, Spheres
from engine.render.culling.view import View

__all__ = ["Face", "near_face", "scale_of", "visible_faces"]

Double = NDArray[np.float64]


@dataclass(frozen=True)
class Face:
    """A plane of a piece that can be seen."""

    index: int
    plane: Double
    """(4,). Centred object space."""
    first: int
    """Its first vertex."""
    parts: list[Double]
    """Convex polygons (V, 3), one vertex after the other."""

    @cached_property
    def corners(self) -> Double:
        """(V, 3). All of them."""
        return np.concatenate(self.parts)

    def widest_pixel(self, view: View) -> float:
        """World units that a pixel spans where the face is farthest away."""
        depths = self.corners @ view.matrix[2, :3] + view.matrix[2, 3]
        return float(view.footprint(np.array([depths.max()]))[0])


def visible_faces(
    view: View,
    planes: Double,  # [P, 4] centred object space
    mates: list[Double],  # [P, 4] each
    box: tuple[Double, Double],
    tolerance: float,
) -> list[Face]:
    """The faces of a piece that look towards the eye; where a mate lies against one, the matter runs on."""
    front = view.sees_removed_side(planes) if len(planes) else np.zeros(0, bool)
    if not front.any():
        return []
    found, first = [], 0
    for j, polygon in enumerate(face_polygons(planes, *box)):
        if not front[j] or len(polygon) < 3:
            continue
        parts = [polygon]
        for mate in mates:
            parts = [rest for part in parts for rest in without(part, mate, tolerance)]
        if parts:
            found.append(Face(j, planes[j], first, parts))
            first += len(found[-1].corners)
    return found


def scale_of(atoms: Spheres | Ellipsoids, look: Look) -> float:
    """How much larger than they are these atoms are drawn."""
    return look.disc_scale if isinstance(atoms, Ellipsoids) else look.ball_scale


def near_face(
    view: View,
    planes: Double,
    face: Face,
    atoms: Spheres | Ellipsoids,
    look: Look,
    chosen: NDArray[np.bool_] | None = None,  # [K] chunks; None: all
) -> NDArray[np.uint32]:
    """Indices of the atoms that a face shows."""
    chunks = atoms.chunks
    enlarge, least = scale_of(atoms, look), 0.5 * face.widest_pixel(view)
    kept = np.ones(len(chunks), bool) if chosen is None else chosen.copy()
    if look.cull:
        # An atom is felt three sigma away, or as much of a wide pixel's.
        widened = np.maximum(chunks.sigma * enlarge, least)
        kept &= view.chunks_seen(chunks, enlarge)[0]
        for j, plane in enumerate(planes):
            distances = chunks.distances(plane[:3], plane[3])
            kept &= distances[:, 0] <= 3 * widened
            if j == face.index:
                kept &= distances[:, 1] >= -3 * widened
    reach = np.maximum(atoms.reach * np.float32(enlarge), np.float32(3 * least))
    count = -(-chunks.count[kept] // 2**look.level)
    rows: NDArray[np.uint32] = near_plane(
        atoms.means, reach, chunks.first[kept], count, planes.astype(np.float32), face.index
    )
    return rows
