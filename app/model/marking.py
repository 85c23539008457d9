"""Shapes that a drag over a view of the capture describes: a box, a ball, a lasso."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from app.model.camera_control import project_points, ray
from app.model.rigid_transform import Motion, vec3
from engine.isolate.selection import MOST_CORNERS, Box, Lasso, Shape, Sphere, View
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians

__all__ = ["MARKERS", "Marker", "box_edges", "shape_of"]

Marker = Literal["box", "sphere", "lasso"]
MARKERS: tuple[Marker, ...] = ("box", "sphere", "lasso")

Point = tuple[float, float]

SHORTEST = 4.0
"""Pixels that a drag must cover: a shorter one is a click."""

POINTER = 8.0
"""Radius around the pointer, in pixels, in which the capture's surface is looked for."""

MARGIN = 0.01
"""Part of the capture's depth by which a box extends in front of and behind it, so that rounding leaves nothing out."""

SURFACE_OPACITY = 0.3
"""Opacity from which a Gaussian is a surface that one can point at."""


def shape_of(marker: Marker, camera: Camera, path: Sequence[Point], capture: Gaussians, depth: float) -> Shape | None:
    """The shape of a drag along `path`, in pixels from the upper left corner; None if it is too short to be one.

    `depth`: along the view, world units, used if nothing of the capture shows how far away the shape is meant to be.
    """
    corners = np.array(path, np.float64)
    if np.ptp(corners, axis=0).max() < SHORTEST:
        return None
    if marker == "lasso":
        return _lasso(camera, corners)
    pixels, depths = project_points(camera, capture.means)
    seen = (capture.opacities >= SURFACE_OPACITY) & (depths > 0)
    if marker == "box":
        return _box(camera, corners[0], corners[-1], pixels, depths, seen, depth)
    return _sphere(camera, corners[0], corners[-1], pixels[seen], depths[seen], depth)


def _lasso(camera: Camera, corners: NDArray[np.float64]) -> Lasso | None:
    if len(corners) > MOST_CORNERS:
        corners = corners[np.linspace(0, len(corners) - 1, MOST_CORNERS).round().astype(int)]
    if len(corners) < 3:
        return None
    half = (camera.width / 2 / camera.fx, camera.height / 2 / camera.fy)
    places = (corners - (camera.cx, camera.cy)) / (camera.width / 2, camera.height / 2)
    view = View(vec3(camera.position), _turn(camera), half, camera.orthographic)
    return Lasso(view, tuple((float(x), float(y)) for x, y in places))


def _box(
    camera: Camera,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    seen: NDArray[np.bool_],
    depth: float,
) -> Box | None:
    """A box through the whole capture that looks like the rectangle from `start` to `end` at the depth of the surface
    seen in it."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    inside = seen & ((pixels >= low) & (pixels <= high)).all(1)
    at = float(np.median(depths[inside])) if inside.any() else depth
    if camera.orthographic:
        at = 1.0
    centre, focal = (camera.cx, camera.cy), (camera.fx, camera.fy)
    a, b = ((corner - centre) / focal * at - camera.viewmat[:2, 3] for corner in (low, high))
    if (a >= b).any():
        return None
    offset = camera.viewmat[2, 3]
    front, back = float(depths.min(initial=at) - offset), float(depths.max(initial=at) - offset)
    front, back = front - MARGIN * (back - front), back + MARGIN * (back - front)
    return Box((float(a[0]), float(a[1]), front), (float(b[0]), float(b[1]), back), _turn(camera))


def _sphere(
    camera: Camera,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    pixels: NDArray[np.float64],
    depths: NDArray[np.float64],
    depth: float,
) -> Sphere:
    """A ball that touches the surface at `start` from behind and whose radius is the length of the drag: a drag from
    the middle of a fruit to its rim gives the fruit. Without a surface there, the centre of the ball is at `depth`."""
    wide = float(np.linalg.norm(end - start)) / camera.fx
    near = depths[np.linalg.norm(pixels - start, axis=1) <= POINTER]
    origin, direction = ray(camera, (float(start[0]), float(start[1])))
    slope = float(direction @ camera.forward)
    if camera.orthographic:
        radius = wide
        at = float(near.min()) + radius if len(near) else depth
    elif len(near):
        wide = min(wide, 0.9)  # a wider one would hold the eye
        radius = float(near.min()) * wide / (1 - wide)
        at = float(near.min()) + radius
    else:
        radius, at = depth * wide, depth
    behind = float((np.asarray(origin) - camera.position) @ camera.forward)
    return Sphere(vec3(origin + direction * (at - behind) / slope), radius)


def box_edges(box: Box) -> NDArray[np.float64]:
    """(12, 2, 3). The edges of a box, world units."""
    axes = Motion(box.turn).rotation
    ends = []
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        for u in (0, 1):
            for v in (0, 1):
                low, high = np.array(box.low), np.array(box.high)
                corner = low.copy()
                corner[others[0]] = (low, high)[u][others[0]]
                corner[others[1]] = (low, high)[v][others[1]]
                far = corner.copy()
                far[axis] = high[axis]
                ends.append((axes @ corner, axes @ far))
    return np.array(ends)


def _turn(camera: Camera) -> tuple[float, float, float, float]:
    """The rotation from the camera's axes to the world's, as a quaternion."""
    place = np.eye(4)
    place[:3, :3] = camera.viewmat[:3, :3].T
    return Motion.of(place).turn
