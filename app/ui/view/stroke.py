"""Shows a stroke of the knife while it is drawn: the line itself, and where it would cut."""

from __future__ import annotations

from collections.abc import Sequence

from imgui_bundle import ImVec2, imgui

from app.model.knife import Stroke, plane_of
from app.model.pieces import Member
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px, u32
from app.ui.view.annotations import label
from app.ui.view.plane_lines import PlaneLines
from engine.render.gl.overlay import Lines
from engine.scene.camera import Camera

__all__ = ["cut_lines", "draw_stroke"]


def cut_lines(
    session: Session, camera: Camera, stroke: Stroke, members: Sequence[Member], lines: PlaneLines, scale: float
) -> list[Lines]:
    """Lines where a straight stroke would cut each piece. `scale`: pixels of the screen per unit of the window."""
    plane = None if stroke.path else plane_of(camera, stroke, session.up, session.solid.centre)
    return [] if plane is None else lines.cut(plane, [m for m in members if session.is_cut(m)], scale)


def draw_stroke(stroke: Stroke, origin: ImVec2, height: float, words: str) -> None:
    """Draws the line over the picture, whose first pixel is at `origin`, with a hint what releasing the button does."""
    draw = imgui.get_window_draw_list()
    points = [ImVec2(x + origin.x, y + origin.y) for x, y in stroke.path or (stroke.start, stroke.end)]
    for colour, width in ((u32("#000000", 0.35), px(4)), (u32("#FFFFFF"), px(1.8))):
        for point in points:
            draw.path_line_to(point)
        draw.path_stroke(colour, width)
    for end in (points[0], points[-1]):
        draw.add_circle_filled(end, px(4.5), u32(palette().accent))
    low = points[-1].y + px(40) > origin.y + height  # near the lower edge the hint is drawn above
    below = ImVec2(points[-1].x + px(14), points[-1].y + (-px(40) if low else px(6)))
    label(draw, below, _("{words}    Esc: cancel").format(words=words))
