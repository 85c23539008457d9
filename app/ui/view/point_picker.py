"""Picks three points on the object by clicks, for a plane through them."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.camera_control import project_points
from app.model.knife import plane_through
from app.model.pieces import Member
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px, u32
from app.ui.view.annotations import label
from engine.scene.camera import Camera

__all__ = ["PointPicker"]


class PointPicker:
    """Collects the points, then moves the cut."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.cut_id: int | None = None
        """The cut that is to go through the points; None while none are picked."""
        self.points: list[NDArray[np.float64]] = []
        """The points picked so far, each (3,), in object space."""
        self._seen: list[NDArray[np.float64]] = []
        """The same points in world space."""

    def begin(self, cut_id: int) -> None:
        """Starts picking: from now on, clicks on the object are points."""
        self.cut_id, self.points, self._seen = cut_id, [], []
        self.session.select_tool("select")
        self.session.notify(_("Click three points on the object. Esc: leave the plane as it is."))

    def cancel(self) -> None:
        """Ends picking: clicks select again."""
        self.cut_id, self.points, self._seen = None, [], []

    def click(self, member: Member | None, point: NDArray[np.float64] | None) -> None:
        """Handles a click on a piece, at a world point (3,)."""
        session = self.session
        if member is None or point is None or member.index != session.active:
            session.notify(_("Click on the object."))
            return
        self.points.append(member.piece.motion.inverse().apply(point))
        self._seen.append(point)
        if len(self.points) < 3:
            return
        plane, cut_id = plane_through(*self.points), self.cut_id
        self.cancel()
        if plane is None:
            session.notify(_("The three points lie in a line. Click three others."))
        elif cut_id is not None:
            kept = plane if plane.distance(session.solid.centre) <= 0 else plane.flipped()
            session.change_cut(_("Through three points"), cut_id, lambda cut: cut.with_plane(kept))
            session.notify(_("The plane goes through the three points."))

    def show(self, camera: Camera, origin: ImVec2, hovered: bool) -> None:
        """Draws the points. Esc, another tool or removal of the cut ends the picking."""
        if self.cut_id is None:
            return
        gone = all(cut.id != self.cut_id for cut in self.session.document.cuts)
        if gone or imgui.is_key_pressed(imgui.Key.escape) or self.session.tool != "select":
            self.cancel()
            return
        draw = imgui.get_window_draw_list()
        for point in self._seen:
            ((x, y),) = project_points(camera, point[None])[0].tolist()
            draw.add_circle_filled(ImVec2(x + origin.x, y + origin.y), px(6.5), u32("#000000", 0.35))
            draw.add_circle_filled(ImVec2(x + origin.x, y + origin.y), px(5), u32(palette().accent))
        if hovered:
            mouse = imgui.get_mouse_pos()
            label(
                draw,
                ImVec2(mouse.x + px(24), mouse.y + px(12)),
                _("Point {count} of 3").format(count=len(self.points) + 1),
            )
