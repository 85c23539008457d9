"""The outside of the opaque image: front depth, then weighted sums there and, where they leave gaps, behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.groups import MAX_PLANES, Rect
from engine.render.culling.store import Ellipsoids
from engine.render.culling.view import View
from engine.render.culling.visible import visible_atoms
from engine.render.gl.batches import Batch, Pool
from engine.render.gl.buffers import Buffers
from engine.render.gl.context import Programs, write_uniforms
from engine.render.gl.screen import Screen
from engine.render.gl.targets import Accumulators
from engine.scene.constants import CORE_Q, CUTOFF_Q, EPSILON_PITCHES, JOINT_PITCHES

__all__ = ["RECORD", "SurfacePass"]

CORE, WHOLE = CORE_Q**0.5, CUTOFF_Q**0.5
"""Radii to which a splat is drawn for the front depth and for the sums, standard deviations."""

SHUT = 1.0
"""Coverage from which nothing behind shows: full coverage, so that the picture is exact."""

RECORD = {"record_centre": 4, "record_conic": 4, "record_shape": 4, "record_colour": 4}


@dataclass(frozen=True)
class Run:
    """Projected atoms that are drawn in the same way."""

    batch: Batch
    planes: NDArray[np.float64]
    """(P, 4). Camera space; none if no plane is near an atom of the run."""


class SurfacePass:
    """Projects the splats once, then draws them three times: front depth, then sums at the front and behind it."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, screen: Screen, buffers: Buffers) -> None:
        self.ctx, self.programs, self.pool, self.screen, self.buffers = ctx, programs, pool, screen, buffers

    def project(
        self,
        view: View,
        pieces: Sequence[NDArray[np.float64]],
        splats: Ellipsoids,
        options: DrawOptions,
    ) -> list[Run]:
        """The atoms that each piece, given by planes (P, 4) in centred object space, can show."""
        lists, runs = [], []
        visible = visible_atoms(view, pieces, splats, options)
        for planes, (unclipped, clipped, hidden) in zip(pieces, visible, strict=True):
            # Hidden atoms come last: the depth test rejects them early.
            for rows, near in (
                (np.concatenate([unclipped, hidden]), planes[:0]),
                (clipped, view.planes_in_camera(planes)),
            ):
                if len(rows):
                    lists.append(rows)
                    runs.append(Run(self.pool.take(), near))
        if not runs:
            return []
        self.pool.write_indices(np.concatenate(lists))
        program = self.programs.get(
            "project.vert.glsl",
            None,
            {
                "SH_DEGREE": splats.degree,
                "SH_VECTORS": splats.vectors,
                "ORTHOGRAPHIC": int(view.camera.orthographic),
            },
            varyings=RECORD,
        )
        write_uniforms(program, {**view.uniforms, "enlarge": options.disc_scale})
        array = self.pool.source(program, *self.buffers.streams(splats))
        first = 0
        for rows, run in zip(lists, runs, strict=True):
            run.batch.fill(array, RECORD, first, len(rows))
            first += len(rows)
        return runs

    def draw(
        self,
        view: View,
        runs: Sequence[Run],
        targets: Accumulators,
        rect: Rect,
        pitch: float,
        has_faces: bool,
        options: DrawOptions,
    ) -> None:
        """Draws the front depth into the depth buffer, then the sums in the layer there and before it, then, only where
        that leaves gaps, those behind it: depth tests skip most pixels of the far side."""
        ctx, layer = self.ctx, EPSILON_PITCHES * pitch * options.disc_scale
        targets.front_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST)
        ctx.depth_func = "<"
        self._pass(view, runs, CORE, "VISIBILITY", {})
        values: dict[str, Any] = {
            **view.uniforms,
            "front@0": targets.depth,
            "in_layer@1": targets.splats,
            "rims@2": targets.rims,
            "edges@3": targets.edges,
            "faces@4": targets.faces,
            "face_depths@5": targets.face_depths,
            "layer": layer,
            "tolerance": JOINT_PITCHES * pitch,
        }
        for part, shader, defines in (
            ("NEAR_PART", "limit.frag.glsl", {}),
            ("FAR_PART", "gaps.frag.glsl", {"SHUT": SHUT, "FACES": int(has_faces)}),
        ):
            self.screen.fill(targets.limit_fbo, rect, shader, defines, values)
            targets.splat_fbo.use()
            ctx.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
            ctx.depth_func = "<="
            ctx.blend_func = moderngl.ONE, moderngl.ONE
            self._pass(view, runs, WHOLE, part, values)

    def _pass(self, view: View, runs: Sequence[Run], reach: float, part: str, uniforms: dict[str, Any]) -> None:
        for run in runs:
            program = self.programs.get(
                "splat.vert.glsl",
                "splat.frag.glsl",
                {
                    part: 1,
                    "CLIPPED": int(len(run.planes) > 0),
                    "MAX_PLANES": MAX_PLANES,
                    "ORTHOGRAPHIC": int(view.camera.orthographic),
                },
            )
            values = {**view.uniforms, **uniforms, "reach": reach, "plane_count": len(run.planes)}
            if len(run.planes):
                padded = np.zeros((MAX_PLANES, 4))
                padded[: len(run.planes)] = run.planes
                values["planes"] = padded
            write_uniforms(program, values)
            run.batch.draw(program, RECORD)
