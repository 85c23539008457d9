"""Cameras: pinhole, and orthographic for views straight onto a cut plane; directions all around an object.

OpenCV axes: x right, y down, z forward.

Pixel (i, j) covers [i, i+1) x [j, j+1) of the picture; its centre is (i + 0.5, j + 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.scene.plane import Plane

__all__ = [
    "SECTION_WIDTH",
    "Camera",
    "cameras_around",
    "equator",
    "fit_distance",
    "look_at",
    "orbit",
    "plane_points",
    "section",
    "spread_directions",
]

SECTION_WIDTH = 1.02
"""Width of the picture of `section`, in diameters of what it is asked to show."""

GOLDEN_TURN = 3.0 - math.sqrt(5.0)
"""The golden angle in half turns: points that far apart around a spiral are spread most evenly."""


@dataclass(frozen=True)
class Camera:
    """A camera and the size of its picture."""

    viewmat: NDArray[np.float64]
    """(4, 4). World to camera, rigid."""
    fx: float
    """Focal length in pixels; for an orthographic camera, pixels per world unit."""
    fy: float
    cx: float
    """Principal point in pixels, from the left edge of the picture."""
    cy: float
    width: int
    height: int
    orthographic: bool = False
    near: float = 0.01
    """Depth below which nothing is drawn, world units; an orthographic camera ignores it."""

    @property
    def position(self) -> NDArray[np.float64]:
        """(3,). The eye in world coordinates."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    @property
    def forward(self) -> NDArray[np.float64]:
        """(3,). The unit viewing direction in world coordinates."""
        return self.viewmat[2, :3]

    def resized(self, width: int, height: int) -> Camera:
        """The same view in a picture of another size, scaled with its smaller side."""
        zoom = min(width, height) / min(self.width, self.height)
        return Camera(
            self.viewmat,
            self.fx * zoom,
            self.fy * zoom,
            width / 2 + (self.cx - self.width / 2) * zoom,
            height / 2 + (self.cy - self.height / 2) * zoom,
            width,
            height,
            self.orthographic,
            self.near,
        )

    def scaled(self, part: float) -> Camera:
        """The same view with a fraction of the pixels along each side."""
        width, height = (max(16, round(side * part)) for side in (self.width, self.height))
        x, y = width / self.width, height / self.height
        return replace(self, fx=self.fx * x, fy=self.fy * y, cx=self.cx * x, cy=self.cy * y, width=width, height=height)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> NDArray[np.float64]:
    """(4, 4) world-to-camera matrix at eye (3,), looking at target (3,), with up (3,) upwards in the picture.

    If up is parallel to the view, the world axis least along the view takes its place.
    """
    eye, target, up = (np.asarray(v, np.float64) for v in (eye, target, up))
    z = target - eye
    length = float(np.linalg.norm(z))
    z = z / length if length > 0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-9 * max(1.0, float(np.linalg.norm(up))):
        axis = np.zeros(3)
        axis[np.argmin(np.abs(z))] = 1.0
        x = np.cross(z, axis)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, y, z])
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def fit_distance(radius: float, fov_y: float, aspect: float) -> float:
    """Distance at which a sphere of this radius just fits the picture; fov_y in radians, aspect is width / height."""
    half = math.atan(math.tan(fov_y / 2) * min(1.0, aspect))
    return radius / math.sin(half)


def orbit(
    centre: ArrayLike,  # [3]
    up: ArrayLike,  # [3]
    azimuth: float,
    elevation: float,
    distance: float,
    width: int,
    height: int,
    fov_y: float = math.radians(35.0),
) -> Camera:
    """A pinhole camera on a sphere around centre; azimuth and elevation in degrees, elevation towards up.

    Azimuth 0 is the first vector of `equator(up)`; azimuth grows counter-clockwise seen from above.
    """
    axis = np.asarray(up, np.float64)
    axis = axis / np.linalg.norm(axis)
    e1, e2 = equator(axis)
    a, e = math.radians(azimuth), math.radians(elevation)
    direction = math.cos(e) * (math.cos(a) * e1 + math.sin(a) * e2) + math.sin(e) * axis
    # At the poles the up vector turns with the azimuth, so that an orbit over the top does not jump.
    tilt = math.cos(e) * axis - math.sin(e) * (math.cos(a) * e1 + math.sin(a) * e2)
    eye = np.asarray(centre, np.float64) + distance * direction
    focal = height / 2 / math.tan(fov_y / 2)
    return Camera(look_at(eye, centre, tilt), focal, focal, width / 2, height / 2, width, height, near=1e-3 * distance)


