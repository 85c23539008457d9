"""Three cut faces beside the object: each is seen straight on, and a click in one moves the other two planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import moderngl
import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon
from numpy.typing import NDArray

from app.jobs.slice_reader import COARSE, Face, SliceReader, WantedFace
from app.model.camera_control import ray
from app.model.measure.slices import SLICES, Slices
from app.model.measure.units import round_length
from app.model.rigid_transform import Vec3, vec3
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px, u32
from app.ui.view.annotations import label
from app.ui.widgets import icon_button, tooltip

__all__ = ["SliceViews", "is_shown", "quarters", "slice_colours"]

BUTTONS = (
    imgui.ButtonFlags_.mouse_button_left
    | imgui.ButtonFlags_.mouse_button_right
    | imgui.ButtonFlags_.mouse_button_middle
)

REACH = 0.25
"""Distance in pitches up to which a measured end counts as lying in a plane."""

SHORTEST_BAR = 24.0
"""Shortest room for a scale bar, pixels at 96 DPI; a narrower view has none."""

KEYS = ((imgui.Key.page_up, 1.0), (imgui.Key.page_down, -1.0))


def slice_colours() -> tuple[str, str, str]:
    """The colour of each plane, for its view's frame and for its line in the other two views and on the object."""
    p = palette()
    return p.trouble, p.curve, p.third


