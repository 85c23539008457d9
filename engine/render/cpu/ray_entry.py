"""Cut faces: where the rays of a picture enter a convex piece through one of its planes, and how solid it is there.

The laws of face coverage, face light and ray entry are written here once for arrays and kernels; the shaders' version
is compared with them in tests/engine/render/test_look.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from engine.render.projection import CameraRecord
from engine.scene.constants import EDGE_SLOPE, FACE_AMBIENT, FACE_LAMP, FILLED_DENSITY, SOLID_DENSITY
from engine.scene.plane import Plane
from engine.threads import for_each

__all__ = [
    "Hits",
    "PieceBounds",
    "coverage",
    "coverage_of",
    "covered_part",
    "enter",
    "enter_row",
    "face_edge",
    "face_light",
    "facing_of",
    "shade",
    "skin_part",
]


@dataclass(frozen=True)
class Hits:
    """The K pixels whose ray enters the piece through a plane."""

    pixels: NDArray[np.intp]
    """(K,). Flat indices into the picture, ascending."""
    points: NDArray[np.float64]
    """(K, 3). Where the ray enters, in the piece's own space."""
    depth: NDArray[np.float32]
    """(K,). World units along the camera's axis."""
    footprint: NDArray[np.float32]
    """(K,). Size of a pixel there, world units."""
    facing: NDArray[np.float32]
    """(K,). Cosine between the plane's normal and the direction back to the eye. Range (0, 1]."""

    def outside(self, joined: Sequence[Sequence[Plane]], tolerance: float) -> Hits:
        """The hits without those within the tolerance of a joined piece, each given by its planes: the solid continues
        there and has no face."""
        free = np.ones(len(self.pixels), bool)
        for planes in joined:
            touching = np.ones(len(free), bool)
            for plane in planes:
                touching &= plane.distance(self.points) <= tolerance
            free &= ~touching
        return self if free.all() else Hits(*(getattr(self, name.name)[free] for name in fields(self)))


class PieceBounds(NamedTuple):
    """A convex piece and the pieces joined to it, camera space. A named tuple, which numba can read."""

    planes: NDArray[np.float64]
    """(P, 4)."""
    joined: NDArray[np.float64]
    """(M, 4). Planes of all joined pieces; where one touches this piece, the solid continues."""
    first_joined: NDArray[np.int64]
    """(pieces + 1,). Where the planes of each joined piece begin."""
    tolerance: float
    """Distance within which a point touches a joined piece, world units."""


def enter(cam: CameraRecord, planes: NDArray[np.float64]) -> Hits:
    """Rays of a camera into the piece that camera-space planes (P, 4) bound.

    Of the planes that the ray crosses from outside, the last one is where it enters, provided that the point is in
    front of the eye and inside all other planes.
    """
    width, height = int(cam.width), int(cam.height)
    depth, facing = np.empty((height, width)), np.empty((height, width), np.float32)
    bounds = PieceBounds(planes, planes[:0], np.zeros(1, np.int64), 0.0)
    for_each(_enter, height, cam, bounds, depth, facing)
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


def face_edge(footprint: NDArray[np.floating], pitch: float) -> NDArray[np.floating]:
    """(K,). Slope of a pixel's coverage over density: an edge stays one pixel wide, however near it is."""
    return np.maximum(1, pitch / 2 / (EDGE_SLOPE * footprint)) / (2 * SOLID_DENSITY)


def coverage(density: NDArray[np.floating], footprint: NDArray[np.floating], pitch: float) -> NDArray[np.floating]:
    """(K,). Fraction of each pixel that is solid, with the edge where the density is SOLID_DENSITY. Range [0, 1]."""
    return covered_part(density, face_edge(footprint, pitch))


def covered_part(density: Any, edge: Any) -> Any:
    """`coverage` of densities (K,) with slopes `face_edge` (K,), arrays or tensors."""
    return (0.5 + (density - SOLID_DENSITY) * edge).clip(0, 1)


@register_jitable(inline="always")
def coverage_of(density, footprint, edge_sigma):
    """`coverage` of one pixel in float32, for kernels without branches; edge_sigma is half the pitch."""
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    slope, solid, unit = np.float32(EDGE_SLOPE), np.float32(SOLID_DENSITY), np.float32(0.5 / SOLID_DENSITY)
    edge = max(one, edge_sigma / (slope * footprint)) * unit
    return min(max(half + (density - solid) * edge, zero), one)


