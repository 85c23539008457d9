"""Which atoms of a skin a piece can show to a view, and how each has to be drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import nothing_hides
from engine.render.culling.chunks import pick
from engine.render.culling.look import Look
from engine.render.culling.store import Ellipsoids
from engine.render.culling.view import View

__all__ = ["visible_atoms"]


def visible_atoms(
    view: View,
    pieces: Sequence[NDArray[np.float64]],
    splats: Ellipsoids,
    look: Look,
    classes: Sequence[NDArray[np.bool_]],  # [K] each
) -> list[list[tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.uint32]]]]:
    """For each piece and each class of chunks: indices of the atoms that no plane touches, that one clips, and that
    show only where the skin before them has a hole (no plane touches these, either)."""
    chunks, enlarge = splats.chunks, look.disc_scale
    seen, _, _ = view.chunks_seen(chunks, enlarge)
    if not look.cull:
        seen = np.ones_like(seen)
    # A splat is felt three sigma away, and what the low-pass adds, which grows with depth.
    deepest = chunks.middle @ view.matrix[2, :3] + view.matrix[2, 3] + np.linalg.norm(chunks.half, axis=1)
    widened = 4 * view.footprint(deepest)
    count = -(-chunks.count // 2**look.level)
    reach = splats.reach * np.float32(enlarge) + np.repeat(widened.astype(np.float32), chunks.count)
    hide = splats.hiding if look.cull else nothing_hides(len(splats))
    farthest = view.footprint(np.array([view.matrix[2, 3] + view.radius]))
    least = hide.least_at(None if view.camera.orthographic else view.eye, float(farthest[0]))
    eye, low = view.eye.astype(np.float32), hide.low.astype(np.float32)
    found = []
    for planes in pieces:
        kept = seen.copy()
        for plane in planes:
            kept &= chunks.distances(plane[:3], plane[3])[:, 0] <= 3 * chunks.sigma * enlarge + widened
        flat = planes.astype(np.float32)
        found.append(
            [
                pick(
                    splats.means, reach, hide.axes, least, hide.zone, low, np.float32(hide.cell),
                    chunks.first[kept & chosen], count[kept & chosen], flat, eye, view.camera.orthographic,
                )
                for chosen in classes
            ]
        )  # fmt: skip
    return found
