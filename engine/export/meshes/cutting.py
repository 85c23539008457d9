"""Cuts a closed mesh into closed pieces, exactly along planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from engine.export.meshes.surface import Skin
from engine.scene.plane import Plane

__all__ = ["Cut", "MeshOptions", "cut_skin", "divided"]

SLIVER = 1e-9
"""Share of the whole volume below which a piece is only rounding."""

WELD = 1e-6
"""Share of the object's size below which two points are one. Single precision resolves a tenth of it."""

SKIN = -1
"""Number of the skin among the faces of a piece."""


@dataclass(frozen=True)
class MeshOptions:
    """A piece to cut out."""

    name: str
    cells: tuple[tuple[Plane, ...], ...] = ((),)
    """Its convex parts, each the kept sides of its planes; without planes it is the whole object."""
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """(4, 4). Rigid, from the object's coordinates to those where the piece lies."""


@dataclass(frozen=True)
class Cut:
    """A piece as a closed mesh, still in the object's coordinates."""

    wanted: MeshOptions
    points: NDArray[np.float32]
    """(V, 3). World units. A point on an edge between skin and face occurs once for each, in the same place."""
    texels: NDArray[np.float32]
    """(V, 2). Column and row in the charts of the skin; meaningless on faces."""
    normals: NDArray[np.float32]
    """(V, 3). Normals of the skin; meaningless on faces."""
    triangles: NDArray[np.int32]
    """(T, 3). Counter-clockwise from outside."""
    face: NDArray[np.int32]
    """(T,). Which of `planes` each triangle lies on; SKIN for those of the skin."""
    planes: tuple[Plane, ...]
    """The planes of all cells."""
    volume: float
    """World units cubed."""


def divided(skin: Skin, planes: Sequence[Plane]) -> list[MeshOptions]:
    """All pieces that planes divide an object into, those on the kept sides first."""
    parts: list[tuple[tuple[Plane, ...], Manifold]] = [((), skin.solid)]
    for plane in planes:
        halves = [((*sides, side), _kept(part, side)) for sides, part in parts for side in (plane, plane.flipped())]
        parts = [(sides, part) for sides, part in halves if part.volume() > SLIVER * skin.solid.volume()]
    if len(parts) == 1:
        return [MeshOptions("whole", (parts[0][0],))]
    return [MeshOptions(f"piece_{number}", (sides,)) for number, (sides, _) in enumerate(parts, 1)]


def cut_skin(skin: Skin, wanted: MeshOptions) -> Cut | None:
    """A piece of an object; None if there is nothing in it."""
    cells = []
    for planes in wanted.cells:
        part = skin.solid
        for plane in planes:
            part = _kept(part, plane)
        cells.append(part)
    solid = cells[0]
    for cell in cells[1:]:
        solid = solid + cell
    if solid.volume() <= SLIVER * skin.solid.volume():
        return None
    mesh = solid.to_mesh()
    values, triangles = np.asarray(mesh.vert_properties), np.asarray(mesh.tri_verts).astype(np.int32)
    runs = np.asarray(mesh.run_index).astype(np.int64) // 3
    is_skin = np.zeros(len(triangles), bool)
    for first, end, number in zip(runs[:-1], runs[1:], np.asarray(mesh.run_original_id), strict=True):
        is_skin[first:end] = number == skin.number
    planes = tuple(dict.fromkeys(plane for cell in wanted.cells for plane in cell))
    face = np.full(len(triangles), SKIN, np.int32)
    if planes:
        corners = values[triangles[~is_skin], :3].astype(np.float64)
        distance = np.stack([np.abs(plane.distance(corners)).max(1) for plane in planes], axis=1)
        face[~is_skin] = distance.argmin(1)
    points, kept = _welded(values[:, :3], triangles, face, WELD * float(np.ptp(skin.points, axis=0).max()))
    volume = float(solid.volume())
    return Cut(wanted, points, values[:, 3:5], values[:, 5:8], triangles[kept], face[kept], planes, volume)


def _welded(
    points: NDArray[np.float32], triangles: NDArray[np.int32], face: NDArray[np.int32], near: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """(V, 3), (T,). The points, with those nearer than `near` to each other in one place, and the triangles left.

    Where two planes meet in the skin, a cut leaves edges of no length. Readers join their ends, and then see a hole
    where a triangle without area was.
    """
    unique, place = np.unique(points, axis=0, return_inverse=True)
    place = place.reshape(-1)
    pairs = cKDTree(unique).query_pairs(near, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(unique), len(unique)))
    group = connected_components(links, directed=False)[1]
    # The point on most faces stays where it is, so that faces stay flat.
    corners = np.unique(np.stack([place[triangles].ravel(), np.repeat(face, 3)], axis=1), axis=0)[:, 0]
    order = np.argsort(-np.bincount(corners, minlength=len(unique)), kind="stable")
    first = np.full(int(group.max()) + 1, -1)
    first[group[order[::-1]]] = order[::-1]
    own = first[group][place]
    at = own[triangles]
    area = (at[:, 0] != at[:, 1]) & (at[:, 1] != at[:, 2]) & (at[:, 2] != at[:, 0])
    # Two triangles with the same corners lie on each other, back to back.
    _, same, count = np.unique(np.sort(at, axis=1), axis=0, return_inverse=True, return_counts=True)
    return unique[own], area & (count[same.reshape(-1)] == 1)


def _kept(solid: Manifold, plane: Plane) -> Manifold:
    """The part of a solid on the kept side of a plane."""
    a, b, c = plane.normal
    return solid.trim_by_plane((-a, -b, -c), plane.offset)
