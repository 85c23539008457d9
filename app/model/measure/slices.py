"""Three perpendicular planes through one point, and the views straight onto them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from app.model.camera_control import ray
from app.model.rigid_transform import Vec3, vec3
from engine.scene.camera import Camera, equator, section
from engine.scene.plane import Plane

__all__ = ["SLICES", "Slices"]

SLICES = ("Top", "Front", "Right")
"""The faces, named by where they are seen from: above, the front and the right, as in the views of the whole object."""

STEP = 0.01
"""How far a plane moves per step of the wheel, in radii of the object: about the distance between two atoms at
standard detail."""

FILLED = 0.46
"""Part of a view's shorter side that the object's radius takes up: all of it is seen, with a little room around it."""

NEAREST, FARTHEST = 40.0, 0.5
"""Greatest and least zoom."""

Point = tuple[float, float]
"""A point of a view, in the window's units from its upper left corner."""


@dataclass(frozen=True)
class Slices:
    """The three planes of an object and their views, all at the same scale."""

    up: Vec3
    centre: Vec3
    """Centre of the object, world units."""
    radius: float
    """Radius of the object, world units. Range (0, inf)."""
    cross: Vec3
    """The point where the three planes cross, object space."""
    target: Vec3
    """The point that the middle of each view shows, object space; each view uses its projection onto its plane."""
    zoom: float = 1.0
    """Magnification; at 1 all of the object is seen."""

    @property
    def planes(self) -> tuple[Plane, Plane, Plane]:
        """The planes in the order of SLICES; what is in front of a face is on the removed side."""
        up = np.asarray(self.up)
        e1, e2 = equator(up)
        top, front, right = (Plane.through(self.cross, normal) for normal in (up, -e2, e1))
        return top, front, right

    def camera(self, index: int, size: tuple[int, int], scale: float = 1.0) -> Camera:
        """The camera straight onto a face, for a view of this size in window units; `scale`: pixels per unit."""
        bounds = np.asarray(self.centre) + self.radius * np.array([[-1.0], [1.0]])
        made = section(self.planes[index], self.up, bounds, 2)
        width, height = (max(1, round(side * scale)) for side in size)
        unit = FILLED * min(width, height) * self.zoom / self.radius
        x, y, _ = (made.viewmat @ (*self.target, 1.0))[:3]
        return replace(
            made, fx=unit, fy=unit, cx=width / 2 - unit * x, cy=height / 2 - unit * y, width=width, height=height
        )

    def point(self, index: int, size: tuple[int, int], at: Point) -> NDArray[np.float64]:
        """(3,). The point of a face at a point of its view, object space."""
        return on_plane(self.camera(index, size), self.planes[index], at)

    def place(self, index: int, size: tuple[int, int], point: NDArray[np.float64] | Vec3) -> Point:
        """Where a view shows a point (3,) of object space, as seen along the plane's normal."""
        camera = self.camera(index, size)
        x, y, _ = (camera.viewmat @ (*point, 1.0))[:3]
        return float(camera.fx * x + camera.cx), float(camera.fy * y + camera.cy)

    def moved_to(self, point: NDArray[np.float64]) -> Slices:
        """With the planes through a point (3,), which is kept inside the sphere around the object."""
        away = np.asarray(point, np.float64) - self.centre
        length = float(np.linalg.norm(away))
        if length > self.radius:
            away *= self.radius / length
        return replace(self, cross=vec3(np.asarray(self.centre) + away))

    def stepped(self, index: int, steps: float) -> Slices:
        """With one plane moved along its normal, towards the viewer for positive steps."""
        normal = np.asarray(self.planes[index].normal)
        along = float(normal @ (np.asarray(self.cross) - self.centre)) + steps * STEP * self.radius
        if abs(along) > self.radius:  # stops at the end rather than slide along the sphere
            return self
        return replace(self, cross=vec3(np.asarray(self.cross) + steps * STEP * self.radius * normal))

    def zoomed(self, index: int, size: tuple[int, int], at: Point, steps: float) -> Slices:
        """Zoomed in by steps of the wheel; what is at a point of this view stays there."""
        zoom = float(np.clip(self.zoom * 1.15**steps, FARTHEST, NEAREST))
        before = self.point(index, size, at)
        nearer = replace(self, zoom=zoom)
        return replace(nearer, target=vec3(np.asarray(self.target) + before - nearer.point(index, size, at)))

    def panned(self, index: int, size: tuple[int, int], start: Point, end: Point) -> Slices:
        """After a drag in a view, which takes the picture along."""
        by = self.point(index, size, start) - self.point(index, size, end)
        return replace(self, target=vec3(np.asarray(self.target) + by))


def on_plane(camera: Camera, plane: Plane, at: Point) -> NDArray[np.float64]:
    """(3,). The point of a plane that an orthographic camera looking along its normal shows at a point of its view."""
    point, _ = ray(camera, at)
    return np.asarray(point - np.asarray(plane.normal) * float(plane.distance(point)))
