"""The orbit camera: orbit, pan, zoom to the cursor, fit and axis views, as functions on frozen data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.model.rigid_transform import Vec3, vec3
from engine.scene.camera import Camera, equator, fit_distance, orbit

__all__ = ["AXIS_VIEWS", "OrbitCamera", "project_points", "ray"]

DEGREES_PER_PIXEL = 0.35
"""A drag across a window of 1000 pixels turns the object once around."""

FIT_MARGIN = 1.12
"""Radius of the sphere that is fitted into the picture, in radii of the object: touching the edges looks cramped."""

# Azimuth and elevation in degrees. Azimuth 0 looks from the first vector of the equator towards the target.
AXIS_VIEWS: dict[str, tuple[float, float]] = {
    "front": (-90.0, 0.0),
    "back": (90.0, 0.0),
    "right": (0.0, 0.0),
    "left": (180.0, 0.0),
    "top": (-90.0, 90.0),
    "bottom": (-90.0, -90.0),
}


@dataclass(frozen=True)
class OrbitCamera:
    """A camera that orbits a target. The up axis belongs to the object, so the methods take it as an argument."""

    target: Vec3 = (0.0, 0.0, 0.0)
    azimuth: float = -60.0
    """Degrees, see `engine.scene.camera.orbit`."""
    elevation: float = 22.0
    """Degrees. Range [-90, 90]."""
    distance: float = 4.0
    """Distance from eye to target, world units. Range (0, inf)."""
    fov: float = 35.0
    """Vertical field of view, degrees. Range [5, 120]."""
    orthographic: bool = False

    def camera(self, width: int, height: int, up: Vec3) -> Camera:
        """The renderers' camera. An orthographic one shows things at the target's depth at the same size."""
        made = orbit(
            self.target, up, self.azimuth, self.elevation, self.distance, width, height, math.radians(self.fov)
        )
        if not self.orthographic:
            return made
        scale = made.fx / self.distance
        return replace(made, fx=scale, fy=scale, orthographic=True)

    def turned(self, dx: float, dy: float) -> OrbitCamera:
        """The camera after an orbiting drag of (dx, dy) pixels: the object follows the pointer."""
        elevation = min(90.0, max(-90.0, self.elevation + dy * DEGREES_PER_PIXEL))
        return replace(self, azimuth=_wrapped(self.azimuth - dx * DEGREES_PER_PIXEL), elevation=elevation)

    def panned(self, dx: float, dy: float, height: int, up: Vec3) -> OrbitCamera:
        """The camera after a panning drag of (dx, dy) pixels in a picture of this height: the target follows the
        pointer."""
        rotation = self.camera(16, 16, up).viewmat[:3, :3]
        unit = 2 * self.distance * math.tan(math.radians(self.fov) / 2) / max(height, 1)
        return replace(self, target=vec3(np.asarray(self.target) - unit * (dx * rotation[0] + dy * rotation[1])))

    def zoomed(
        self, steps: float, at: tuple[float, float], size: tuple[int, int], up: Vec3, radius: float
    ) -> OrbitCamera:
        """The camera moved nearer by `steps` notches of the wheel, towards the point under the cursor at the target's
        depth.

        `at`: the cursor, in pixels of a picture of `size` (width, height). `radius`: the object's, bounds the distance,
        unless that is beyond: an eye on a larger object does not jump.
        """
        least, most = min(0.01 * radius, self.distance), max(200 * radius, self.distance)
        distance = min(most, max(least, self.distance * 0.88**steps))
        camera = self.camera(*size, up)
        start, direction = ray(camera, at)
        forward = camera.forward
        point = start + direction * (((np.asarray(self.target) - start) @ forward) / (direction @ forward))
        part = 1 - distance / self.distance
        target = np.asarray(self.target) + part * (point - np.asarray(self.target))
        return replace(self, target=vec3(target), distance=distance)

    def fitted(self, centre: Sequence[float] | NDArray[np.floating], radius: float, aspect: float = 1.0) -> OrbitCamera:
        """The camera on the same side, at the distance where a sphere just fits the picture."""
        distance = fit_distance(radius * FIT_MARGIN, math.radians(self.fov), aspect)
        return replace(self, target=vec3(centre), distance=distance)

    def from_side(self, view: str) -> OrbitCamera:
        """The camera on the side that a key of AXIS_VIEWS names."""
        azimuth, elevation = AXIS_VIEWS[view]
        return replace(self, azimuth=azimuth, elevation=elevation)

    def along(self, axis: Sequence[float], up: Vec3) -> OrbitCamera:
        """The camera looking at the target from the direction of this axis (3,)."""
        u = np.asarray(up, np.float64)
        e1, e2 = equator(u)
        a = np.asarray(axis, np.float64) / np.linalg.norm(axis)
        elevation = math.degrees(math.asin(float(np.clip(a @ u, -1, 1))))
        if abs(elevation) > 89.9:
            return replace(self, elevation=math.copysign(90.0, elevation))
        return replace(self, azimuth=math.degrees(math.atan2(float(a @ e2), float(a @ e1))), elevation=elevation)

    def turned_with(
        self, turn: NDArray[np.float64], centre: Sequence[float] | NDArray[np.floating], up: Vec3
    ) -> OrbitCamera:
        """The camera that sees the object as if it had been turned by a rotation (3, 3) about a point (3,).

        The object stays where it is, and its up axis becomes `turn.T @ up`, which the new camera is to be used with.
        """
        before, after = equator(np.asarray(up, np.float64)), equator(turn.T @ np.asarray(up, np.float64))
        angle = math.radians(self.azimuth)
        heading = turn.T @ (math.cos(angle) * before[0] + math.sin(angle) * before[1])
        azimuth = math.degrees(math.atan2(float(heading @ after[1]), float(heading @ after[0])))
        middle = np.asarray(centre, np.float64)
        target = middle + turn.T @ (np.asarray(self.target) - middle)
        return replace(self, target=vec3(target), azimuth=_wrapped(azimuth))

    def toward(self, goal: OrbitCamera, part: float) -> OrbitCamera:
        """The camera interpolated towards `goal`; a `part` of 1 is the goal itself."""
        if part >= 1:
            return goal

        def mix(a: float, b: float) -> float:
            return a + part * (b - a)

        turn = (goal.azimuth - self.azimuth + 180.0) % 360.0 - 180.0
        x, y, z = (mix(a, b) for a, b in zip(self.target, goal.target, strict=True))
        return replace(
            goal,
            target=(x, y, z),
            azimuth=_wrapped(self.azimuth + part * turn),
            elevation=mix(self.elevation, goal.elevation),
            distance=self.distance * (goal.distance / self.distance) ** part,
        )


def ray(camera: Camera, at: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origin (3,) and unit direction (3,) of the ray through a point `at` of the picture, in pixels."""
    u, v = (at[0] - camera.cx) / camera.fx, (at[1] - camera.cy) / camera.fy
    rotation, translation = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    if camera.orthographic:
        return (np.array([u, v, 0.0]) - translation) @ rotation, camera.forward
    direction = np.array([u, v, 1.0]) @ rotation
    return camera.position, direction / np.linalg.norm(direction)


def project_points(camera: Camera, points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixels (N, 2) and depths (N,) of points (N, 3). Pixels are meaningless where the depth is not above 0."""
    local = np.asarray(points, np.float64) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = local[:, 2]
    scale = np.ones_like(depth) if camera.orthographic else np.where(depth > 1e-12, depth, 1.0)
    x = camera.fx * local[:, 0] / scale + camera.cx
    y = camera.fy * local[:, 1] / scale + camera.cy
    return np.stack([x, y], 1), depth


def _wrapped(degrees: float) -> float:
    """The same angle in [-180, 180)."""
    return (degrees + 180.0) % 360.0 - 180.0
