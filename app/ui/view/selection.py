"""Frames around the visible part of what is selected; they ignore what sections hide."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.camera_control import project_points
from app.model.pieces import PlacedPiece, sections, shown_points
from app.session.session import Session
from app.ui.theme import px
from app.ui.view.annotations import brackets
from engine.scene.camera import Camera

__all__ = ["selection_frames"]


def selection_frames(session: Session, camera: Camera, pieces: Sequence[PlacedPiece], origin: ImVec2) -> None:
    """Draws brackets around each selected piece, or around the selected one of several objects.

    `pieces`: those of the active object where they are drawn now.
    """
    if session.mode == "capture":
        if session.object_selected and session.document.visible and session.object is not None:
            _frame(camera, session.object.extent, origin)
        return
    hidden = sections(session.document)
    visible = [piece for piece in pieces if piece.visible]
    points = {piece.key: shown_points(piece, session.solid, hidden) for piece in visible}
    if session.selected and len(pieces) > 1:
        for piece in visible:
            if piece.key in session.selected:
                _frame(camera, points[piece.key], origin)
    elif session.object_selected and session.document.visible and points:
        _frame(camera, np.concatenate(list(points.values())), origin)


def _frame(camera: Camera, points: NDArray[np.float64], origin: ImVec2) -> None:
    """Draws brackets around world points (N, 3), if there are any."""
    if len(points):
        pixels = project_points(camera, points)[0] + np.array([origin.x, origin.y])
        brackets(imgui.get_window_draw_list(), pixels.min(0) - px(10), pixels.max(0) + px(10))