@register_jitable(inline="always")
def skin_part(interior):
    """Factor on the weights of the skin's atoms in the colour of a face, range [0, 1], from the interior's sum.

    It is 0 where the interior fills the body, so that skin which reaches or lies deeper is not seen through it. A
    sharper law shows the steps of the lattice along the rim.
    """
    one, zero, filled = np.float32(1), np.float32(0), np.float32(FILLED_DENSITY)
    return max(one - interior / filled, zero)


def shade(hits: Hits) -> NDArray[np.float32]:
    """(K,). Brightness under a lamp at the eye. Range [FACE_AMBIENT, 1]."""
    return face_light(hits.facing)


@register_jitable(inline="always")
def face_light(facing):
    """Brightness under a lamp at the eye, from cosines `facing_of` of at least 0; for arrays and kernels."""
    return FACE_AMBIENT + FACE_LAMP * facing


@register_jitable(inline="always")
def facing_of(plane, across, down, orthographic):
    """Cosine between the normal of a camera-space plane (4,) and the direction back along the ray (across, down, 1)."""
    facing = -plane[2]
    if not orthographic:
        facing = -(plane[0] * across + plane[1] * down + plane[2]) / math.sqrt(across * across + down * down + 1.0)
    return facing


@njit(cache=True, error_model="numpy", inline="always")
def enter_row(y, cam, bounds, entry, through, distance, touching):
    """Fills depth `entry` (W,) and plane `through` (W,) where the rays of row y enter a piece; plane -1: nowhere.

    bounds: PieceBounds. `distance` and `touching` (W,) are scratch. Each pass runs over a row without branches, so
    that it compiles to vector instructions.
    """
    planes, joined, first_joined, tolerance = bounds.planes, bounds.joined, bounds.first_joined, bounds.tolerance
    n = len(entry)
    orthographic = cam.orthographic != 0.0
    down = (y + 0.5 - cam.cy) / cam.fy
    entry[:] = -np.inf
    through[:] = -1
    for p in range(len(planes)):
        a, b, c, d = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
        for k in range(n):
            across = a * ((k + 0.5 - cam.cx) / cam.fx) + b * down
            base = across + d if orthographic else d
            along = c if orthographic else across + c
            s = -base / along if along < 0.0 else -np.inf
            through[k] = p if s > entry[k] else through[k]
            entry[k] = max(s, entry[k])
    for k in range(n):
        through[k] = through[k] if entry[k] > cam.near and entry[k] < np.inf else -1
    if len(planes) > 1:
        for p in range(len(planes)):
            a, b, c, d = planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3]
            for k in range(n):
                across = a * ((k + 0.5 - cam.cx) / cam.fx) + b * down
                base = across + d if orthographic else d
                along = c if orthographic else across + c
                # Planes crossed from outside need no test: the last of them decides, and rounding would crack edges.
                out = along >= 0.0 and base + entry[k] * along > 0.0
                through[k] = -1 if out else through[k]
    for m in range(len(first_joined) - 1):
        touching[:] = 1.0
        for p in range(first_joined[m], first_joined[m + 1]):
            a, b, c, d = joined[p, 0], joined[p, 1], joined[p, 2], joined[p, 3]
            for k in range(n):
                across = a * ((k + 0.5 - cam.cx) / cam.fx) + b * down
                distance[k] = across + d + entry[k] * c if orthographic else d + entry[k] * (across + c)
                touching[k] = touching[k] if distance[k] <= tolerance else 0.0
        for k in range(n):
            through[k] = -1 if touching[k] > 0.0 else through[k]


@njit(cache=True, nogil=True, error_model="numpy")
def _enter(row, cam, bounds, depth, facing):
    """Fills a row of the entry's depth (H, W), inf if there is none, and of its `facing_of` (H, W)."""
    width = depth.shape[1]
    through, distance, touching = np.empty(width, np.int32), np.empty(width), np.empty(width)
    entry = depth[row]
    enter_row(row, cam, bounds, entry, through, distance, touching)
    down = (row + 0.5 - cam.cy) / cam.fy
    for k in range(width):
        if through[k] >= 0:
            across = (k + 0.5 - cam.cx) / cam.fx
            facing[row, k] = facing_of(bounds.planes[through[k]], across, down, cam.orthographic != 0.0)
        else:
            entry[k] = np.inf
