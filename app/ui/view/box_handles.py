"""Handles on the faces of the box that was drawn last; each can be pulled along its axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.camera_control import project_points
from app.model.marking import box_edges
from app.model.rigid_transform import Motion, vec3
from app.session.session import Session
from app.ui.theme import palette, px, u32
from app.ui.view.plane_lines import lines
from engine.isolate.selection import Box
from engine.render.gl.overlay import Lines
from engine.scene.camera import Camera

__all__ = ["BoxHandles"]

SHORTEST_AXIS = 0.1
"""Least foreshortened length of an axis that has handles, as a part of its full length in the picture: along a line of
sight a pull has no length."""

Face = tuple[int, int]
"""A face of a box: its axis, 0 to 2, and 0 for the low side or 1 for the high side."""


class BoxHandles:
    """Draws the box and its handles; remembers which handle is being pulled."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._pulled: Face | None = None

    def edges(self, scale: float) -> list[Lines]:
        """The edges of the box; none if another shape was drawn last. `scale` as in PlaneLines.families."""
        box = self.session.isolation.last_box
        return [] if box is None else [lines(box_edges(box), palette().accent, 0.9, px(1.2) * scale, 0.35)]

    def show(self, camera: Camera, origin: ImVec2, free: bool) -> bool:
        """Draws one frame; true while a handle is hovered or pulled. `free`: whether the pointer does nothing else."""
        box = self.session.isolation.last_box
        if box is None or not (free or self._pulled):
            self._pulled = None
            return False
        mouse = imgui.get_mouse_pos()
        at = np.array((mouse.x - origin.x, mouse.y - origin.y))
        places, steps = _faces(box, camera)
        nearest = min(places, key=lambda face: float(np.linalg.norm(places[face] - at)), default=None)
        near = nearest is not None and float(np.linalg.norm(places[nearest] - at)) < px(9)
        hovered = self._pulled or (nearest if near else None)
        draw = imgui.get_window_draw_list()
        for face, place in places.items():
            middle = ImVec2(float(place[0] + origin.x), float(place[1] + origin.y))
            draw.add_circle_filled(middle, px(6.5), u32("#000000", 0.35))
            draw.add_circle_filled(middle, px(5), u32(palette().text if face == hovered else palette().accent))
        if self._pulled is None and hovered and imgui.is_mouse_clicked(imgui.MouseButton_.left):
            self._pulled = hovered
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            self._pulled = None
        moved = imgui.get_io().mouse_delta
        if self._pulled in steps and (moved.x or moved.y):
            step = steps[self._pulled]
            shift = float(step @ (moved.x, moved.y) / (step @ step))
            self.session.isolation.reshape(pulled(box, self._pulled, shift))
        return hovered is not None


def pulled(box: Box, face: Face, shift: float) -> Box:
    """The box with one face moved by `shift` world units along its axis, but not past the opposite face."""
    axis, side = face
    low, high = np.array(box.low), np.array(box.high)
    if side:
        high[axis] = max(high[axis] + shift, low[axis])
    else:
        low[axis] = min(low[axis] + shift, high[axis])
    return replace(box, low=vec3(low), high=vec3(high))


def _faces(box: Box, camera: Camera) -> tuple[dict[Face, NDArray[np.float64]], dict[Face, NDArray[np.float64]]]:
    """For each face that can be pulled: its centre (2,) in pixels, and the pixels (2,) by which that moves per world
    unit."""
    axes = Motion(box.turn).rotation
    low, high = np.array(box.low), np.array(box.high)
    places, steps = {}, {}
    for axis in range(3):
        for side, bound in enumerate((low, high)):
            centre = (low + high) / 2
            centre[axis] = bound[axis]
            small = 1e-3 * max(float((high - low).max()), 1e-9)
            ends = np.stack([axes @ centre, axes @ (centre + small * np.eye(3)[axis])])
            pixels, depths = project_points(camera, ends)
            step = (pixels[1] - pixels[0]) / small
            unit = camera.fx if camera.orthographic else camera.fx / max(float(depths[0]), 1e-9)
            if depths.min() > 0 and float(np.linalg.norm(step)) > SHORTEST_AXIS * unit:
                places[axis, side], steps[axis, side] = pixels[0], step
    return places, steps
