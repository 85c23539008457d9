"""What the solid hides from a camera: skin behind its core.

The core is all of the body that lies deeper than a skin is thick. A line of sight that enters it meets the inside
there, whatever the skin in front leaves open, so nothing of the skin behind it can be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.render.cpu.outside import draw
from engine.render.cpu.splats import Splats
from engine.render.projection import CameraRecord, camera_point, camera_record, project_point
from engine.scene.camera import Camera
from engine.scene.grid import Body
from engine.scene.piece import Piece
from engine.threads import for_each

__all__ = ["CORE_PITCHES", "CoreView", "core_of", "view_of_core"]

CORE_PITCHES = 1.0
"""Pitches. Depth of the core below the body's surface: atoms of the skin lie no deeper (`engine.solid.atomise`). A core
at half the depth also closes cracks in walls of two pitches, but its outline is too close to the body's: a fit of a
donut loses 0.4 dB, one of a guitar 0.2."""

CORE_SIGMA = 0.6
"""Cells. A splat can be the front up to 1.48 sigmas, so that the splats of cells touching at a corner overlap."""

SIZE = 0.5
"""Side of a core's picture over that of the view: its pixels are still smaller than a pitch, and it costs a quarter."""

CHUNK = 8192
"""Atoms in a task."""


@dataclass(frozen=True)
class CoreView:
    """Where lines of sight from one camera enter the core."""

    camera: CameraRecord
    front: NDArray[np.float32]
    """(H, W). Depth of the core, world units; inf where a pixel shows none."""

    def shown(self, means: NDArray[np.float32]) -> NDArray[np.intp]:
        """Rows of the atoms at means (N, 3) that the core does not hide. Those outside the picture count as shown."""
        hidden = np.empty(len(means), np.bool_)
        for_each(_hidden, -(-len(means) // CHUNK), means, self.camera, self.front, hidden)
        return np.flatnonzero(~hidden)


def core_of(body: Body, pitch: float) -> Splats:
    """Balls in the outermost cells of the core, which together close it; none if all of the body is thin."""
    core = body.depth > CORE_PITCHES * pitch
    # In rows, as all means are: for columns the kernels would be compiled again.
    means = np.ascontiguousarray(body.grid.centres_of(core & ~ndimage.binary_erosion(core)))
    scales = np.full((len(means), 3), CORE_SIGMA * body.grid.cell, np.float32)
    return Splats(means, scales, np.tile(np.array([1, 0, 0, 0], np.float32), (len(means), 1)))


def view_of_core(core: Splats, camera: Camera, pitch: float) -> CoreView:
    """The core from one camera."""
    small = camera.scaled(SIZE)
    outside = draw(core, [np.zeros((len(core.means), 3), np.float32)], small, [Piece()], pitch)
    return CoreView(camera_record(small), outside.front)


@njit(cache=True, error_model="numpy", nogil=True)
def _hidden(chunk, means, cam, front, hidden):
    """Fills a chunk of hidden (N,)."""
    height, width = front.shape
    for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, len(means))):
        hidden[i] = False
        x, y, z = camera_point(cam, means[i, 0], means[i, 1], means[i, 2])
        if z > cam.near:
            u, v = project_point(cam, x, y, z)
            if 0.0 <= u < width and 0.0 <= v < height:
                hidden[i] = z > front[int(v), int(u)]
