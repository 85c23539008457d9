"""The cut faces of the opaque image: the kernel field where each pixel's ray enters a piece.

Interior atoms come from the plane's grid. What a grid cannot hold is summed pixel by pixel: thin atoms of the skin, and
all atoms if they are smaller than a pixel.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.groups import MAX_PLANES
from engine.render.culling.piece_faces import Face, atoms_at_face, scale_of, visible_faces
from engine.render.culling.store import Ellipsoids, Spheres
from engine.render.culling.view import View
from engine.render.gl.batches import Pool
from engine.render.gl.buffers import Buffers
from engine.render.gl.context import Growing, Programs, layout, write_uniforms
from engine.render.gl.grid import GridTextures
from engine.render.gl.targets import Accumulators
from engine.scene.constants import JOINT_PITCHES
from engine.scene.plane import frame

__all__ = ["SectionPass"]

Double = NDArray[np.float64]

EDGE_PITCHES = 1e-4
"""A face reaches this far beyond the piece's other planes, so that rounding leaves no crack along an edge."""

GATHERED = {
    False: {"mean": 3, "sigma": 1, "rgb": 3},
    True: {"mean": 3, "scale": 3, "quat": 4, "dc": 3},
}


class SectionPass:
    """Draws the cut faces of one piece."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, buffers: Buffers) -> None:
        self.ctx, self.programs, self.pool, self.buffers = ctx, programs, pool, buffers
        self.grids = GridTextures(ctx, programs, pool, buffers)
        self.vertices = Growing(ctx)
        self._polygons: dict[moderngl.Program, moderngl.VertexArray] = {}

    def draw(
        self,
        view: View,
        planes: Double,  # [P, 4] centred object space
        neighbours: list[Double],  # [P, 4] each: the pieces that lie together with this one
        box: tuple[Double, Double],  # corners of the solid's box, centred
        spheres: Spheres,
        ellipsoids: Ellipsoids | None,
        targets: Accumulators,
        pitch: float,
        rect: tuple[int, int, int, int],
        options: DrawOptions,
    ) -> bool:
        """Adds the piece's faces to the face layer, the nearest in front; False if none is visible."""
        faces = visible_faces(view, planes, neighbours, box, JOINT_PITCHES * pitch)
        if not faces:
            return False
        if self.vertices.write(np.concatenate([f.corners for f in faces]).astype(np.float32)):
            self._clear_polygons()
        ctx = self.ctx
        grids = []
        for face in faces:
            widest = 0.5 * face.widest_pixel(view)
            minified = widest > float(spheres.reach.min(initial=np.inf)) / 3
            grids.append(None if options.exact or minified else self.grids.get(face.plane, spheres, options))

        ctx.enable_only(moderngl.BLEND)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        targets.skin_field_fbo.clear(viewport=rect)
        targets.skin_field_fbo.use()
        if ellipsoids is not None:
            for face in faces:
                self._add(view, planes, face, ellipsoids, options, pitch)
        targets.field_fbo.clear(viewport=rect)
        targets.field_fbo.use()
        for face, grid in zip(faces, grids, strict=True):
            if grid is None:
                self._add(view, planes, face, spheres, options, pitch)

        targets.face_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<="
        to_object = np.linalg.inv(view.matrix)
        for face, grid in zip(faces, grids, strict=True):
            defines = {"ORTHOGRAPHIC": int(view.camera.orthographic), "GRID": int(grid is not None)}
            program = self.programs.get("polygon.vert.glsl", "face.frag.glsl", defines)
            values: dict[str, Any] = {
                **view.uniforms,
                "field@0": targets.field,
                "skin_field@2": targets.skin_field,
                "edge_sigma": pitch / 2,
                "light": float(options.light),
                "cut_in_camera": view.planes_in_camera(face.plane[None])[0],
            }
            if grid is not None:
                values |= {"grid@1": grid.texture, "to_grid": (grid.to_grid @ to_object).T}
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
        self, view: View, planes: Double, face: Face, atoms: Spheres | Ellipsoids, options: DrawOptions, pitch: float
    ) -> None:
        """Adds the atoms of one kind that one plane meets, pixel by pixel."""
        ellipsoid = isinstance(atoms, Ellipsoids)
        enlarge = scale_of(atoms, options)
        rows = atoms_at_face(view, planes, face, atoms, options)
        if not len(rows):
            return
        self.pool.write_indices(rows)
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
            "tolerance": EDGE_PITCHES * pitch,
            "other_count": len(others),
            "others": padded,
        }
        defines = {
            "ORTHOGRAPHIC": int(view.camera.orthographic),
            "ELLIPSOID": int(ellipsoid),
            "MAX_PLANES": MAX_PLANES,
        }
        streams = self.buffers.streams(atoms, flat=True)
        fields = GATHERED[ellipsoid]
        varyings = [f"gathered_{name}" for name in fields]
        gather = self.programs.get("gather.vert.glsl", None, {"ELLIPSOID": int(ellipsoid)}, varyings)
        batch = self.pool.take()
        batch.fill(self.pool.source(gather, *streams), fields, 0, len(rows))
        program = self.programs.get("slice.vert.glsl", "slice.frag.glsl", defines)
        write_uniforms(program, values)
        batch.draw(program, fields)

    def _clear_polygons(self) -> None:
        for array in self._polygons.values():
            array.release()
        self._polygons.clear()

    def release(self) -> None:
        """Frees the polygons and the grids."""
        self._clear_polygons()
        self.grids.clear()
        self.vertices.release()
