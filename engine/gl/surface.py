"""The outside of the opaque image (DESIGN, section 3): who is drawn, front depth, weighted sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.formula import CORE_Q, CUTOFF_Q, EPSILON_PITCHES
from engine.gl.batches import Batch, Pool
from engine.gl.chunks import rows_of
from engine.gl.context import Programs, write_uniforms
from engine.gl.store import Ellipsoids
from engine.gl.targets import Accumulators
from engine.gl.view import View

__all__ = ["MAX_PLANES", "RECORD", "SurfacePass", "sh_fields"]

MAX_PLANES = 64
"""Planes that can bound one piece, after those that cut nothing off it are dropped."""

POINT_LIMIT = 20.0
"""Pixels across up to which a splat is drawn as a square point: a point is set up four times faster than a quad, but
a quad hugs its ellipse."""

RECORD = {"record_centre": 4, "record_conic": 4, "record_shape": 4, "record_colour": 4}

GEOMETRY = {"mean": 3, "scale": 3, "quat": 4}


def sh_fields(splats: Ellipsoids) -> dict[str, int]:
    """The coefficient buffer's layout."""
    return {"sh": 4 * splats.vectors}


@dataclass(frozen=True)
class Run:
    """Projected atoms that are drawn alike."""

    batch: Batch
    points: bool
    planes: NDArray[np.float64]
    """(P, 4). Camera space; none where no atom of the run is near one."""


class SurfacePass:
    """Projects, then draws twice."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool

    def project(
        self,
        view: View,
        pieces: Sequence[NDArray[np.float64]],
        splats: Ellipsoids,
        level: int,
        cull: bool,
    ) -> list[Run]:
        """The atoms that each piece, given by planes (P, 4) in centred object space, can show."""
        chunks = splats.chunks
        if not len(chunks):
            return []
        enlarge = 2.0 ** (level / 2)
        seen, inside, diameter = view.chunks_seen(chunks, enlarge)
        if not cull:
            seen = np.ones_like(seen)
        small = inside & (diameter <= POINT_LIMIT)
        # A splat is felt three sigma away, and what the low-pass adds, which grows with depth.
        deepest = chunks.middle @ view.matrix[2, :3] + view.matrix[2, 3] + np.linalg.norm(chunks.half, axis=1)
        reach = 3 * chunks.sigma * enlarge + 4 * view.footprint(deepest)
        lists, runs = [], []
        for planes in pieces:
            kept, free = seen.copy(), np.ones(len(chunks), bool)
            for plane in planes:
                distances = chunks.distances(plane[:3], plane[3])
                if cull:
                    kept &= distances[:, 0] <= reach
                free &= distances[:, 1] < -reach
            for points in (True, False):
                for clipped in (False, True):
                    chosen = kept & (small == points) & (free != clipped)
                    if chosen.any():
                        count = -(-chunks.count[chosen] // 2**level)
                        lists.append(rows_of(chunks.first[chosen], count))
                        near = view.planes_in_camera(planes) if clipped else planes[:0]
                        runs.append(Run(self.pool.take(), points, near))
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
        write_uniforms(program, {**view.uniforms, "enlarge": enlarge})
        array = self.pool.source(program, (splats.geometry, GEOMETRY), (splats.coefficients, sh_fields(splats)))
        first = 0
        for rows, run in zip(lists, runs, strict=True):
            run.batch.fill(array, RECORD, first, len(rows))
            first += len(rows)
        return runs

    def draw(self, view: View, runs: Sequence[Run], targets: Accumulators, pitch: float) -> None:
        """Front depth into the depth buffer, then the sums of all that lies within epsilon of it."""
        ctx = self.ctx
        targets.front_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        ctx.depth_func = "<"
        self._pass(view, runs, CORE_Q**0.5, 0.0, visibility=True)
        targets.splat_fbo.use()
        ctx.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE | moderngl.BLEND)
        ctx.depth_func = "<="
        ctx.blend_func = moderngl.ONE, moderngl.ONE
        self._pass(view, runs, CUTOFF_Q**0.5, EPSILON_PITCHES * pitch, visibility=False)

    def _pass(self, view: View, runs: Sequence[Run], reach: float, behind: float, visibility: bool) -> None:
        for run in runs:
            program = self.programs.get(
                "splat.vert.glsl",
                "splat.frag.glsl",
                {
                    "VISIBILITY": int(visibility),
                    "POINTS": int(run.points),
                    "CLIPPED": int(len(run.planes) > 0),
                    "MAX_PLANES": MAX_PLANES,
                    "ORTHOGRAPHIC": int(view.camera.orthographic),
                },
            )
            values = {**view.uniforms, "reach": reach, "behind": behind, "plane_count": len(run.planes)}
            if len(run.planes):
                padded = np.zeros((MAX_PLANES, 4))
                padded[: len(run.planes)] = run.planes
                values["planes"] = padded
            write_uniforms(program, values)
            run.batch.draw(program, RECORD, run.points)
