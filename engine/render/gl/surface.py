"""The outside of the opaque image: front depth, then weighted sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.groups import MAX_PLANES
from engine.render.culling.store import Ellipsoids
from engine.render.culling.view import View
from engine.render.culling.visible import visible_atoms
from engine.render.gl.batches import Batch, Pool
from engine.render.gl.buffers import Buffers
from engine.render.gl.context import Programs, write_uniforms
from engine.render.gl.targets import Accumulators
from engine.scene.constants import CORE_Q, CUTOFF_Q, EPSILON_PITCHES

__all__ = ["RECORD", "SurfacePass"]

POINT_LIMIT = 40.0
"""Pixels across up to which a splat is drawn as a square point: setting up a point takes half the time of a quad, but a
quad fits the ellipse tightly."""

CORE, WHOLE = CORE_Q**0.5, CUTOFF_Q**0.5
"""Radii to which the two passes draw a splat, standard deviations."""

REACHES = (WHOLE, CORE, 0.0)

RECORD = {"record_centre": 4, "record_conic": 4, "record_shape": 4, "record_colour": 4}


@dataclass(frozen=True)
class Run:
    """Projected atoms that are drawn in the same way."""

    batch: Batch
    reach: float
    """Standard deviations up to which these splats are small enough to be drawn as points."""
    planes: NDArray[np.float64]
    """(P, 4). Camera space; none if no plane is near an atom of the run."""


class SurfacePass:
    """Projects the splats once, then draws them twice: front depth, then sums."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, buffers: Buffers) -> None:
        self.ctx, self.programs, self.pool, self.buffers = ctx, programs, pool, buffers

    def project(
        self,
        view: View,
        pieces: Sequence[NDArray[np.float64]],
        splats: Ellipsoids,
        options: DrawOptions,
    ) -> list[Run]:
        """The atoms that each piece, given by planes (P, 4) in centred object space, can show."""
        chunks = splats.chunks
        if not len(chunks):
            return []
        _, inside, diameter = view.visible_chunks(chunks, options.disc_scale)
        # GL does not draw a point with its centre outside: only chunks entirely inside the picture may use points.
        points = np.select([inside & (diameter * r / 3 <= POINT_LIMIT) for r in REACHES[:-1]], REACHES[:-1], 0.0)
        lists, runs = [], []
        sizes = [points == size for size in REACHES]
        for planes, visible in zip(pieces, visible_atoms(view, pieces, splats, options, sizes), strict=True):
            for size, (unclipped, clipped, hidden) in zip(REACHES, visible, strict=True):
                # Hidden atoms last: the depth test rejects them early.
                for rows, near in (
                    (np.concatenate([unclipped, hidden]), planes[:0]),
                    (clipped, view.planes_in_camera(planes)),
                ):
                    if len(rows):
                        lists.append(rows)
                        runs.append(Run(self.pool.take(), size, near))
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

    def draw(self, view: View, runs: Sequence[Run], targets: Accumulators, pitch: float) -> None:
        """Draws the front depth into the depth buffer, then the sums of the layer behind it and of all that follows."""
        ctx = self.ctx
        targets.front_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        ctx.depth_func = "<"
        self._pass(view, runs, CORE, {}, visibility=True)
        targets.splat_fbo.use()
        ctx.enable_only(moderngl.PROGRAM_POINT_SIZE | moderngl.BLEND)
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        values = {"front@0": targets.depth, "layer": EPSILON_PITCHES * pitch}
        self._pass(view, runs, WHOLE, values, visibility=False)

    def _pass(self, view: View, runs: Sequence[Run], reach: float, uniforms: dict[str, Any], visibility: bool) -> None:
        for run in runs:
            points = run.reach >= reach
            program = self.programs.get(
                "splat.vert.glsl",
                "splat.frag.glsl",
                {
                    "VISIBILITY": int(visibility),
                    "POINTS": int(points),
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
            run.batch.draw(program, RECORD, points)
