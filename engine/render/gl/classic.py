"""The unchanged capture: sorted alpha compositing (Kerbl et al. 2023), with the depth order computed in a thread.

The camera never waits for the sort: a frame uses the newest order, and `sorting` says whether a newer one is pending.
"""

from __future__ import annotations

import math
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
from engine.render.gl.screen import UNDER, Screen
from engine.render.gl.surface import RECORD
from engine.render.gl.targets import Frame, Layers
from engine.render.projection import CameraRecord, camera_record
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians

__all__ = ["Blending", "Capture"]

Float = NDArray[np.float32]

UPLOAD = 1 << 16
"""Gaussians written at once, 16 MB at most: a large capture is not in memory twice."""

SLABS = 8
"""Slabs in a frame, with equal numbers of Gaussians. On a graphics card (H100, 1280x720) captures of 45 to 115 thousand
take about as long with 4 to 16, a solid melon of a million 27 ms with 8 (29 with 16, 313 in full floats without slabs).
In software, where a pass over all pixels costs more than it saves, there are none."""

PORTION = 1024
"""Gaussians drawn at once in a frame that is drawn gradually, and the fewest in a slab: a few ms where OpenGL runs in
software."""


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
        """Uploads more of the Gaussians for about this time; True once all are uploaded and can be drawn."""
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

    def rows(self, camera: Camera, wait: bool, level: int) -> NDArray[np.uint32]:
        """The rows that are drawn, nearest first.

        `level`: 0 draws every Gaussian; each further level draws half as many, enlarged so that they cover as much.
        """
        rows = self._ordered(View(camera, self.centre, 1.0), wait)
        return rows[rows % (1 << level) == 0] if level else rows

    def add(
        self,
        rows: NDArray[np.uint32],
        camera: Camera,
        layers: Layers,
        slab: tuple[float, float],
        level: int,
        look: SplatLook,
    ) -> None:
        """Draws these rows behind what is already in the slab."""
        view = View(camera, self.centre, 1.0)
        layers.slab_fbo.use()
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
        write_uniforms(program, {**view.uniforms, "slab": slab})
        self.ctx.enable_only(moderngl.BLEND | (moderngl.DEPTH_TEST if layers.slabs else moderngl.NOTHING))
        self.ctx.depth_func = "<"
        self.ctx.blend_func = UNDER
        batch.draw(program, RECORD)

    def _ordered(self, view: View, wait: bool) -> NDArray[np.uint32]:
        """Rows, nearest first: for this camera if `wait`, else in the newest order, which is empty at first."""
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


class Blending:
    """A frame of a capture in progress: its Gaussians are drawn nearest first, slab after slab."""

    def __init__(
        self, capture: Capture, screen: Screen, layers: Layers, camera: Camera, wait: bool, level: int, look: SplatLook
    ) -> None:
        """Empties the layers. `wait`, `level`: as for `Capture.rows`."""
        self.capture, self.screen, self.layers = capture, screen, layers
        self.camera, self.level, self.look = camera, level, look
        self._rows = capture.rows(camera, wait, level)
        self._size = max(PORTION, -(-len(self._rows) // SLABS)) if layers.slabs else max(len(self._rows), 1)
        self._done = 0
        self._slab = 0.0, 1.0
        layers.clear()

    def advance(self, seconds: float = math.inf) -> bool:
        """Draws for about this time; True once the layers hold the whole frame."""
        end = time.perf_counter() + seconds
        while self._done < len(self._rows):
            start, slab_end = self._done, min(self._done - self._done % self._size + self._size, len(self._rows))
            if start % self._size == 0:
                self._begin(start, slab_end)
            self._done = min(start + PORTION, slab_end) if math.isfinite(seconds) else slab_end
            self.capture.pool.begin()
            rows = self._rows[start : self._done]
            self.capture.add(rows, self.camera, self.layers, self._slab, self.level, self.look)
            if self._done == slab_end:
                self._end()
            if math.isfinite(seconds):
                self.capture.ctx.finish()  # otherwise the work would only be queued
                if time.perf_counter() > end:
                    break
        return self._done == len(self._rows)

    def _begin(self, first: int, last: int) -> None:
        """Begins an empty slab, from the depth of row `first` of the order to that of the row before `last`."""
        if self.layers.slabs is None:
            return
        matrix = View(self.camera, self.capture.centre, 1.0).matrix
        near, far = (self.capture.means[self._rows[[first, last - 1]]] @ matrix[2, :3] + matrix[2, 3]).tolist()
        self._slab = near, max(far - near, 1e-6 * abs(near), 1e-30)  # for rows of one depth, or an older order
        self.layers.slab_fbo.clear()

    def _end(self) -> None:
        """Blends the slab under what lies in front of it, and closes the pixels where nothing more shows."""
        if self.layers.slabs is None:
            return
        layers, rect = self.layers, (0, 0, *self.layers.size)
        values = {"lights@0": layers.slab_light, "depths@1": layers.slab_depth, "slab": self._slab}
        self.screen.fill(layers.fbo, rect, "classic_slab.frag.glsl", {}, values, under=True)
        if self._done < len(self._rows):
            self.screen.fill(layers.limit_fbo, rect, "classic_close.frag.glsl", {}, {"lights@0": layers.light})

    def resolve(self, frame: Frame, background: NDArray[np.float64]) -> None:
        """Writes the frame, over a background (3,)."""
        frame.clear(background)
        values: dict[str, Any] = {
            "lights@0": self.layers.light,
            "depths@1": self.layers.depth,
            "background": tuple(background),
        }
        self.screen.fill(frame.fbo, (0, 0, *frame.colour.size), "classic_resolve.frag.glsl", {}, values)