@dataclass
class Measured:
    """A distance on a face."""

    index: int
    """Index of the face."""
    ends: list[NDArray[np.float64]]
    """The first end, or both, each (3,), object space."""

    @property
    def length(self) -> float | None:
        """Length in world units; None while there is only one end."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0])) if len(self.ends) == 2 else None


class SliceViews:
    """Draws the three views and handles the pointer in them."""

    def __init__(self, session: Session, ctx: moderngl.Context) -> None:
        self.session, self.ctx = session, ctx
        self.reader = SliceReader(len(SLICES))
        self.measuring = False
        """Whether the ruler is in use, so that a click sets an end of a distance."""
        self.measured: Measured | None = None
        self.boxes: list[tuple[ImVec2, tuple[int, int]]] = [(ImVec2(0, 0), (16, 16))] * len(SLICES)
        """Upper left corner and size of each view, in the window's units."""
        self.focus = 0
        """Index of the view whose plane keys move: the last that was clicked."""
        self._of: object = None
        """The solid that the target and the zoom belong to."""
        self._target: Vec3 = (0.0, 0.0, 0.0)
        self._zoom = 1.0
        self._textures: list[tuple[Face, moderngl.Texture] | None] = [None] * len(SLICES)
        self._moving = False

    @property
    def busy(self) -> bool:
        """Whether faces are being read, so that frames must be drawn without an event."""
        return self.reader.busy

    def slices(self) -> Slices:
        """The planes of the active object as they are now."""
        session, solid = self.session, self.session.solid
        centre = vec3(solid.centre)
        if self._of is not solid:  # another object, or another solid of it
            self._of, self._target, self._zoom, self.measured = solid, centre, 1.0, None
        cross = session.viewing.cross or centre
        made = Slices(session.up, centre, solid.radius, cross, self._target, self._zoom)
        return made.moved_to(np.asarray(cross))

    def show(self, places: Sequence[tuple[ImVec2, tuple[int, int]]]) -> None:
        """Draws one frame, with the views at these places of the window."""
        self.boxes = list(places)
        atoms, shown = self.session.atoms, self.session.object
        before = self.slices()
        now = before
        for index in range(len(SLICES)):
            now = self._pointer(index, now)
        if not imgui.get_io().want_text_input:
            for key, steps in KEYS:
                now = now.stepped(self.focus, steps) if imgui.is_key_pressed(key) else now
        if self.measuring and imgui.is_key_pressed(imgui.Key.escape):
            self.measuring, self.measured = False, None
        if now != before:
            self._target, self._zoom = now.target, now.zoom
            if now.cross != before.cross:
                self.session.viewing = replace(self.session.viewing, cross=now.cross)
        self._moving = now != before or (self._moving and imgui.is_mouse_down(imgui.MouseButton_.left))
        if atoms is not None and shown is not None:
            scale = float(imgui.get_io().display_framebuffer_scale.x) or 1.0
            wanted = [
                WantedFace(atoms, shown.inside, now.camera(index, size, scale), now.planes[index])
                for index, (_, size) in enumerate(self.boxes)
            ]
            self.reader.update(wanted, self._moving)
        for index in range(len(SLICES)):
            self._draw(index, now)

    def _pointer(self, index: int, slices: Slices) -> Slices:
        """The planes after the pointer's action in one view."""
        origin, size = self.boxes[index]
        io, mouse = imgui.get_io(), imgui.get_mouse_pos()
        at = (mouse.x - origin.x, mouse.y - origin.y)
        imgui.set_cursor_screen_pos(origin)
        imgui.set_next_item_allow_overlap()
        imgui.invisible_button(f"##{SLICES[index]}", ImVec2(*size), BUTTONS)
        if imgui.is_item_hovered():
            if io.mouse_wheel and io.key_ctrl:
                slices = slices.zoomed(index, size, at, io.mouse_wheel)
            elif io.mouse_wheel:
                slices = slices.stepped(index, io.mouse_wheel)
            if imgui.is_mouse_double_clicked(imgui.MouseButton_.middle):
                slices = replace(slices, target=slices.centre, zoom=1.0)
        if not imgui.is_item_active():
            return slices
        self.focus = index
        if not imgui.is_mouse_down(imgui.MouseButton_.left):
            before = (at[0] - io.mouse_delta.x, at[1] - io.mouse_delta.y)
            return slices if at == before else slices.panned(index, size, before, at)
        if not self.measuring:
            return slices.moved_to(slices.point(index, size, at))
        if imgui.is_item_activated():
            self._measure(index, slices.point(index, size, at))
        return slices

    def _measure(self, index: int, point: NDArray[np.float64]) -> None:
        """Handles a click with the ruler."""
        measured = self.measured
        if measured is None or measured.length is not None or measured.index != index:
            self.measured = Measured(index, [point])
        else:
            measured.ends.append(point)

    # Drawing

    def _draw(self, index: int, slices: Slices) -> None:
        p, (origin, size) = palette(), self.boxes[index]
        draw = imgui.get_window_draw_list()
        corner = ImVec2(origin.x + size[0], origin.y + size[1])
        imgui.push_clip_rect(origin, corner, True)
        draw.add_rect_filled(origin, corner, u32(p.view))
        self._face(index, slices)
        self._cross(index, slices)
        if self.measured is not None and self.measured.index == index:
            self._distance(index, slices, self.measured)
        colour = slice_colours()[index]
        inset = px(12)
        at = ImVec2(origin.x + inset + px(16), origin.y + inset)
        middle = ImVec2(origin.x + inset + px(5), at.y + imgui.get_text_line_height() / 2)
        along = float(np.asarray(slices.planes[index].normal) @ (np.asarray(slices.cross) - slices.centre))
        text = (_("Top"), _("Front"), _("Right"))[index]
        if size[0] > px(220):
            text = f"{text}   {self.session.viewing.unit.text(along)}"
        behind(draw, ImVec2(middle.x - px(4), at.y), ImVec2(at.x + imgui.calc_text_size(text).x, at.y))
        draw.add_circle_filled(middle, px(4.5), u32(colour))
        draw.add_text(at, u32(p.text), text)
        self._scale_bar(index, slices)
        if self.focus == index:
            draw.add_rect(origin, corner, u32(colour, 0.55), 0.0, px(1))
        imgui.pop_clip_rect()
        if index == 1:  # the upper right view
            self._tools(ImVec2(corner.x - px(40), origin.y + px(8)))

    def _tools(self, at: ImVec2) -> None:
        imgui.set_cursor_screen_pos(at)
        if icon_button(f"{icon.ICON_FA_RULER}##ruler", 30, active=self.measuring):
            self.toggle_ruler()
        tooltip(_("Measure a distance with two clicks on a face"), "D")

    def toggle_ruler(self) -> None:
        """Takes the ruler, or puts it away with what it has measured."""
        self.measuring = not self.measuring
        self.measured = None
        if self.measuring:
            self.session.notify(_("Click the two ends of a distance on one of the faces. Esc: put the ruler away."))

    def _face(self, index: int, slices: Slices) -> None:
        """Draws what was last read of a face, moved and scaled to where it belongs now."""
        draw, (origin, size) = imgui.get_window_draw_list(), self.boxes[index]
        texture = self._texture(index)
        face = self.reader.faces[index]
        if texture is None or face is None:
            word = _("reading...") if self.session.atoms is not None else _("not solid yet")
            text = imgui.calc_text_size(word)
            at = ImVec2(origin.x + (size[0] - text.x) / 2, origin.y + (size[1] - text.y) / 2)
            draw.add_text(at, u32(palette().second), word)
            return
        camera, now = face.wanted.camera, slices.camera(index, size)
        # The last row or column of a coarse picture may lie outside the camera's picture.
        grain = COARSE if face.coarse else 1
        wide, high = face.rgba.shape[1] * grain, face.rgba.shape[0] * grain
        corners = []
        for x, y in ((0.0, 0.0), (float(wide), float(high))):
            point, __ = ray(camera, (x, y))
            a, b, __ = now.viewmat[:3, :3] @ point + now.viewmat[:3, 3]
            corners.append(ImVec2(origin.x + now.fx * a + now.cx, origin.y + now.fy * b + now.cy))
        draw.add_image(imgui.ImTextureRef(texture.glo), corners[0], corners[1])

    def _texture(self, index: int) -> moderngl.Texture | None:
        """The texture of the face that was read last."""
        face, held = self.reader.faces[index], self._textures[index]
        if face is None:
            return None
        if held is None or held[0] is not face:
            if held is not None:
                held[1].release()
            height, width, __ = face.rgba.shape
            texture = self.ctx.texture((width, height), 4, np.ascontiguousarray(face.rgba).tobytes())
            held = self._textures[index] = (face, texture)
        return held[1]

    def _cross(self, index: int, slices: Slices) -> None:
        """Draws the other two planes as lines, with a gap around the point where they cross."""
        draw, (origin, size) = imgui.get_window_draw_list(), self.boxes[index]
        x, y = slices.place(index, size, slices.cross)
        x, y, gap = round(x + origin.x) + 0.5, round(y + origin.y) + 0.5, px(7)
        right, low = origin.x + size[0], origin.y + size[1]
        across, upright = crossing(index)
        for other, ends in (
            (across, ((origin.x, y, x - gap, y), (x + gap, y, right, y))),
            (upright, ((x, origin.y, x, y - gap), (x, y + gap, x, low))),
        ):
            for x0, y0, x1, y1 in ends:
                draw.add_line(ImVec2(x0, y0), ImVec2(x1, y1), u32("#000000", 0.35), px(3))
                draw.add_line(ImVec2(x0, y0), ImVec2(x1, y1), u32(slice_colours()[other], 0.95), px(1.3))

    def _scale_bar(self, index: int, slices: Slices) -> None:
        """Draws a bar of a round length in the lower right corner."""
        p, draw, (origin, size) = palette(), imgui.get_window_draw_list(), self.boxes[index]
        unit = self.session.viewing.unit
        scale = slices.camera(index, size).fx / unit.length
        if 0.3 * size[0] < px(SHORTEST_BAR):
            return
        length = round_length(0.3 * size[0] / scale)
        right, low = origin.x + size[0] - px(14), origin.y + size[1] - px(14)
        left, tick = right - length * scale, px(4)
        text = f"{length:g} {unit.name}"
        at = ImVec2(left - imgui.calc_text_size(text).x - px(10), low - imgui.get_text_line_height() / 2)
        behind(draw, at, ImVec2(right, at.y))
        draw.add_line(ImVec2(left, low), ImVec2(right, low), u32(p.text), px(1.6))
        for x in (left, right):
            draw.add_line(ImVec2(x, low - tick), ImVec2(x, low + tick), u32(p.text), px(1.6))
        draw.add_text(at, u32(p.text), text)

    def _distance(self, index: int, slices: Slices, measured: Measured) -> None:
        """Draws the ruler's line and its length."""
        p, draw, (origin, size) = palette(), imgui.get_window_draw_list(), self.boxes[index]
        plane, atoms = slices.planes[index], self.session.atoms
        if atoms is None or max(abs(float(plane.distance(end))) for end in measured.ends) > REACH * atoms.pitch:
            return  # the plane has moved away from the distance
        mouse = imgui.get_mouse_pos()
        ends = [slices.place(index, size, end) for end in measured.ends]
        free = (mouse.x - origin.x, mouse.y - origin.y)
        if len(ends) < 2:
            ends.append(free)
        a, b = (ImVec2(x + origin.x, y + origin.y) for x, y in ends)
        draw.add_line(a, b, u32("#000000", 0.45), px(4))
        draw.add_line(a, b, u32("#FFFFFF"), px(1.6))
        for end in (a, b):
            draw.add_circle_filled(end, px(5), u32("#000000", 0.45))
            draw.add_circle_filled(end, px(3.6), u32(p.accent))
        length = measured.length
        if length is None:
            length = float(np.linalg.norm(slices.point(index, size, free) - measured.ends[0]))
        label(draw, ImVec2((a.x + b.x) / 2 + px(12), (a.y + b.y) / 2 + px(8)), self.session.viewing.unit.text(length))

    def release(self) -> None:
        """Frees the textures and ends the reading."""
        self.reader.close()
        for held in self._textures:
            if held is not None:
                held[1].release()
        self._textures = [None] * len(SLICES)


