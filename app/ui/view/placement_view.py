"""Shows where a picture goes before any training: the object opened at the picture's own plane, with the picture on the
face."""

from __future__ import annotations

import time

import numpy as np
from imgui_bundle import ImVec2, imgui

from app.model.camera_control import OrbitCamera
from app.model.rigid_transform import vec3
from app.session.face_controller import OpenFace
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px, rgb, u32
from app.ui.view.painter import REST, Painter
from engine.render.gl.overlay import PictureSheet
from engine.scene.piece import Piece
from training.families import Kind
from training.priors.exemplar.placement import OwnPlane

__all__ = ["PlacementView"]

TILT, TURN = 24.0, 14.0
"""Degrees by which the face is at first seen obliquely, so that the object around it is visible, too."""


class PlacementView:
    """Draws one picture's placement with a camera of its own, which a drag turns."""

    def __init__(self, session: Session, painter: Painter) -> None:
        self.session, self.painter = session, painter
        self._eye: OrbitCamera | None = None
        self._seen: Kind | None = None
        """The kind of cut that the camera was turned to."""
        self._moved = -10.0
        self.low, self.size = ImVec2(0, 0), ImVec2(1, 1)
        """Top left corner and size on the screen."""

    def forget(self) -> None:
        """Forgets the camera, so that the next picture is seen from the front again."""
        self._eye = self._seen = None

    def show(self, face: OpenFace, size: ImVec2) -> None:
        """Draws one frame, from the cursor on."""
        low = imgui.get_cursor_screen_pos()
        self.low, self.size = low, size
        high = ImVec2(low.x + size.x, low.y + size.y)
        draw = imgui.get_window_draw_list()
        draw.add_rect_filled(low, high, u32(palette().view), px(5))
        imgui.invisible_button("##placement", size)
        placed = face.placed
        words = ""
        if self.session.atoms is None:
            words = _("It is shown here as soon as the object is solid.")
        elif face.found is None or face.marks.outline is None:
            words = ""
        elif placed is None:
            words = _("Placing the picture...")
        elif placed.problem:
            words = placed.problem.capitalize() + "."
        if words or placed is None or placed.plane is None or placed.rgba is None:
            _centred(draw, low, high, words)
            return
        self._orbit(placed.plane, size)
        assert self._eye is not None
        session = self.session
        scale = float(imgui.get_io().display_framebuffer_scale.x) or 1.0
        camera = self._eye.camera(max(16, round(size.x * scale)), max(16, round(size.y * scale)), session.up)
        solid = list(session.solids).index(session.document.number)
        piece = Piece((placed.plane.plane,), solid=solid)
        sheet = PictureSheet(placed.plane.corners, placed.rgba)
        moving = time.monotonic() - self._moved < REST
        texture = self.painter.frame(session, camera, [piece], rgb(palette().view), [sheet], moving)
        if texture is not None:
            draw.add_image(imgui.ImTextureRef(texture.glo), low, high)

    def _orbit(self, plane: OwnPlane, size: ImVec2) -> None:
        """Turns the camera with the pointer, or to the face if that is a new one."""
        session, io = self.session, imgui.get_io()
        if self._eye is None or self._seen != plane.kind:
            eye = session.viewing.eye.along(plane.plane.normal, session.up)
            level = plane.kind == "horizontal"
            elevation = 90 - TILT if level else eye.elevation + TILT / 2
            azimuth = -90.0 if level else eye.azimuth - TURN
            eye = OrbitCamera(azimuth=azimuth, elevation=float(np.clip(elevation, -90, 90)), fov=eye.fov)
            reach = float(np.linalg.norm(plane.corners[0] - plane.centre)) / 2**0.5
            self._eye = eye.fitted(vec3(plane.centre), 1.05 * reach, size.x / max(size.y, 1))
            self._seen, self._moved = plane.kind, time.monotonic()
        before = self._eye
        if imgui.is_item_active() and (io.mouse_delta.x or io.mouse_delta.y):
            self._eye = self._eye.turned(io.mouse_delta.x, io.mouse_delta.y)
        if imgui.is_item_hovered() and io.mouse_wheel:
            at = io.mouse_pos.x - imgui.get_item_rect_min().x, io.mouse_pos.y - imgui.get_item_rect_min().y
            self._eye = self._eye.zoomed(
                io.mouse_wheel, at, (round(size.x), round(size.y)), session.up, session.solid.radius
            )
        if self._eye != before:
            self._moved = time.monotonic()


def _centred(draw: imgui.ImDrawList, low: ImVec2, high: ImVec2, words: str) -> None:
    """Draws secondary text in the middle of a rectangle."""
    width = high.x - low.x - px(32)
    text = imgui.calc_text_size(words, wrap_width=width)
    at = ImVec2((low.x + high.x - text.x) / 2, (low.y + high.y - text.y) / 2)
    draw.add_text(imgui.get_font(), imgui.get_font_size(), at, u32(palette().second), words, wrap_width=width)
