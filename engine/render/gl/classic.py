"""The unchanged capture: sorted alpha compositing (Kerbl et al. 2023), with the depth order made by a thread.

The camera never waits for the sort: a frame uses the newest order, and `sorting` says whether a newer one is pending.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.classic.depth_order import depth_order
from engine.render.culling.view import View
from engine.render.gl.batches import Pool
from engine.render.gl.context import Programs, write_uniforms
from engine.render.gl.surface import RECORD
from engine.render.gl.targets import Accumulators
from engine.render.projection import CameraRecord, camera_record
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians

__all__ = ["Capture"]

Float = NDArray[np.float32]


class Capture:
    """N Gaussians on the GPU, and their depth order."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, gaussians: Gaussians) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool
        self.count = len(gaussians)
        means = gaussians.means.astype(np.float64)
        self.centre = (means.min(0) + means.max(0)) / 2 if self.count else np.zeros(3)
        self.means = np.ascontiguousarray((means - self.centre).astype(np.float32))
        self.degree = gaussians.sh_degree
        self.vectors = -(-3 * gaussians.sh.shape[1] // 4)
        shape = np.concatenate([self.means, gaussians.scales, gaussians.quats, gaussians.opacities[:, None]], 1).astype(
            np.float32
        )
        packed = np.zeros((self.count, 4 * self.vectors), np.float32)
        packed[:, : 3 * gaussians.sh.shape[1]] = gaussians.sh.reshape(self.count, 3 * gaussians.sh.shape[1])
        self.geometry = ctx.buffer(shape) if self.count else ctx.buffer(reserve=44)
        self.coefficients = ctx.buffer(packed) if self.count else ctx.buffer(reserve=16 * self.vectors)
        self._thread = ThreadPoolExecutor(1, "depth-order")
        self._order = np.zeros(0, np.uint32)
        self._order_key: tuple[object, ...] | None = None
        self._pending: tuple[tuple[object, ...], Future[NDArray[np.uint32]]] | None = None

    @property
    def sorting(self) -> bool:
        """Whether the last frame was drawn in the order of an earlier camera: draw again when convenient."""
        return self._pending is not None

    def draw(self, camera: Camera, targets: Accumulators, wait: bool) -> None:
        """Fills the accumulators' `splats` (premultiplied colour, opacity) and `distances` (depth by weight)."""
        view = View(camera, self.centre, 1.0)
        rows = self._ordered(view, wait)
        targets.classic_fbo.use()
        targets.classic_fbo.clear()
        if not len(rows):
            return
        orthographic = int(camera.orthographic)
        defines = {"SH_DEGREE": self.degree, "SH_VECTORS": self.vectors, "CLASSIC": 1, "ORTHOGRAPHIC": orthographic}
        program = self.programs.get("project.vert.glsl", None, defines, varyings=RECORD)
        write_uniforms(program, {**view.uniforms, "enlarge": 1.0})
        self.pool.write_indices(rows)
        shape = {"mean": 3, "scale": 3, "quat": 4, "opacity": 1}
        streams = ((self.geometry, shape), (self.coefficients, {"sh": 4 * self.vectors}))
        batch = self.pool.take()
        batch.fill(self.pool.source(program, *streams), RECORD, 0, len(rows))
        defines = {"CLASSIC": 1, "ORTHOGRAPHIC": orthographic}
        program = self.programs.get("splat.vert.glsl", "classic.frag.glsl", defines)
        write_uniforms(program, view.uniforms)
        self.ctx.enable_only(moderngl.BLEND)
        self.ctx.blend_func = moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE
        batch.draw(program, RECORD, points=False)

    def _ordered(self, view: View, wait: bool) -> NDArray[np.uint32]:
        """Rows, nearest first: for this camera if `wait` or there is no order yet, else in the newest order."""
        cam = camera_record(view.camera)
        cam = cam._replace(translation=tuple(view.matrix[:3, 3].tolist()))
        key = cam.rotation, cam.translation, cam.orthographic, cam.near
        if self._pending is not None and (self._pending[1].done() or wait):
            self._order_key, self._order = self._pending[0], self._pending[1].result()
            self._pending = None
        if key != self._order_key and self._pending is None:
            self._pending = (key, self._thread.submit(self._sort, cam))
            if wait or self._order_key is None:
                self._order_key, self._order = key, self._pending[1].result()
                self._pending = None
        return self._order

    def _sort(self, cam: CameraRecord) -> NDArray[np.uint32]:
        return depth_order(cam, self.means).astype(np.uint32)

    def release(self) -> None:
        """Ends the thread and frees the buffers."""
        self._thread.shutdown()
        self.pool.clear_sources()
        self.geometry.release()
        self.coefficients.release()


def resolve_values(targets: Accumulators, background: NDArray[np.float64]) -> dict[str, Any]:
    """Uniforms of shaders/classic_resolve.frag.glsl."""
    return {"lights@0": targets.splats, "distances@1": targets.distances, "background": tuple(background)}
