"""The cut faces of the opaque image (DESIGN, section 3): the kernel field where each pixel's ray enters a piece.

Interior atoms come from the plane's grid; what a grid cannot hold (thin atoms of the skin; all, where a pixel is wider
than they are) is added up pixel by pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.formula import JOINT_PITCHES
from engine.gl.batches import Pool
from engine.gl.chunks import Chunks, near_plane
from engine.gl.context import Growing, Programs, layout, write_uniforms
from engine.gl.grid import Grids
from engine.gl.look import Look
from engine.gl.polygon import face_polygons, without
from engine.gl.store import Ellipsoids, Spheres
from engine.gl.surface import MAX_PLANES
from engine.gl.targets import Accumulators
from engine.gl.view import View
from engine.plane import frame

__all__ = ["Face", "SectionPass", "near_face", "scale_of", "visible_faces"]

Double = NDArray[np.float64]

POINT_LIMIT = 16.0
"""Pixels across up to which a section of an atom is drawn as a point, not as a quad that lies in the plane."""

OBLIQUE = 0.5
"""Cosine between view and plane below which quads are used: seen at a slant they hug a disc, points do not."""

GATHERED = {
    False: {"mean": 3, "sigma": 1, "rgb": 3},
    True: {"mean": 3, "scale": 3, "quat": 4, "dc": 3},
}


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


class SectionPass:
    """Draws what the planes of one piece show."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool
        self.grids = Grids(ctx, programs, pool)
        self.vertices = Growing(ctx)
        self._polygons: dict[moderngl.Program, moderngl.VertexArray] = {}

    def draw(
        self,
        view: View,
        planes: Double,  # [P, 4] centred object space
        mates: list[Double],  # [P, 4] each: the other pieces that lie where they grew beside this one
        box: tuple[Double, Double],  # corners of the solid's box, centred
        spheres: Spheres,
        ellipsoids: Ellipsoids | None,
        targets: Accumulators,
        pitch: float,
        rect: tuple[int, int, int, int],
        look: Look,
    ) -> bool:
        """Adds the piece's faces to the face layer, nearest first in depth; False where it shows none."""
        faces = visible_faces(view, planes, mates, box, JOINT_PITCHES * pitch)
        if not faces:
            return False
        if self.vertices.write(np.concatenate([f.corners for f in faces]).astype(np.float32)):
            self._forget_polygons()
        ctx = self.ctx
        grids = []
        for face in faces:
            widest = 0.5 * face.widest_pixel(view)
            minified = widest > float(spheres.reach.min(initial=np.inf)) / 3
            grids.append(None if look.exact or minified else self.grids.get(face.plane, spheres, look))

        targets.field_fbo.clear(viewport=rect)
        targets.field_fbo.use()
        ctx.enable_only(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        for face, grid in zip(faces, grids, strict=True):
            if ellipsoids is not None:
                self._add(view, planes, face, ellipsoids, look, pitch)
            if grid is None:
                self._add(view, planes, face, spheres, look, pitch)

        targets.face_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<="
        undo = np.linalg.inv(view.matrix)
        for face, grid in zip(faces, grids, strict=True):
            defines = {"ORTHOGRAPHIC": int(view.camera.orthographic), "GRID": int(grid is not None)}
            program = self.programs.get("polygon.vert.glsl", "face.frag.glsl", defines)
            values: dict[str, Any] = {
                **view.uniforms,
                "field@0": targets.field,
                "edge_sigma": pitch / 2,
                "light": float(look.light),
                "cut_in_camera": view.planes_in_camera(face.plane[None])[0],
            }
            if grid is not None:
                values |= {"grid@1": grid.texture, "to_grid": (grid.to_grid @ undo).T}
            write_uniforms(program, values)
            first = face.first
            for part in face.parts:
                self._polygon(program).render(moderngl.TRIANGLE_FAN, vertices=len(part), first=first)
                first += len(part)
        return True

    def _polygon(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program not in self._polygons:
            content = [layout(program, self.vertices.buffer, {"position": 3})]
            self._polygons[program] = self.ctx.vertex_array(program, content)
        return self._polygons[program]

    def _add(
        self, view: View, planes: Double, face: Face, atoms: Spheres | Ellipsoids, look: Look, pitch: float
    ) -> None:
        """Adds the atoms of one kind that one plane meets, pixel by pixel."""
        chunks = atoms.chunks
        if not len(chunks):
            return
        ellipsoid = isinstance(atoms, Ellipsoids)
        enlarge = scale_of(atoms, look)
        _, inside, _ = view.chunks_seen(chunks, enlarge)
        steep = abs(face.plane[:3] @ view.matrix[2, :3]) >= OBLIQUE
        widened = np.maximum(chunks.sigma * enlarge, 0.5 * face.widest_pixel(view))
        small = inside & (section_diameter(view, chunks, widened) <= POINT_LIMIT) & (steep and not ellipsoid)
        lists = [near_face(view, planes, face, atoms, look, small == points) for points in (True, False)]
        self.pool.write_indices(np.concatenate(lists))
        e1, e2, _ = frame(face.plane[:3])
        others = view.planes_in_camera(np.delete(planes, face.index, 0))
        padded = np.zeros((MAX_PLANES, 4))
        padded[: len(others)] = others
        values: dict[str, Any] = {
            **view.uniforms,
            "cut": face.plane,
            "cut_in_camera": view.planes_in_camera(face.plane[None])[0],
            "cut_x": e1,
            "cut_y": e2,
            "enlarge": enlarge,
            "tolerance": 1e-4 * pitch,
            "other_count": len(others),
            "others": padded,
        }
        defines = {
            "ORTHOGRAPHIC": int(view.camera.orthographic),
            "ELLIPSOID": int(ellipsoid),
            "MAX_PLANES": MAX_PLANES,
        }
        streams = atoms.flat_streams if isinstance(atoms, Ellipsoids) else atoms.streams
        if len(lists[0]):
            program = self.programs.get("slice.vert.glsl", "slice.frag.glsl", {"POINTS": 1, **defines})
            write_uniforms(program, values)
            self.pool.source(program, *streams).render(moderngl.POINTS, vertices=len(lists[0]))
        if len(lists[1]):
            fields = GATHERED[ellipsoid]
            varyings = [f"gathered_{name}" for name in fields]
            gather = self.programs.get("gather.vert.glsl", None, {"ELLIPSOID": int(ellipsoid)}, varyings)
            batch = self.pool.take()
            batch.fill(self.pool.source(gather, *streams), fields, len(lists[0]), len(lists[1]))
            program = self.programs.get("slice.vert.glsl", "slice.frag.glsl", defines)
            write_uniforms(program, values)
            batch.draw(program, fields, points=False)

    def _forget_polygons(self) -> None:
        for array in self._polygons.values():
            array.release()
        self._polygons.clear()

    def release(self) -> None:
        """Frees the polygons and the grids."""
        self._forget_polygons()
        self.grids.clear()
        self.vertices.release()


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


def section_diameter(view: View, chunks: Chunks, sigma: Double) -> Double:
    """(K,). Pixels across of the widest section in each chunk, with largest standard deviations (K,)."""
    c = view.camera
    focal = max(c.fx, c.fy)
    if c.orthographic:
        return 6 * sigma * focal
    box = np.linalg.norm(chunks.half, axis=1)
    nearest = chunks.middle @ view.matrix[2, :3] + view.matrix[2, 3] - box - 3 * sigma
    return np.where(nearest > 0, 6 * sigma * focal / np.maximum(nearest, 1e-30), np.inf)
