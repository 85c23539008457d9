"""Finds atoms in front of what a capture shows: veils and fringes, which are see-through when composited.

The surface of a capture is the median depth of a picture, where half of the light is stopped; outside its outline there
is none. An opaque atom in front of that surface, in more of its pixels than not, hides what the capture shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.cpu.outside import tiled_splats
from engine.render.cpu.splats import DEPTH, DEPTH_EXTENT, TILE, WEIGHT, Splats
from engine.render.cpu.tiles import AREA, TileRays, fill_rays, fragments, rows_of
from engine.render.cpu.weights import falloff
from engine.scene.atoms import SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.constants import CUTOFF_Q
from engine.scene.piece import Piece
from engine.threads import for_each

__all__ = ["share_in_front"]

SLACK = 1.5
"""Pitches in front of the median depth at which an atom still belongs to the surface: the depth of the layer within
which the opaque image blends its atoms."""

BANDS = 4
"""Parts of a picture that are summed separately, then added up. Fixed, so that the number of threads does not change
the bits."""


def share_in_front(
    surface: SurfaceAtoms, pitch: float, cameras: Sequence[Camera], medians: Sequence[NDArray[np.float32]]
) -> NDArray[np.float32]:
    """(S,). Share of each atom's weight, at the capture's surface or in front, that is in front of it. Range [0, 1].

    The surface is given by the median depth (H, W) of the capture from each of the cameras. Weight behind it is not
    counted; an atom that is behind it in all views has 0.
    """
    splats = Splats(surface.means, surface.scales, surface.quats)
    sums = np.zeros((len(surface), 2), np.float64)
    for camera, median in zip(cameras, medians, strict=True):
        tiled = tiled_splats(splats, camera, [Piece()], pitch)
        parts = np.zeros((BANDS, len(surface), 2), np.float32)
        for_each(_count, BANDS, tiled, median, np.float32(SLACK * pitch), parts)
        sums += parts.sum(0)
    total = sums.sum(1)
    return np.where(total > 0, sums[:, 0] / np.maximum(total, 1e-12), 0).astype(np.float32)


@njit(cache=True, error_model="numpy", nogil=True)
def _count(band, tiled, median, slack, parts):
    """Adds each splat's weight in front of the median depth (H, W), and at it, to one of parts (BANDS, N, 2)."""
    height, width = median.shape
    out = parts[band]
    records, spans = tiled.records, tiled.spans
    kind = records.dtype.type
    near, lane = kind(tiled.cam.near), np.empty((4, AREA), kind)
    h, z = lane[2], lane[3]
    base, slope = np.empty((len(tiled.planes), AREA), kind), np.empty((len(tiled.planes), AREA), kind)
    rays = TileRays(lane.reshape(-1), base, slope)
    cutoff = kind(0.5 * CUTOFF_Q)
    for tile in range(band, len(tiled.tile_starts) - 1, len(parts)):
        left, top = tile % tiled.columns * TILE, tile // tiled.columns * TILE
        fill_rays(tiled, tile, rays)
        last = -kind(np.inf)
        for y in range(top, min(top + TILE, height)):
            for x in range(left, min(left + TILE, width)):
                last = max(last, median[y, x] + slack)
        for pair in range(tiled.tile_starts[tile], tiled.tile_starts[tile + 1]):
            i = tiled.splat_ids[pair]
            if records[i, DEPTH] - records[i, DEPTH_EXTENT] > last:  # the far side
                continue
            start, end = rows_of(records, i, math.sqrt(CUTOFF_Q), left, top)
            if start == end:
                continue
            fragments(records, i, spans[i, 4], spans[i, 5], near, rays, start, end)
            for k in range(start, end):
                x, y = left + k % TILE, top + k // TILE
                if h[k] > cutoff or x >= width or y >= height:
                    continue
                if z[k] < median[y, x] - slack:
                    out[i, 0] += falloff(h[k]) * records[i, WEIGHT]
                elif z[k] <= median[y, x] + slack:
                    out[i, 1] += falloff(h[k]) * records[i, WEIGHT]
