"""The visible cut faces of a piece, and the atoms that contribute to each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.chunks import atoms_at_plane
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.polygon import face_polygons, subtract
from engine.render.culling.store import Ellipsoids, Spheres
from engine.render.culling.view import View

__all__ = ["Face", "atoms_at_face", "scale_of", "visible_faces"]

Double = NDArray[np.float64]


@dataclass(frozen=True)
class Face:
    """The visible face of a piece on one of its planes."""

    index: int
    plane: Double
    """(4,). Centred object space."""
    first: int
    """Its first vertex, counted over all faces of the piece."""
    parts: list[Double]
    """Convex polygons (V, 3) that make up the face, their vertices in order."""

    @cached_property
    def corners(self) -> Double:
        """(V, 3). The vertices of all parts."""
        return np.concatenate(self.parts)

    def widest_pixel(self, view: View) -> float:
        """World units that a pixel spans where the face is farthest away."""
        depths = self.corners @ view.matrix[2, :3] + view.matrix[2, 3]
        return float(view.footprint(np.array([depths.max()]))[0])


def visible_faces(
    view: View,
    planes: Double,  # [P, 4] centred object space
    neighbours: list[Double],  # [P, 4] each
    box: tuple[Double, Double],
    tolerance: float,
) -> list[Face]:
    """The faces of a piece that look towards the eye, without the parts where a neighbour continues the solid."""
    front = view.sees_removed_side(planes) if len(planes) else np.zeros(0, bool)
    if not front.any():
        return []
    faces, first = [], 0
    for j, polygon in enumerate(face_polygons(planes, *box)):
        if not front[j] or len(polygon) < 3:
            continue
        parts = [polygon]
        for neighbour in neighbours:
            parts = [rest for part in parts for rest in subtract(part, neighbour, tolerance)]
        if parts:
            faces.append(Face(j, planes[j], first, parts))
            first += len(faces[-1].corners)
    return faces


def scale_of(atoms: Spheres | Ellipsoids, options: DrawOptions) -> float:
    """Factor by which these atoms are enlarged."""
    return options.disc_scale if isinstance(atoms, Ellipsoids) else options.ball_scale


def atoms_at_face(
    view: View,
    planes: Double,
    face: Face,
    atoms: Spheres | Ellipsoids,
    options: DrawOptions,
) -> NDArray[np.uint32]:
    """Indices of the atoms that contribute to a face."""
    chunks = atoms.chunks
    enlarge, least = scale_of(atoms, options), 0.5 * face.widest_pixel(view)
    kept = np.ones(len(chunks), bool)
    if options.cull:
        # An atom ends at three sigma; where a pixel is wider than the atom, the pixel's half width is its sigma.
        widened = np.maximum(chunks.sigma * enlarge, least)
        kept &= view.visible_chunks(chunks, enlarge)
        for j, plane in enumerate(planes):
            distances = chunks.distances(plane[:3], plane[3])
            kept &= distances[:, 0] <= 3 * widened
            if j == face.index:
                kept &= distances[:, 1] >= -3 * widened
    reach = np.maximum(atoms.reach * np.float32(enlarge), np.float32(3 * least))
    count = -(-chunks.count[kept] // 2**options.level)
    rows: NDArray[np.uint32] = atoms_at_plane(
        atoms.means, reach, chunks.first[kept], count, planes.astype(np.float32), face.index
    )
    return rows
