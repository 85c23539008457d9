"""The unchanged capture: sorted alpha compositing (Kerbl et al. 2023), with the depth order made by a thread.

The camera never waits for the sort: a frame uses the newest order, and `sorting` says whether a newer one is pending.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.classic.depth_order import depth_order
from engine.render.culling.draw_options import SplatLook
from engine.render.culling.view import View
from engine.render.gl.batches import Pool
from engine.render.gl.context import Programs, write_uniforms
from engine.render.gl.surface import RECORD
from engine.render.gl.targets import Accumulators, Frame
from engine.render.projection import CameraRecord, camera_record
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians

__all__ = ["Capture", "GradualFrame"]

Float = NDArray[np.float32]

UPLOAD = 1 << 16
"""Gaussians written at once, 16 MB at most: a large capture is not in memory a second time."""

PORTION = 1024
"""Gaussians drawn at once of a frame that is drawn gradually: some ms where OpenGL runs in software."""


class Capture:
    """N Gaussians on the GPU, and their depth order."""

    def __init__(self, ctx: moderngl.Context, programs: Programs, pool: Pool, gaussians: Gaussians) -> None:
        self.ctx, self.programs, self.pool = ctx, programs, pool
        self.gaussians = gaussians
        self.count = len(gaussians)
        means = gaussians.means
        ends = np.stack([means.min(0), means.max(0)]).astype(np.float64) if self.count else np.zeros((2, 3))
        self.centre = (ends[0] + ends[1]) / 2
        self.means = np.empty((self.count, 3), np.float32)
        self.degree = gaussians.sh_degree
        self.vectors = -(-3 * gaussians.sh.shape[1] // 4)
        self.geometry = ctx.buffer(reserve=44 * max(self.count, 1))
        self.coefficients = ctx.buffer(reserve=16 * self.vectors * max(self.count, 1))
        self._uploaded = 0
        self._thread = ThreadPoolExecutor(1, "depth-order")
        self._order = np.zeros(0, np.uint32)
        self._order_key: tuple[object, ...] | None = None
        self._pending: tuple[tuple[object, ...], Future[NDArray[np.uint32]]] | None = None

    def upload(self, seconds: float) -> bool:
        """Uploads more of the Gaussians for a time; True once all are there, before which nothing can be drawn."""
        end = time.perf_counter() + seconds
        while self._uploaded < self.count:
            last = min(self._uploaded + UPLOAD, self.count)
            self._write(slice(self._uploaded, last))
            self._uploaded = last
            if time.perf_counter() > end:
                break
        return self._uploaded == self.count

    def _write(self, rows: slice) -> None:
        """Writes these rows into the buffers."""
        g = self.gaussians[rows]
        self.means[rows] = g.means - self.centre
        shape = np.concatenate([self.means[rows], g.scales, g.quats, g.opacities[:, None]], 1)
        packed = np.zeros((len(g), 4 * self.vectors), np.float32)
        packed[:, : 3 * g.sh.shape[1]] = g.sh.reshape(len(g), -1)
        self.geometry.write(shape, offset=44 * rows.start)
        self.coefficients.write(packed, offset=16 * self.vectors * rows.start)

    @property
    def sorting(self) -> bool:
        """Whether the last frame was drawn in the order of an earlier camera: draw again when convenient."""
        return self._pending is not None

    def draw(self, camera: Camera, targets: Accumulators, wait: bool, level: int, look: SplatLook) -> None:
        """Fills the accumulators' `splats` (premultiplied colour, opacity) and `distances` (depth by weight).

        `level`: 0 draws every Gaussian; each further one half as many, enlarged so that they cover as much.
        """
        rows = self.rows(camera, wait, level)
        targets.classic_fbo.use()
        targets.classic_fbo.clear()
        self.add(rows, camera, targets, level, look)

    def rows(self, camera: Camera, wait: bool, level: int) -> NDArray[np.uint32]:
        """What is drawn, nearest first; arguments as in `draw`."""
        rows = self._ordered(View(camera, self.centre, 1.0), wait)
        return rows[rows % (1 << level) == 0] if level else rows

    def add(self, rows: NDArray[np.uint32], camera: Camera, targets: Accumulators, level: int, look: SplatLook) -> None:
        """Draws these rows behind what the targets have."""
        if not len(rows):
            return
        view = View(camera, self.centre, 1.0)
        targets.classic_fbo.use()
        orthographic = int(camera.orthographic)
        defines = {"SH_DEGREE": self.degree, "SH_VECTORS": self.vectors, "CLASSIC": 1, "ORTHOGRAPHIC": orthographic}
        program = self.programs.get("project.vert.glsl", None, defines, varyings=RECORD)
        write_uniforms(program, {**view.uniforms, "enlarge": look.size * 2.0 ** (level / 2), "strength": look.opacity})
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
        batch.draw(program, RECORD)

    def _ordered(self, view: View, wait: bool) -> NDArray[np.uint32]:
        """Rows, nearest first: for this camera if `wait`, else in the newest order, which is none at first."""
        cam = camera_record(view.camera)
        cam = cam._replace(translation=tuple(view.matrix[:3, 3].tolist()))
        key = cam.rotation, cam.translation, cam.orthographic, cam.near
        if self._pending is not None and (self._pending[1].done() or wait):
            self._order_key, self._order = self._pending[0], self._pending[1].result()
            self._pending = None
        if key != self._order_key and self._pending is None:
            self._pending = (key, self._thread.submit(self._sort, cam))
            if wait:
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


class GradualFrame:
    """A frame of a capture drawn nearest first, a part of it at a time, beside the frame that is shown meanwhile."""

    def __init__(self, capture: Capture, camera: Camera, level: int, look: SplatLook) -> None:
        self.capture, self.camera, self.level, self.look = capture, camera, level, look
        self.frame = Frame(capture.ctx, camera.width, camera.height)
        self.sums = Accumulators(capture.ctx, camera.width, camera.height)
        self._rows = capture.rows(camera, True, level)
        self.sums.classic_fbo.use()
        self.sums.classic_fbo.clear()

    def advance(self, seconds: float) -> bool:
        """Draws for a time; True once the accumulators have all of it."""
        end = time.perf_counter() + seconds
        while len(self._rows):
            self.capture.pool.begin()
            self.capture.add(self._rows[:PORTION], self.camera, self.sums, self.level, self.look)
            self._rows = self._rows[PORTION:]
            self.capture.ctx.finish()  # otherwise the work would only be queued
            if time.perf_counter() > end:
                break
        return not len(self._rows)

    def release(self) -> None:
        """Frees the textures."""
        self.frame.release()
        self.sums.release()


def resolve_values(targets: Accumulators, background: NDArray[np.float64]) -> dict[str, Any]:
    """Uniforms of shaders/classic_resolve.frag.glsl."""
    return {"lights@0": targets.splats, "distances@1": targets.distances, "background": tuple(background)}
