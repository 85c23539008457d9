"""A solid: depth and colour as functions over 3-D space, the ground truth of every cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scene.camera import Camera, section, spread_directions
from engine.scene.plane import Plane
from training.families import Kind

__all__ = ["Solid"]

Field = Callable[[NDArray[np.float64]], NDArray[np.float32]]

BLOCK = 1 << 18
"""Points sampled at once: bounds the memory of a supersampled slice."""


@dataclass(frozen=True)
class Solid:
    """A body with a known inside. The longest side is about 2 world units, centred near the origin."""

    name: str
    families: tuple[Kind, ...]
    """The kinds of its exemplars."""
    skin_depth: Field
    """(M, 3) float64 -> (M,): the depth under the skin."""
    skin_colour: Field
    """(M, 3) float64 -> (M, 3): the colour."""
    bounds: NDArray[np.float64]
    """(2, 3). Lowest and highest corner, world units."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """The up axis, a unit vector."""

    @staticmethod
    def of(name: str, families: tuple[Kind, ...], skin_depth: Field, skin_colour: Field) -> Solid:
        """A solid whose bounds are measured on its skin, in 8192 directions from the origin."""
        solid = Solid(name, families, skin_depth, skin_colour, np.zeros((2, 3)))
        points = solid.skin_points(spread_directions(8192))
        return Solid(name, families, skin_depth, skin_colour, np.stack([points.min(0), points.max(0)]))

    def depth(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(...). Distance under the skin of points (..., 3), world units; exact to first order at the skin.

        Positive inside. Deep inside it only grows monotonically with depth.
        """
        flat = np.ascontiguousarray(np.reshape(points, (-1, 3)), np.float64)
        return self.skin_depth(flat).reshape(np.shape(points)[:-1])

    def colour(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """(..., 3). RGB of points (..., 3) inside, in [0, 1]; outside, the colour of the skin continues."""
        flat = np.ascontiguousarray(np.reshape(points, (-1, 3)), np.float64)
        return self.skin_colour(flat).reshape(np.shape(points))

    def skin_points(self, rays: NDArray[np.floating]) -> NDArray[np.float64]:
        """(M, 3). Where rays from the origin in unit directions (M, 3) leave the solid, to 1e-6.

        By regula falsi with the Illinois modification: as robust as bisection with a third of its evaluations.
        """
        low, high = np.zeros(len(rays)), np.full(len(rays), 2.0)
        inner, outer = self.depth(low[:, None] * rays).astype(float), self.depth(high[:, None] * rays).astype(float)
        kept = np.zeros(len(rays))
        radius = low
        for _ in range(40):
            radius = low + (high - low) * inner / (inner - outer)
            depth = self.depth(radius[:, None] * rays).astype(float)
            if np.abs(depth).max(initial=0.0) < 3e-7:
                break
            inside = depth > 0
            low, high = np.where(inside, radius, low), np.where(inside, high, radius)
            # An end kept twice in a row counts half (Illinois), or it would never move.
            outer = np.where(inside, np.where(kept > 0, outer / 2, outer), depth)
            inner = np.where(inside, depth, np.where(kept < 0, inner / 2, inner))
            kept = np.where(inside, 1.0, -1.0)
        return rays * radius[:, None]

    def normals(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """(M, 3). Unit normals out of the solid at skin points (M, 3), by central differences of the depth."""
        step = 2e-3 * np.eye(3)
        slopes = [self.depth(points - e).astype(np.float64) - self.depth(points + e) for e in step]
        normals = np.stack(slopes, axis=-1)
        return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)

    def slice(
        self, plane: Plane, view: Camera | int, *, supersample: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """The cut face itself: RGB (H, W, 3) over white, and the silhouette (H, W) at pixel centres.

        `view` is a camera, or the side in pixels of a square picture taken straight on (`engine.scene.camera.section`).
        supersample s averages s x s points per pixel; at 1 the colours are exactly those of the pixel centres.
        """
        camera = section(plane, self.up, self.bounds, view) if isinstance(view, int) else view
        rgb = np.zeros((camera.height * camera.width, 3))
        cover = np.zeros(camera.height * camera.width)
        offsets = (np.arange(supersample) + 0.5) / supersample
        for oy in offsets:
            for ox in offsets:
                points, index = self._face(plane, camera, ox, oy)
                for start in range(0, len(index), BLOCK):
                    part = slice(start, start + BLOCK)
                    rgb[index[part]] += self.colour(points[part])
                cover[index] += 1
        rgb, cover = rgb / supersample**2, cover / supersample**2
        picture = (rgb + (1 - cover[:, None])).astype(np.float32)
        return picture.reshape(camera.height, camera.width, 3), self.silhouette(plane, camera)

    def silhouette(self, plane: Plane, camera: Camera) -> NDArray[np.bool_]:
        """(H, W). Pixels whose centre shows the cut face."""
        inside = np.zeros(camera.height * camera.width, bool)
        inside[self._face(plane, camera, 0.5, 0.5)[1]] = True
        return inside.reshape(camera.height, camera.width)

    def _face(self, plane: Plane, camera: Camera, ox: float, oy: float) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Points (M, 3) of the face at offset (ox, oy) in their pixels, and the flat indices of the pixels (M,)."""
        rows, columns = np.divmod(np.arange(camera.height * camera.width), camera.width)
        points, seen = _hits(plane, camera, columns + ox, rows + oy)
        index = np.flatnonzero(seen)
        index = index[self.depth(points[index]) > 0]
        return points[index], index


def _hits(
    plane: Plane, camera: Camera, x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Where the rays of picture points x, y (M,) in pixels meet the plane: points (M, 3), and whether they do (M,)."""
    a, b = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    turn = camera.viewmat[:3, :3].T
    if camera.orthographic:
        origins = np.stack([a, b, np.zeros_like(a)], axis=-1) @ turn.T + camera.position
        rays = np.broadcast_to(camera.forward, origins.shape)
    else:
        origins = np.broadcast_to(camera.position, (len(a), 3))
        rays = np.stack([a, b, np.ones_like(a)], axis=-1) @ turn.T
    speed = rays @ np.asarray(plane.normal)
    seen = np.abs(speed) > 1e-12
    depth = -plane.distance(origins) / np.where(seen, speed, 1.0)
    if not camera.orthographic:
        seen &= depth > camera.near
    return origins + depth[:, None] * rays, seen