def behind(draw: imgui.ImDrawList, start: ImVec2, end: ImVec2) -> None:
    """Draws a background for a line of text between two points of its upper edge, to keep it readable on a face."""
    low = ImVec2(start.x - px(6), start.y - px(3))
    draw.add_rect_filled(
        low, ImVec2(end.x + px(6), end.y + imgui.get_text_line_height() + px(3)), u32(palette().view, 0.72), px(4)
    )


def crossing(index: int) -> tuple[int, int]:
    """Indices of the planes that a view shows as its horizontal and its vertical line."""
    return ((1, 2), (0, 2), (0, 1))[index]


def quarters(origin: ImVec2, size: tuple[float, float]) -> list[tuple[ImVec2, tuple[int, int]]]:
    """Four places for the object and the three slices, two above two, with a line between them."""
    gap = max(1.0, round(px(2)))
    width, height = int((size[0] - gap) / 2), int((size[1] - gap) / 2)
    right, low = origin.x + width + gap, origin.y + height + gap
    rest = (int(size[0] - width - gap), int(size[1] - height - gap))
    return [
        (origin, (width, height)),
        (ImVec2(origin.x, low), (width, rest[1])),
        (ImVec2(right, origin.y), (rest[0], height)),
        (ImVec2(right, low), rest),
    ]


def is_shown(session: Session) -> bool:
    """Whether the slices are to be drawn: they need an object."""
    return session.viewing.slices and session.document.scene is not None and session.object is not None
