"""The cut faces of the opaque image (DESIGN, section 3): the kernel field where each pixel's ray enters a piece."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.gl.batches import Pool
from engine.gl.chunks import Chunks, near_plane
from engine.gl.context import Growing, Programs, layout, write_uniforms
from engine.gl.polygon import face_polygons
from engine.gl.store import Ellipsoids, Spheres
from engine.gl.targets import Accumulators
from engine.gl.view import View
from engine.plane import frame

__all__ = ["SectionPass"]

Double = NDArray[np.float64]

POINT_LIMIT = 16.0
"""Pixels across up to which a section of an atom is drawn as a point, not as a quad that lies in the plane."""

OBLIQUE = 0.5
"""Cosine between view and plane below which quads are used: seen at a slant they hug a disc, points do not."""

SPHERE = {"mean": 3, "sigma": 1}
RGB = {"rgb": 3}
ELLIPSOID = {"mean": 3, "scale": 3, "quat": 4}
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
    """Its polygon's first vertex."""
    count: int
    corners: Double
    """(V, 3)."""


class SectionPass:
    """Draws what the planes of one piece show."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool
        self.vertices = Growing(ctx)
        self._polygons: dict[moderngl.Program, moderngl.VertexArray] = {}

    def faces(self, view: View, planes: Double) -> list[Face]:
        """The faces of a piece with planes (P, 4) in centred object space that look towards the eye."""
        if not len(planes):
            return []
        front = view.sees_removed_side(planes)
        if not front.any():
            return []
        found, first = [], 0
        for j, polygon in enumerate(face_polygons(planes, np.zeros(3), view.radius)):
            if front[j] and len(polygon) >= 3:
                found.append(Face(j, planes[j], first, len(polygon), polygon))
                first += len(polygon)
        return found

    def draw(
        self,
        view: View,
        planes: Double,
        spheres: Spheres,
        ellipsoids: Ellipsoids | None,
        targets: Accumulators,
        pitch: float,
        rect: tuple[int, int, int, int],
        light: bool,
        level: int,
        cull: bool,
    ) -> bool:
        """Adds the piece's faces to the face layer, nearest first in depth; False where it shows none."""
        faces = self.faces(view, planes)
        if not faces:
            return False
        if self.vertices.write(np.concatenate([f.corners for f in faces]).astype(np.float32)):
            for array in self._polygons.values():
                array.release()
            self._polygons.clear()
        orthographic = int(view.camera.orthographic)
        ctx = self.ctx

        targets.hull_fbo.clear(viewport=rect)
        targets.hull_fbo.use()
        ctx.enable_only(moderngl.NOTHING)
        program = self.programs.get("hull.vert.glsl", "hull.frag.glsl", {"ORTHOGRAPHIC": orthographic})
        write_uniforms(program, view.uniforms)
        for face in faces:
            write_uniforms(program, {"plane": view.planes_in_camera(face.plane[None])[0], "index": face.index + 1.0})
            self._polygon(program).render(moderngl.TRIANGLE_FAN, vertices=face.count, first=face.first)

        targets.field_fbo.clear(viewport=rect)
        targets.field_fbo.use()
        ctx.enable_only(moderngl.BLEND | moderngl.PROGRAM_POINT_SIZE)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        for face in faces:
            self._atoms(view, planes, face, spheres, targets, level, cull)
            if ellipsoids is not None:
                self._atoms(view, planes, face, ellipsoids, targets, level, cull)

        targets.face_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<="
        program = self.programs.get("hull.vert.glsl", "face.frag.glsl", {"ORTHOGRAPHIC": orthographic})
        values = {"hull@0": targets.hull, "field@1": targets.field, "edge_sigma": pitch / 2, "light": float(light)}
        write_uniforms(program, {**view.uniforms, **values})
        for face in faces:
            normal = view.planes_in_camera(face.plane[None])[0, :3]
            write_uniforms(program, {"index": face.index + 1.0, "normal": normal})
            self._polygon(program).render(moderngl.TRIANGLE_FAN, vertices=face.count, first=face.first)
        return True

    def _polygon(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program not in self._polygons:
            self._polygons[program] = self.ctx.vertex_array(
                program, [layout(program, self.vertices.buffer, {"position": 3})]
            )
        return self._polygons[program]

    def _atoms(
        self,
        view: View,
        planes: Double,
        face: Face,
        atoms: Spheres | Ellipsoids,
        targets: Accumulators,
        level: int,
        cull: bool,
    ) -> None:
        """Adds the atoms of one kind that one plane meets."""
        chunks = atoms.chunks
        if not len(chunks):
            return
        ellipsoid = isinstance(atoms, Ellipsoids)
        enlarge = 2.0 ** (level / (2 if ellipsoid else 3))
        depths = face.corners @ view.matrix[2, :3] + view.matrix[2, 3]
        footprint = float(view.footprint(np.array([depths.max()]))[0])
        least = 0.5 * footprint
        # Sections are drawn where they are felt: three sigma, or as much of a wide pixel's.
        widened = np.maximum(chunks.sigma * enlarge, least)
        kept = np.ones(len(chunks), bool)
        seen, inside, _ = view.chunks_seen(chunks, enlarge)
        if cull:
            kept = seen.copy()
            for j, plane in enumerate(planes):
                distances = chunks.distances(plane[:3], plane[3])
                kept &= distances[:, 0] <= 3 * widened
                if j == face.index:
                    kept &= distances[:, 1] >= -3 * widened
        steep = abs(face.plane[:3] @ view.matrix[2, :3]) >= OBLIQUE
        small = inside & (self._diameter(view, chunks, widened) <= POINT_LIMIT) & (steep and not ellipsoid)
        lists = []
        reach = np.maximum(atoms.reach * enlarge, 3 * least).astype(np.float32)
        for points in (True, False):
            chosen = kept & (small == points)
            count = -(-chunks.count[chosen] // 2**level)
            rows = near_plane(atoms.means, reach, chunks.first[chosen], count, planes.astype(np.float32), face.index)
            lists.append(rows)
        self.pool.write_indices(np.concatenate(lists))
        _, _, n = frame(face.plane[:3])
        e1, e2, _ = frame(n)
        values: dict[str, Any] = {
            **view.uniforms,
            "cut": face.plane,
            "cut_x": e1,
            "cut_y": e2,
            "enlarge": enlarge,
            "hull@0": targets.hull,
            "index": face.index + 1.0,
        }
        defines = {
            "ORTHOGRAPHIC": int(view.camera.orthographic),
            "MINIFIED": int(not ellipsoid and least > float(atoms.reach.min(initial=np.inf)) * enlarge / 3),
            "ELLIPSOID": int(ellipsoid),
        }
        streams: tuple[Any, ...]
        if isinstance(atoms, Ellipsoids):
            dc = {"dc": 3, "rest": 4 * atoms.vectors - 3}
            streams = ((atoms.geometry, ELLIPSOID), (atoms.coefficients, dc))
        else:
            streams = ((atoms.geometry, SPHERE), (atoms.colours, RGB))
        if len(lists[0]):
            program = self.programs.get("slice.vert.glsl", "slice.frag.glsl", {"POINTS": 1, **defines})
            write_uniforms(program, values)
            self.pool.source(program, *streams).render(moderngl.POINTS, vertices=len(lists[0]))
        if len(lists[1]):
            fields = GATHERED[ellipsoid]
            varyings = tuple(f"gathered_{name}" for name in fields)
            gather = self.programs.get("gather.vert.glsl", None, {"ELLIPSOID": int(ellipsoid)}, varyings)
            batch = self.pool.take()
            batch.fill(self.pool.source(gather, *streams), fields, len(lists[0]), len(lists[1]))
            program = self.programs.get("slice.vert.glsl", "slice.frag.glsl", defines)
            write_uniforms(program, values)
            batch.draw(program, fields, points=False)

    def _diameter(self, view: View, chunks: Chunks, sigma: Double) -> Double:
        """(K,). Pixels across of the widest section in each chunk."""
        c = view.camera
        focal = max(c.fx, c.fy)
        if c.orthographic:
            return 6 * sigma * focal
        box = np.linalg.norm(chunks.half, axis=1)
        nearest = chunks.middle @ view.matrix[2, :3] + view.matrix[2, 3] - box - 3 * sigma
        return np.where(nearest > 0, 6 * sigma * focal / np.maximum(nearest, 1e-30), np.inf)

    def release(self) -> None:
        """Frees the polygons."""
        for array in self._polygons.values():
            array.release()
        self._polygons.clear()
        self.vertices.release()
