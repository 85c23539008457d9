"""The skin of a body as a closed mesh with a place in a texture for every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xatlas
from manifold3d import Manifold, Mesh
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from engine.scene.grid import Body
from engine.solid.skin_cover import inward_normals

__all__ = ["GAP", "Skin", "skin_of"]

NUDGE = 1e-3
"""Cells. Least distance of a cell centre from the skin: through a corner of the grid, it would have triangles without
area."""

TOLERANCE = 0.05
"""Cells. How far the mesh may depart from the skin, which leaves it two fifths of the triangles; its outline moves by a
thirtieth of the distance between neighbouring atoms."""

GAP = 4
"""Texels between charts: the widest that a picture reduced four times still keeps apart."""


@dataclass(frozen=True)
class Skin:
    """The whole skin. Its charts and normals go with it through every cut."""

    solid: Manifold
    """Properties of a vertex: position (3), texel (2), outward unit normal (3)."""
    number: int
    """Marks its triangles in what is cut from it; all others are cut faces."""
    points: NDArray[np.float64]
    """(V, 3). World units."""
    texels: NDArray[np.float64]
    """(V, 2). Column and row in its charts; the centre of the first texel is at 0.5."""
    triangles: NDArray[np.int32]
    """(T, 3)."""
    width: int
    """Size of its charts, texels."""
    height: int


def skin_of(body: Body, texel: float) -> Skin:
    """The skin of a body, with charts of texels of this size in world units.

    Marching cubes on the signed depth, without the triangles that a flat part does not need. It is moved outwards
    evenly until it has the volume of the body: its corners then lie as far outside the skin as the middles of its
    triangles lie inside.
    """
    cell = body.grid.cell
    raw = _surface(body, 0.0)
    raw = _surface(body, (body.volume - raw.volume() * cell**3) / (raw.surface_area() * cell**2))
    mesh = raw.to_mesh()
    corners = np.asarray(mesh.vert_properties)[:, :3].astype(np.float64)
    points = body.grid.origin + (corners - 0.5) * cell  # the first cell centre is at 1 in the padded array
    faces = np.asarray(mesh.tri_verts)

    atlas = xatlas.Atlas()
    atlas.add_mesh(points.astype(np.float32), faces)
    packing = xatlas.PackOptions()
    packing.texels_per_unit, packing.padding, packing.bilinear = 1 / texel, GAP, True
    atlas.generate(xatlas.ChartOptions(), packing)
    origin, indices, places = atlas[0]
    texels = places.astype(np.float64) * (atlas.width, atlas.height)
    split = points[origin]
    normals = -inward_normals(body, split)
    first = np.full(len(points), -1, np.int64)
    first[origin[::-1]] = np.arange(len(origin))[::-1]
    here, there = np.arange(len(origin)), first[origin]
    double = here != there
    properties = np.concatenate([split, texels, normals], axis=1).astype(np.float32)
    number = Manifold.reserve_ids(1)
    solid = Manifold(
        Mesh(
            properties,
            indices.astype(np.uint32),
            merge_from_vert=here[double].astype(np.uint32),
            merge_to_vert=there[double].astype(np.uint32),
            run_index=np.array([0, 3 * len(indices)], np.uint32),
            run_original_id=np.array([number], np.uint32),
        )
    )
    return Skin(
        solid,
        number,
        properties[:, :3].astype(np.float64),
        texels,
        indices.astype(np.int32),
        int(atlas.width),
        int(atlas.height),
    )


def _surface(body: Body, out: float) -> Manifold:
    """A closed surface at this distance, in world units, outside the skin. Its coordinates are in cells, from the
    centre of the cell before the first."""
    cell = body.grid.cell
    depth = body.depth + np.float32(out)
    depth = np.where(np.abs(depth) < NUDGE * cell, np.float32(NUDGE * cell), depth)
    depth = np.pad(depth, 1, constant_values=-cell)  # closed at the border of the grid, too
    assert (depth > 0).any(), "an empty body"
    corners, faces, _, _ = marching_cubes(depth, 0.0, gradient_direction="ascent")
    return Manifold(Mesh(corners.astype(np.float32), faces.astype(np.uint32))).simplify(TOLERANCE)
