"""The editor of the face in a picture, shown in place of the viewport: outline, axis, kind of cut, and placement."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon
from numpy.typing import NDArray

from app.model.faces.edit import Outline, nearest_point, refine
from app.model.faces.words import describe_guess
from app.session.face_controller import OpenFace
from app.session.session import Session
from app.session.workspace import Tool
from app.translation import _
from app.ui.theme import Fonts, palette, px, rgba, u32
from app.ui.view.painter import Painter
from app.ui.view.placement_view import PlacementView
from app.ui.widgets import clipped, colours, font, secondary, segmented, thin_bar, tooltip
from training.faces.marks import UNMARKED, Place
from training.families import Kind

__all__ = ["FaceEditor"]

KINDS: dict[Kind, str] = {"horizontal": _("Across the core"), "radial": _("Along the core"), "parallel": _("Slice")}
KIND_HINTS = (
    _("Cut level, as a slice of an orange: the core is a point in its middle"),
    _("Cut upright through the axis, as a halved apple"),
    _("Cut across a long thing, as a slice of bread"),
)
TOOLS = (_("Points"), _("Add"), _("Take away"))
TOOL_HINTS = (
    _("Drag the points of the outline, the core, or the ends of the axis"),
    _("Paint what belongs to the face. The wheel changes the size of the brush"),
    _("Paint what does not belong to it. The wheel changes the size of the brush"),
)

REACH = 11.0
"""Distance from a point, in pixels at 96 DPI, within which the pointer takes hold of it."""

DOTS = 28.0
"""Pixels at 96 DPI between the points of an outline that are shown as dots. The other points can be dragged, too."""

BRUSH_RANGE = (0.008, 0.15)
"""Radius of the brush in heights of the picture: from a few pixels to a third of a face."""

BRUSH = 0.03

Grip = tuple[str, int]
"""What is dragged: 'outline', 'core' or 'line', and the index of its point."""


class FaceEditor:
    """Draws the open picture and passes edits on to it."""

    def __init__(self, session: Session, painter: Painter) -> None:
        self.session = session
        self.ctx = painter.ctx
        self.placement = PlacementView(session, painter)
        self.tool = 0
        """Index into TOOLS."""
        self.brush = BRUSH
        self._grip: tuple[Grip, Outline] | None = None
        """What is dragged, and the outline when the drag began."""
        self._texture: tuple[NDArray[np.uint8], moderngl.Texture] | None = None
        self._shown: Path | None = None
        self._mode = ""
        """The view mode before the editor was opened."""
        self._with: Tool = "select"
        """The viewport's tool at that time. Choosing another tool, which is used on the object, closes the editor."""
        self.low, self.side = ImVec2(0, 0), ImVec2(1, 1)
        """Top left corner and size of the picture on the screen."""

    def show(self) -> bool:
        """Draws one frame if a picture is open; False if none is."""
        face, session = self.session.faces.open_face, self.session
        if (None if face is None else face.path) != self._shown:
            self._change_picture(face)
        if face is None:
            return False
        if session.tool != self._with:
            session.faces.close()
            self._change_picture(None)
            return False
        edge, gap = px(16), px(12)
        available = imgui.get_content_region_avail()
        self._head(face, edge, available.x - edge)
        bottom = imgui.get_frame_height() + px(10) + edge
        full, height = available.x - 2 * edge, max(px(80), available.y - imgui.get_cursor_pos_y() - bottom)
        width = round(0.56 * (full - gap))
        imgui.set_cursor_pos_x(edge)
        start = imgui.get_cursor_screen_pos()
        self._picture(face, ImVec2(width, height))
        imgui.set_cursor_screen_pos(ImVec2(start.x + width + gap, start.y))
        right = ImVec2(full - width - gap, height)
        self.placement.show(face, right)
        imgui.set_cursor_screen_pos(ImVec2(start.x, start.y + height + px(10)))
        self._tools(face, width)
        imgui.set_cursor_screen_pos(ImVec2(start.x + width + gap, start.y + height + px(10)))
        imgui.align_text_to_frame_padding()
        words = _("Where it goes in the object"), _("Where it goes in the object. Drag to look around.")
        secondary(words[imgui.calc_text_size(words[1]).x < right.x])
        if imgui.is_key_pressed(imgui.Key.escape) and not imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
            session.faces.close()
        return True

    def _change_picture(self, face: OpenFace | None) -> None:
        """Follows the session to another picture, or back to the object."""
        session = self.session
        if self._shown is None:
            self._mode, self._with = session.viewing.mode, session.tool
            session.viewing = replace(session.viewing, mode="solid")
        if face is None and session.tool == self._with:
            session.viewing = replace(session.viewing, mode=self._mode)
        self.placement.forget()
        self.tool, self._grip = 0, None
        self._shown = None if face is None else face.path

    def _head(self, face: OpenFace, left: float, right: float) -> None:
        """Draws the name, the buttons, what the face seems to be, and the kind of cut that it is used as. `left` and
        `right`: edges of this part."""
        session = self.session
        again, done = f"{icon.ICON_FA_ARROW_ROTATE_LEFT}  " + _("Find again"), f"{icon.ICON_FA_CHECK}  " + _("Done")
        widths = [imgui.calc_text_size(text).x + px(28) for text in (again, done)]
        imgui.set_cursor_pos(ImVec2(left, px(14)))
        imgui.align_text_to_frame_padding()
        with font(Fonts.bold):
            imgui.text_unformatted(clipped(face.path.name, right - left - sum(widths) - px(16)))
        imgui.same_line(right - sum(widths) - px(8))
        imgui.begin_disabled(face.given == UNMARKED)
        if imgui.button(again, ImVec2(widths[0], 0)):
            face.find_again()
        imgui.end_disabled()
        tooltip(_("Drop your corrections"))
        imgui.same_line(right - widths[1])
        if imgui.button(done, ImVec2(widths[1], 0)):
            session.faces.close()
        tooltip(_("Back to the object. Your corrections are kept."), "Esc")
        imgui.set_cursor_pos_x(left)
        imgui.align_text_to_frame_padding()
        self._verdict(face)
        if face.kind in KINDS:
            names = list(KINDS)
            wide = min(px(372), right - left)
            imgui.same_line(left)
            if right - wide < imgui.get_item_rect_max().x - imgui.get_window_pos().x + px(12):  # too narrow for one row
                imgui.new_line()
                imgui.set_cursor_pos_x(left)
            else:
                imgui.set_cursor_pos_x(right - wide)
            index = names.index(face.kind)
            chosen = segmented("kind", list(KINDS.values()), index, wide, KIND_HINTS)
            if chosen != index:
                face.set_kind(names[chosen])
        imgui.dummy(ImVec2(0, px(2)))

    def _verdict(self, face: OpenFace) -> None:
        """Says what the face seems to be, or why there is none."""
        found = face.found
        if found is None:
            secondary(_("Looking for the cut face..."))
        elif found.problem:
            with colours(text=rgba(palette().trouble)):
                imgui.text_unformatted(icon.ICON_FA_TRIANGLE_EXCLAMATION)
            imgui.same_line(0, px(8))
            painted = _(" Paint it with Add.") if found.rgb.size and face.given.outline is None else ""
            secondary(f"{found.verdict[:1].upper()}{found.verdict[1:]}.{painted}")
            tooltip(f"{found.problem[:1].upper()}{found.problem[1:]}.")
        elif found.guess is not None:
            secondary(_("It {guess}.").format(guess=describe_guess(found.guess)), wrap=True)
            if found.note and face.given.outline is None:
                secondary(f"{found.note[:1].upper()}{found.note[1:]}.", wrap=True)

    # The picture

    def _picture(self, face: OpenFace, size: ImVec2) -> None:
        """Draws the picture with what is known of its face, and handles the pointer on it."""
        corner, draw, p = imgui.get_cursor_screen_pos(), imgui.get_window_draw_list(), palette()
        draw.add_rect_filled(corner, ImVec2(corner.x + size.x, corner.y + size.y), u32(p.view), px(5))
        imgui.invisible_button("##picture", size)
        hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
        found = face.found
        if found is None:
            imgui.set_cursor_screen_pos(ImVec2(corner.x + size.x * 0.3, corner.y + size.y / 2))
            imgui.push_item_width(size.x * 0.4)
            imgui.begin_child("##looking", ImVec2(size.x * 0.4, px(8)))
            thin_bar(time.monotonic() * 0.7 % 1.0)
            imgui.end_child()
            imgui.pop_item_width()
            return
        if not found.rgb.size:
            return
        inset = px(14)
        scale = min((size.x - 2 * inset) / found.size[0], (size.y - 2 * inset) / found.size[1])
        self.side = ImVec2(found.size[0] * scale, found.size[1] * scale)
        self.low = ImVec2(corner.x + (size.x - self.side.x) / 2, corner.y + (size.y - self.side.y) / 2)
        high = ImVec2(self.low.x + self.side.x, self.low.y + self.side.y)
        texture = self._texture_of(found.rgb)
        draw.add_image_rounded(
            imgui.ImTextureRef(texture.glo), self.low, high, ImVec2(0, 0), ImVec2(1, 1), u32("#FFFFFF"), px(3)
        )
        draw.push_clip_rect(corner, ImVec2(corner.x + size.x, corner.y + size.y), True)
        grip = self._pointer(face, hovered, active)
        self._outline(draw, face, grip)
        self._axis(draw, face, grip)
        if self.tool and hovered:
            self._brush(draw)
        draw.pop_clip_rect()

    def _pointer(self, face: OpenFace, hovered: bool, active: bool) -> Grip | None:
        """Follows the pointer; returns the point that it holds, or would take hold of."""
        io, at = imgui.get_io(), self._place(imgui.get_mouse_pos())
        if self.tool:
            if hovered and io.mouse_wheel:
                self.brush = float(np.clip(self.brush * 1.12**io.mouse_wheel, *BRUSH_RANGE))
            if active:
                face.paint(at, self.brush, self.tool == 1)
            elif imgui.is_item_deactivated():
                face.settle()
            return None
        near = self._near(face, at) if hovered or active else None
        if imgui.is_item_activated() and near is not None:
            self._grip = self._take(face, near)
        if self._grip is None:
            return near
        (what, index), before = self._grip
        if not active:
            self._grip = None
            face.settle()
        elif imgui.is_mouse_dragging(imgui.MouseButton_.left, 1.0):
            if what == "outline":
                face.drag_point(before, index, at, soft=not io.key_alt)
            elif what == "core":
                face.drag_core(at)
            else:
                face.drag_end(index, at)
        return what, index

    def _take(self, face: OpenFace, near: Grip) -> tuple[Grip, Outline]:
        """What is dragged, and the outline at the beginning of the drag."""
        outline = face.marks.outline or ()
        if near[0] != "outline" or imgui.get_io().key_alt:
            return near, outline
        aspect = self.side.x / self.side.y
        finer = refine(outline, aspect)
        return ("outline", nearest_point(finer, outline[near[1]], aspect)[0]), finer

    def _near(self, face: OpenFace, at: Place) -> Grip | None:
        """The point within reach of a place; the axis lies above the outline."""
        marks, aspect, reach = face.marks, self.side.x / self.side.y, px(REACH) / self.side.y
        ends = self._axis_points(face)
        if ends:
            index, away = nearest_point(tuple(ends), at, aspect)
            if away < 1.3 * reach:
                return ("core" if face.cut == "horizontal" else "line"), index
        if marks.outline is None:
            return None
        index, away = nearest_point(marks.outline, at, aspect)
        return ("outline", index) if away < reach else None

    def _axis_points(self, face: OpenFace) -> list[Place]:
        """The core of a horizontal cut, both ends of the core line of a radial cut, none for a slice."""
        marks = face.marks
        if face.cut == "horizontal":
            return [marks.core] if marks.core is not None else []
        return list(marks.line) if face.cut == "radial" and marks.line is not None else []

    def _outline(self, draw: imgui.ImDrawList, face: OpenFace, grip: Grip | None) -> None:
        outline = face.marks.outline
        if outline is None:
            return
        p, points = palette(), [self.to_screen(place) for place in outline]
        for colour, thickness in ((u32("#000000", 0.4), px(3.6)), (u32(p.accent), px(1.8))):
            draw.path_clear()
            for point in points:
                draw.path_line_to(point)
            draw.path_stroke(colour, thickness, imgui.ImDrawFlags_.closed)
        if self.tool:
            return
        since = DOTS  # not every point, or a wavy outline would be all dots
        for index, point in enumerate(points):
            last = points[index - 1]
            since += float(np.hypot(point.x - last.x, point.y - last.y)) / px(1)
            held = grip == ("outline", index)
            if since >= DOTS or held:
                draw.add_circle_filled(point, px(6 if held else 3.8), u32("#000000", 0.5))
                draw.add_circle_filled(point, px(5 if held else 2.8), u32(p.accent if held else "#FFFFFF"))
                since = 0.0

    def _axis(self, draw: imgui.ImDrawList, face: OpenFace, grip: Grip | None) -> None:
        points = [self.to_screen(place) for place in self._axis_points(face)]
        colour = u32("#7FC4FF")  # bright on flesh of any colour, in both themes
        if len(points) == 2:
            draw.add_line(points[0], points[1], u32("#000000", 0.45), px(4))
            draw.add_line(points[0], points[1], colour, px(2))
        for index, point in enumerate(points):
            radius = px(8.5 if grip is not None and grip[0] != "outline" and grip[1] == index else 7)
            draw.add_circle_filled(point, radius + px(1.2), u32("#000000", 0.5))
            draw.add_circle_filled(point, radius, colour)
            draw.add_circle_filled(point, px(2.4), u32("#1B1C1E"))

    def _brush(self, draw: imgui.ImDrawList) -> None:
        """Draws the brush at the pointer, with a plus or minus sign."""
        at, radius = imgui.get_mouse_pos(), self.brush * self.side.y
        draw.add_circle(at, radius, u32("#000000", 0.6), 0, px(3.2))
        draw.add_circle(at, radius, u32("#FFFFFF"), 0, px(1.4))
        arm = min(px(5), 0.6 * radius)
        for colour, width in ((u32("#000000", 0.6), px(3.6)), (u32("#FFFFFF"), px(1.6))):
            draw.add_line(ImVec2(at.x - arm, at.y), ImVec2(at.x + arm, at.y), colour, width)
            if self.tool == 1:
                draw.add_line(ImVec2(at.x, at.y - arm), ImVec2(at.x, at.y + arm), colour, width)

    def _tools(self, face: OpenFace, width: float) -> None:
        wide = min(px(252), width)
        self.tool = segmented("face tool", TOOLS, self.tool, wide, TOOL_HINTS)
        room = width - wide - px(12)
        if room < px(110):
            return
        imgui.same_line(0, px(12))
        if self.tool:
            imgui.set_next_item_width(min(room, px(180)))
            flags = imgui.SliderFlags_.logarithmic
            self.brush = imgui.slider_float("##brush", self.brush, *BRUSH_RANGE, "", flags)[1]
            tooltip(_("Size of the brush, also with the wheel"))
        elif face.marks.outline is not None:
            imgui.align_text_to_frame_padding()
            secondary(_("Alt: one point alone") if room < px(260) else _("Drag a point; Alt: without its neighbours"))

    # Places

    def to_screen(self, place: Place) -> ImVec2:
        """The point of the screen that shows a place in the picture."""
        return ImVec2(self.low.x + place[0] * self.side.x, self.low.y + place[1] * self.side.y)

    def _place(self, at: ImVec2) -> Place:
        return (at.x - self.low.x) / max(self.side.x, 1.0), (at.y - self.low.y) / max(self.side.y, 1.0)

    def _texture_of(self, rgb: NDArray[np.uint8]) -> moderngl.Texture:
        """The picture as a texture, uploaded once."""
        if self._texture is None or self._texture[0] is not rgb:
            self.release()
            height, width = rgb.shape[:2]
            texture = self.ctx.texture((width, height), 3, np.ascontiguousarray(rgb).tobytes(), alignment=1)
            self._texture = (rgb, texture)
        return self._texture[1]

    def release(self) -> None:
        """Frees the texture."""
        if self._texture is not None:
            self._texture[1].release()
            self._texture = None