def equator(up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors (3,) that span the plane across up and form a right-handed frame with it.

    The first is world x projected into the plane, or world y if up is close to x.
    """
    reference = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e1 = reference - up * (up @ reference)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(up, e1)


def section(
    plane: Plane, up: ArrayLike, bounds: NDArray[np.floating], size: int, radius: float | None = None
) -> Camera:
    """The orthographic camera that looks at a cut face straight on, from the removed side; size x size pixels.

    One rule for all planes: up (3,) points upwards in the picture, or the second vector of `equator(up)` if the plane
    is perpendicular to up. The picture is centred on the projection of the centre of bounds (2, 3) and slightly wider
    than twice the radius (world units; None: half the diagonal of the bounds), so all sections have the same scale.
    """
    n = np.asarray(plane.normal)
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    upward = axis - n * (n @ axis)
    if np.linalg.norm(upward) < 1e-3:
        second = equator(axis)[1]
        upward = second - n * (n @ second)
    upward /= np.linalg.norm(upward)
    low, high = np.asarray(bounds, np.float64)
    centre = (low + high) / 2
    foot = centre - n * float(plane.distance(centre))
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([np.cross(upward, n), -upward, -n])
    diagonal = float(np.linalg.norm(high - low))
    matrix[:3, 3] = -matrix[:3, :3] @ (foot + n * diagonal)
    scale = size / (SECTION_WIDTH * (diagonal if radius is None else 2 * radius))
    return Camera(matrix, scale, scale, size / 2, size / 2, size, size, orthographic=True)


def plane_points(camera: Camera, plane: Plane) -> NDArray[np.float32]:
    """(H, W, 3). Where the ray through each pixel's centre meets the plane, world units; NaN if they are parallel."""
    u = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    x, y = np.meshgrid(u, v)
    rotation, translation = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    if camera.orthographic:
        start = (np.stack([x, y, np.zeros_like(x)], -1) - translation) @ rotation
        direction = np.broadcast_to(camera.forward, start.shape)
    else:
        start = np.broadcast_to(camera.position, (*x.shape, 3))
        direction = np.stack([x, y, np.ones_like(x)], -1) @ rotation
    slope = direction @ np.asarray(plane.normal)
    slope = np.where(np.abs(slope) > 1e-12, slope, np.nan)
    steps = -plane.distance(start) / slope
    return (start + steps[..., None] * direction).astype(np.float32)


def cameras_around(
    centre: ArrayLike,  # [3]
    radius: float,
    up: ArrayLike,  # [3]
    count: int,
    size: int,
    turn: float = 0.0,
) -> list[Camera]:
    """`count` cameras in the `spread_directions` from the centre, z along up; the object fills size x size pixels.

    `turn` in degrees rotates the whole spiral, so that two sets of views share no camera.
    """
    fov = math.radians(35.0)
    distance = fit_distance(radius, fov, 1.0)
    golden = math.degrees(math.pi * GOLDEN_TURN)
    cameras = []
    for index, height in enumerate(spread_directions(count)[:, 2]):
        elevation = math.degrees(math.asin(height))
        cameras.append(orbit(centre, up, turn + golden * index, elevation, distance, size, size, fov))
    return cameras


def spread_directions(count: int, start: float = 0.0) -> NDArray[np.float64]:
    """(count, 3). Unit vectors spread evenly over the sphere along Fibonacci's spiral, by falling z in even steps.

    `start` rotates the spiral about z, in golden angles; with 0, the first vector has y = 0.
    """
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    angle = (index + start) * math.pi * GOLDEN_TURN
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
