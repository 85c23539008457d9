"""Which of a piece's skin atoms a view can see, and how each has to be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import no_culling
from engine.render.culling.chunks import classify
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.store import Ellipsoids
from engine.render.culling.view import View

__all__ = ["visible_atoms"]


def visible_atoms(
    view: View,
    pieces: Sequence[NDArray[np.float64]],
    splats: Ellipsoids,
    options: DrawOptions,
) -> list[tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]]:
    """For each piece: indices of the atoms that no plane touches, of those that a plane clips, and of those visible
    only through a hole in the skin in front of them (no plane touches these either)."""
    chunks, enlarge = splats.chunks, options.disc_scale
    seen = view.visible_chunks(chunks, enlarge)
    if not options.cull:
        seen = np.ones_like(seen)
    # A splat ends at three sigma, plus what the low-pass adds, which grows with depth.
    deepest = chunks.middle @ view.matrix[2, :3] + view.matrix[2, 3] + np.linalg.norm(chunks.half, axis=1)
    widened = 4 * view.footprint(deepest)
    count = -(-chunks.count // 2**options.level)
    reach = splats.reach * np.float32(enlarge) + np.repeat(widened.astype(np.float32), chunks.count)
    culling = splats.culling if options.cull else no_culling(len(splats))
    farthest = view.footprint(np.array([view.matrix[2, 3] + view.radius]))
    cones = culling.cones(None if view.camera.orthographic else view.eye, float(farthest[0]))
    eye = view.eye.astype(np.float32)
    result = []
    for planes in pieces:
        kept = seen.copy()
        for plane in planes:
            kept &= chunks.distances(plane[:3], plane[3])[:, 0] <= 3 * chunks.sigma * enlarge + widened
        planes_32 = planes.astype(np.float32)
        result.append(
            classify(
                splats.means, reach, chunks.first[kept], count[kept], planes_32, eye, view.camera.orthographic, cones
            )
        )
    return result
