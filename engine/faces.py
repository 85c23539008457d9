"""Cut faces: where the rays of a picture enter a convex piece through one of its planes, and how solid it is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.formula import EDGE_SLOPE, FACE_AMBIENT, FACE_LAMP, SOLID_DENSITY
from engine.plane import Plane
from engine.projection import CameraRecord
from engine.threads import for_each

__all__ = ["Hits", "coverage", "enter", "shade"]


@dataclass(frozen=True)
class Hits:
    """The pixels whose ray enters the piece through a plane, K of them."""

    pixels: NDArray[np.intp]
    """(K,). Flat indices into the picture, ascending."""
    points: NDArray[np.float64]
    """(K, 3). Where, in the piece's own space."""
    depth: NDArray[np.float32]
    """(K,). World units along the camera's axis."""
    footprint: NDArray[np.float32]
    """(K,). Size of a pixel there, world units."""
    facing: NDArray[np.float32]
    """(K,). Cosine between the plane's normal and the way back to the eye. Range (0, 1]."""

    def outside(self, joined: Sequence[Sequence[Plane]], tolerance: float) -> Hits:
        """Without those that touch one of the pieces that the planes bound: there the matter goes on."""
        free = np.ones(len(self.pixels), bool)
        for planes in joined:
            touching = np.ones(len(free), bool)
            for plane in planes:
                touching &= plane.distance(self.points) <= tolerance
            free &= ~touching
        return self if free.all() else Hits(*(getattr(self, name.name)[free] for name in fields(self)))


def enter(cam: CameraRecord, planes: NDArray[np.float64]) -> Hits:
    """Rays of a camera into the piece that camera-space planes (P, 4) bound.

    Of the planes whose outside the ray comes from, the last one it passes is where it enters, if that lies before the
    eye and within all other planes.
    """
    width, height = int(cam.width), int(cam.height)
    depth, facing = np.empty((height, width)), np.empty((height, width), np.float32)
    for_each(_enter, height, cam, planes, depth, facing)
    pixels = np.flatnonzero(np.isfinite(depth))
    z = depth.reshape(-1)[pixels]
    x = (pixels % width + 0.5 - cam.cx) / cam.fx
    y = (pixels // width + 0.5 - cam.cy) / cam.fy
    perspective = np.ones_like(z) if cam.orthographic else z
    seen = np.stack([x * perspective, y * perspective, z], 1) - np.array(cam.translation)
    footprint = (perspective / np.sqrt(cam.fx * cam.fy)).astype(np.float32)
    return Hits(
        pixels, seen @ np.array(cam.rotation).reshape(3, 3), z.astype(np.float32), footprint, facing.reshape(-1)[pixels]
    )


def coverage(density: NDArray[np.floating], footprint: NDArray[np.floating], pitch: float) -> NDArray[np.floating]:
    """How much of a pixel (K,) is solid: an edge at the density of solids, one pixel wide however near the eye."""
    edge = np.maximum(1, pitch / 2 / (EDGE_SLOPE * footprint)) / (2 * SOLID_DENSITY)
    return np.clip(0.5 + (density - SOLID_DENSITY) * edge, 0, 1)


def shade(hits: Hits) -> NDArray[np.float32]:
    """(K,). Factor of a lamp at the eye."""
    return FACE_AMBIENT + np.float32(FACE_LAMP) * hits.facing


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(row, cam, planes, depth, facing):  # type: ignore[no-untyped-def]
    """Fills a row of depth (H, W) of the entry, inf where there is none, and of the cosine (H, W) at the plane."""
    orthographic = cam.orthographic != 0.0
    for column in range(depth.shape[1]):
        x, y = (column + 0.5 - cam.cx) / cam.fx, (row + 0.5 - cam.cy) / cam.fy
        entry, through, steep = -np.inf, -1, 0.0
        for p in range(len(planes)):
            a, b, c, d = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
            base, along = (a * x + b * y + d, c) if orthographic else (d, a * x + b * y + c)
            if along < 0.0 and -base / along > entry:
                entry, through, steep = -base / along, p, -along
        found = through >= 0 and entry > cam.near and entry < np.inf
        for p in range(len(planes)):
            a, b, c, d = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
            base, along = (a * x + b * y + d, c) if orthographic else (d, a * x + b * y + c)
            # Planes that the ray enters through lie before the last of them; testing them again would crack edges.
            if along >= 0.0 and base + entry * along > 0.0:
                found = False
        depth[row, column] = entry if found else np.inf
        facing[row, column] = steep / (1.0 if orthographic else np.sqrt(x * x + y * y + 1.0))
