"""A camera as the shaders read it, for one rigid placement of the object, and the bounds of what it can see."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.chunks import Chunks
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.scene.constants import CLAMP_MARGIN, LOW_PASS, NOTHING

__all__ = ["MINUS_INFINITY", "View"]

Double = NDArray[np.float64]

MINUS_INFINITY = -NOTHING
"""Stands for minus infinity in a shader, whose compiler may not support infinities."""

BLUR_REACH = 3 * LOW_PASS**0.5 + 1
"""Pixels that the low-pass adds to a splat's radius, and one for rounding."""


@dataclass(frozen=True)
class View:
    """A camera, and the placement of the object in front of it."""

    camera: Camera
    """The camera in the object's own space."""
    centre: Double
    """(3,). The object's centre: buffers are relative to it, so that scenes far from the origin keep their digits."""
    radius: float
    """Radius around the centre that holds all of the object, splats included."""

    @cached_property
    def matrix(self) -> Double:
        """(4, 4). Centred object space to camera."""
        matrix = self.camera.viewmat.astype(np.float64).copy()
        matrix[:3, 3] += matrix[:3, :3] @ self.centre
        return matrix

    @cached_property
    def eye(self) -> Double:
        """(3,). The eye in centred object space; for an orthographic camera, the viewing direction."""
        rotation = self.matrix[:3, :3]
        return rotation[2].copy() if self.camera.orthographic else -rotation.T @ self.matrix[:3, 3]

    @property
    def near(self) -> float:
        """Least depth that is drawn, world units."""
        return MINUS_INFINITY if self.camera.orthographic else self.camera.near

    @property
    def depth_range(self) -> tuple[float, float]:
        """z0 and 1 / (z1 - z0) of the linear depth buffer."""
        z = float(self.matrix[2, 3])
        return z - self.radius, 1 / (2 * self.radius)

    @cached_property
    def uniforms(self) -> dict[str, Any]:
        """The uniforms of shaders/camera.glsl and project.vert.glsl."""
        c, record = self.camera, camera_record(self.camera)
        return {
            "view": self.matrix.T,
            "lens": (c.fx, c.fy, c.cx, c.cy),
            "size": (float(c.width), float(c.height)),
            "eye": tuple(self.eye),
            "near": self.near,
            "depth_range": self.depth_range,
            "slope_limits": (record.x_low, record.x_high, record.y_low, record.y_high),
        }

    def planes_in_camera(self, planes: Double) -> Double:
        """(P, 4). Planes of centred object space in camera space."""
        normals = planes[:, :3] @ self.matrix[:3, :3].T
        return np.concatenate([normals, (planes[:, 3] - normals @ self.matrix[:3, 3])[:, None]], 1)

    def sees_removed_side(self, planes: Double) -> NDArray[np.bool_]:
        """(P,). Which planes (P, 4) of centred object space can have a visible face: the eye is on the removed side."""
        if self.camera.orthographic:
            return planes[:, :3] @ self.eye < 0
        return planes[:, :3] @ self.eye + planes[:, 3] > 0

    def footprint(self, z: NDArray[np.float64]) -> Double:
        """World units that a pixel spans at depths z; 0 behind the eye."""
        scale = (self.camera.fx * self.camera.fy) ** 0.5
        return np.full_like(z, 1 / scale) if self.camera.orthographic else np.maximum(z, 0) / scale

    def visible_chunks(self, chunks: Chunks, enlarge: float) -> NDArray[np.bool_]:
        """Which chunks (K,) can be visible."""
        c = self.camera
        centre = chunks.middle @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        box = np.linalg.norm(chunks.half, axis=1)
        sigma = chunks.sigma * enlarge
        z = centre[:, 2]
        tilt_x = tilt_y = 0.0
        if not c.orthographic:
            tilt_x = (1 + 2 * CLAMP_MARGIN) * max(c.cx, c.width - c.cx) / c.fx
            tilt_y = (1 + 2 * CLAMP_MARGIN) * max(c.cy, c.height - c.cy) / c.fy
        # A splat's affine extent is 3 sigma f / z * sqrt(1 + slope^2), the slope clamped; the low-pass adds pixels.
        stretch = (1 + tilt_x**2 + tilt_y**2) ** 0.5
        reach = 3 * sigma * stretch
        seen = np.ones(len(z), bool) if c.orthographic else z + box > c.near
        deepest = np.ones(len(z)) if c.orthographic else np.maximum(z + box, 0)
        for f, shift, extent, x in ((c.fx, c.cx, c.width, centre[:, 0]), (c.fy, c.cy, c.height, centre[:, 1])):
            for sign, edge in ((1, shift), (-1, extent - shift)):
                # Signed distance to the picture's edge: in pixels, and for a pinhole camera times depth.
                at = sign * f * x + edge * (1 if c.orthographic else z)
                span = box * (f if c.orthographic else np.hypot(f, edge))
                seen &= at + span >= -(f * reach + BLUR_REACH * deepest)
        return seen

    def extent(self, middle: Double, radius: Double) -> tuple[Double, Double]:
        """(2,), (2,). Least and largest pixel x and y that balls (K, 3), (K,) of centred object space can touch.

        Infinite if a ball is beside or around the eye.
        """
        c = self.camera
        centre = middle @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        z = centre[:, 2]
        if not c.orthographic:
            ahead = z + radius > max(c.near, 0.0)
            if not ahead.any():
                return np.full(2, np.inf), np.full(2, -np.inf)
            if not ahead.all() or (z <= 1.05 * radius).any():
                return np.full(2, -np.inf), np.full(2, np.inf)
        low, high = np.empty(2), np.empty(2)
        for axis, (f, shift) in enumerate(((c.fx, c.cx), (c.fy, c.cy))):
            at = centre[:, axis]
            if c.orthographic:
                low[axis], high[axis] = f * (at - radius).min() + shift, f * (at + radius).max() + shift
                continue
            # A ball is seen between two tangents; with z > r both are ahead.
            angle, half = np.arctan2(at, z), np.arcsin(np.minimum(radius / np.hypot(at, z), 1.0))
            low[axis] = f * np.tan(np.maximum(angle - half, -1.57)).min() + shift
            high[axis] = f * np.tan(np.minimum(angle + half, 1.57)).max() + shift
        return low, high
