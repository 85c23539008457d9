"""The timeline below the object: keyframes to add, drag, replace and remove, and the playhead."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.session.film_controller import PRESETS
from app.session.session import Session
from app.translation import _
from app.ui.film.film_window import FilmWindow
from app.ui.theme import palette, px, rgba, u32
from app.ui.widgets import colours, disabled, icon_button, secondary, tooltip

__all__ = ["TimelinePanel"]


HEIGHT = 96.0
"""Height of the panel at 96 DPI."""

SHORTEST, BEYOND = 8.0, 1.15
"""Least seconds that the ruler shows, and its length in lengths of the film: the last keyframe can be dragged."""

LABELLED = 64.0
"""Least pixels at 96 DPI between two numbers of the ruler."""

BUTTON = 26.0

NARROWEST = 380.0
"""Width at 96 DPI that the buttons need. Where there is less, as beside the inspector of a small window with a large
interface, the panel scrolls."""


class TimelinePanel:
    """Draws the timeline and passes edits on to the session."""

    def __init__(self, session: Session, window: FilmWindow) -> None:
        self.session, self.window = session, window
        self._scrolls = False
        self._span = SHORTEST
        """Seconds that the ruler shows, which stay the same while something is dragged."""

    @property
    def height(self) -> float:
        """Height that it takes of the window, in the window's units; 0 while it is closed."""
        shown = self.session.viewing.timeline and self.session.document.scene is not None
        below = imgui.get_style().scrollbar_size if self._scrolls else 0.0
        return px(HEIGHT) + below if shown else 0.0

    def close(self) -> None:
        """Shows the object alone again; the film is kept."""
        self.session.film.leave()
        self.session.viewing = replace(self.session.viewing, timeline=False)

    def show(self, width: float) -> None:
        """Draws one frame, from the cursor down."""
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(10), px(8)))
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(px(5), px(6)))
        flags, height = imgui.WindowFlags_.no_scrollbar | imgui.WindowFlags_.no_scroll_with_mouse, self.height
        self._scrolls = width < px(NARROWEST)
        if self._scrolls:
            flags = imgui.WindowFlags_.horizontal_scrollbar
            imgui.set_next_window_content_size(ImVec2(px(NARROWEST - 20), 0))
        with colours(child_bg=rgba(palette().panel)):
            imgui.begin_child(
                "##timeline",
                ImVec2(width, height),
                imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.nav_flattened,
                flags,
            )
        self._buttons()
        self._ruler()
        imgui.end_child()
        imgui.pop_style_var(2)
        idle = not imgui.is_any_item_active() and not imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
        if self.session.film.shown and idle:
            imgui.internal.set_key_owner(imgui.Key.escape, imgui.get_id("timeline"))  # leads to no other control
            if imgui.is_key_pressed(imgui.Key.escape):
                self.session.film.leave()

    # The buttons

    def _buttons(self) -> None:
        session, film = self.session, self.session.film
        timeline = session.timeline
        wide = imgui.get_content_region_avail().x > px(660)
        with disabled(not film.ready):
            if icon_button(f"{icon.ICON_FA_BACKWARD_STEP}##before", BUTTON, quiet=True):
                film.step(-1)
            tooltip(_("The keyframe before"), ",")
            imgui.same_line()
            if icon_button(f"{icon.ICON_FA_PAUSE if film.playing else icon.ICON_FA_PLAY}##play", BUTTON):
                film.toggle()
            tooltip(_("Pause") if film.playing else _("Play"), "Space")
            imgui.same_line()
            if icon_button(f"{icon.ICON_FA_FORWARD_STEP}##next", BUTTON, quiet=True):
                film.step(1)
            tooltip(_("The next keyframe"), ".")
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        secondary(f"{film.time:.1f} / {timeline.seconds:.1f} s")
        imgui.same_line(0, px(12))
        with disabled(not film.available):
            if _button(icon.ICON_FA_PLUS, _("Keyframe"), wide):
                film.add()
            tooltip(_("Keep this view, the planes and the explosion at the playhead"), "N")
        imgui.same_line()
        chosen = film.selected is not None and film.selected < len(timeline.keyframes)
        with disabled(not chosen):
            if icon_button(f"{icon.ICON_FA_ARROWS_ROTATE}##replace", BUTTON, quiet=True):
                film.update()
            tooltip(_("Replace the selected keyframe by what is shown now"))
            imgui.same_line()
            if icon_button(f"{icon.ICON_FA_TRASH_CAN}##remove", BUTTON, quiet=True):
                film.remove()
            tooltip(_("Remove the selected keyframe"), "Del")
        imgui.same_line(0, px(12))
        with disabled(not film.available):
            if _button(icon.ICON_FA_WAND_MAGIC_SPARKLES, _("Make"), wide):
                imgui.open_popup("presets")
            tooltip(_("A turntable, a plane sweep or an explosion, from what is shown"))
        self._presets()
        text = (
            imgui.calc_text_size(f"{icon.ICON_FA_FILM}  " + _("Save film...")).x + 2 * imgui.get_style().frame_padding.x
        )
        imgui.same_line()
        end = imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x - px(BUTTON) - px(5)
        imgui.set_cursor_pos_x(max(imgui.get_cursor_pos_x(), end - (text if wide else px(BUTTON))))
        with disabled(not film.ready or film.busy):
            if _button(icon.ICON_FA_FILM, _("Save film..."), wide):
                self.window.open()
            tooltip(_("As a film, or as a folder of pictures"), "Ctrl+Shift+E")
        imgui.same_line()
        if icon_button(f"{icon.ICON_FA_XMARK}##close timeline", BUTTON, quiet=True):
            self.close()
        tooltip(_("Close the timeline; the film is kept"), "L")

    def _presets(self) -> None:
        if not imgui.begin_popup("presets"):
            return
        for name, label in PRESETS.items():
            if imgui.menu_item_simple(label):
                self.session.film.preset(name)
        imgui.separator()
        if imgui.menu_item(_("Remove the film"), "", False, bool(self.session.timeline.keyframes))[0]:
            self.session.film.clear()
        imgui.end_popup()

    # The ruler

    def _ruler(self) -> None:
        session, film, p = self.session, self.session.film, palette()
        keyframes = session.timeline.keyframes
        if not imgui.is_any_item_active():
            self._span = max(SHORTEST, BEYOND * session.timeline.seconds, film.time)
        draw, low = imgui.get_window_draw_list(), imgui.get_cursor_screen_pos()
        size = imgui.get_content_region_avail()
        inset, middle = px(10), low.y + size.y - px(14)
        length = size.x - 2 * inset

        def x_of(time: float) -> float:
            return low.x + inset + length * time / self._span

        def time_at(x: float) -> float:
            return max(0.0, (x - low.x - inset) / length * self._span)

        draw.add_rect_filled(
            ImVec2(low.x, middle - px(12)), ImVec2(low.x + size.x, middle + px(12)), u32(p.field), px(5)
        )
        self._ticks(draw, low.y, middle, length, x_of(0.0))
        if keyframes:
            ends = x_of(keyframes[0].time), x_of(keyframes[-1].time)
            draw.add_line(ImVec2(ends[0], middle), ImVec2(ends[1], middle), u32(p.second), px(2))
        else:
            text = _("Add a keyframe of this view, change the view or the planes, add another.")
            room = imgui.calc_text_size(text).x < size.x - px(20)
            shown = text if room else _("Add keyframes of the view: N")
            draw.add_text(ImVec2(low.x + inset, middle - imgui.get_text_line_height() / 2), u32(p.second), shown)
        imgui.set_cursor_screen_pos(low)
        imgui.set_next_item_allow_overlap()
        imgui.invisible_button("##ruler", size)
        if imgui.is_item_active() and film.available and keyframes:
            film.playing = False
            film.seek(min(time_at(imgui.get_mouse_pos().x), session.timeline.seconds))
            film.selected = session.timeline.at(film.time)
        for index, one in enumerate(keyframes):
            self._key(draw, index, ImVec2(x_of(one.time), middle), time_at)
        if keyframes:
            at = x_of(min(film.time, self._span))
            draw.add_line(ImVec2(at, low.y + px(4)), ImVec2(at, middle + px(12)), u32(p.accent), px(1.8))
            top = low.y + px(3)
            draw.add_triangle_filled(
                ImVec2(at - px(5), top), ImVec2(at + px(5), top), ImVec2(at, top + px(8)), u32(p.accent)
            )

    def _ticks(self, draw: imgui.ImDrawList, top: float, middle: float, length: float, start: float) -> None:
        """Draws lines and numbers of seconds, as many as there is room for."""
        p = palette()
        step = next(s for s in (0.5, 1, 2, 5, 10, 30, 60, 300, 900, 3600) if length * s / self._span > px(LABELLED))
        for number in range(int(self._span / step) + 1):
            x = start + length * number * step / self._span
            draw.add_line(ImVec2(x, middle - px(12)), ImVec2(x, middle - px(6)), u32(p.second, 0.7), px(1))
            text = f"{number * step:g} s"
            if x + imgui.calc_text_size(text).x < start + length:
                draw.add_text(ImVec2(x + px(4), top - px(2)), u32(p.second), text)

    def _key(self, draw: imgui.ImDrawList, index: int, at: ImVec2, time_at: Callable[[float], float]) -> None:
        """Draws a keyframe as a diamond, with a ring if it is selected; a click shows the keyframe, a drag moves it."""
        session, film, p = self.session, self.session.film, palette()
        reach = px(9)
        imgui.set_cursor_screen_pos(ImVec2(at.x - reach, at.y - px(12)))
        imgui.set_next_item_allow_overlap()
        imgui.invisible_button(f"##key{index}", ImVec2(2 * reach, px(24)))
        hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
        if imgui.is_item_activated():
            film.playing = False
            film.seek(session.timeline.keyframes[index].time)
            film.selected = index
        if active and imgui.is_mouse_dragging(imgui.MouseButton_.left, px(3)):
            film.move(index, time_at(imgui.get_mouse_pos().x))
            film.time = session.timeline.keyframes[index].time
        one = session.timeline.keyframes[index]
        if hovered and not active:
            tooltip(
                _("Keyframe {index} at {time:.2f} s. Click to show it, drag to move it.").format(
                    index=index + 1, time=one.time
                )
            )
        selected = film.selected == index
        side = px(7 if hovered or selected else 6)
        colour = u32(p.accent if selected else p.text)
        corners = [
            ImVec2(at.x, at.y - side),
            ImVec2(at.x + side, at.y),
            ImVec2(at.x, at.y + side),
            ImVec2(at.x - side, at.y),
        ]
        draw.add_quad_filled(corners[0], corners[1], corners[2], corners[3], colour)
        if selected:
            draw.add_circle(at, px(11), u32(p.text), 0, px(1.5))


def _button(symbol: str, label: str, wide: bool) -> bool:
    """A button with its symbol, and its label if there is room."""
    if wide:
        return imgui.button(f"{symbol}  {label}###{label}", ImVec2(0, px(BUTTON)))
    return icon_button(f"{symbol}###{label}", BUTTON)
