"""Widgets that several panels use."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from imgui_bundle import ImVec2, ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.model.document import MARKS, Mark
from app.translation import _
from app.ui.theme import Fonts, palette, px, rgba, u32
from engine.io.fields import LONGEST_TEXT

__all__ = [
    "MARK_ICONS",
    "MARK_NAMES",
    "cancel_button",
    "clipped",
    "colours",
    "disabled",
    "float_slider",
    "format_duration",
    "heading",
    "icon_button",
    "int_slider",
    "key_caps",
    "key_caps_width",
    "knife_icon",
    "list_row",
    "main_button",
    "mark_colour",
    "modal",
    "range_slider",
    "row_label",
    "secondary",
    "segmented",
    "share",
    "text_field",
    "thin_bar",
    "tooltip",
]


MARK_ICONS: dict[Mark, str] = {
    "circle": icon.ICON_FA_CIRCLE,
    "square": icon.ICON_FA_SQUARE,
    "star": icon.ICON_FA_STAR,
    "heart": icon.ICON_FA_HEART,
    "moon": icon.ICON_FA_MOON,
    "bolt": icon.ICON_FA_BOLT,
}


MARK_NAMES: dict[Mark, str] = {
    "circle": _("Circle"),
    "square": _("Square"),
    "star": _("Star"),
    "heart": _("Heart"),
    "moon": _("Moon"),
    "bolt": _("Bolt"),
}

KEY_INSET, KEY_GAP = 6, 4
"""Space on either side of a key's name and between keys, in pixels."""


def mark_colour(mark: Mark) -> str:
    """The colour of a mark, '#RRGGBB'."""
    return palette().marks[MARKS.index(mark)]


def tooltip(text: str, keys: str = "") -> None:
    """Shows what the last item does, and its shortcut, while the pointer is on it, where it covers no other item."""
    if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip | imgui.HoveredFlags_.allow_when_disabled):
        lines = imgui.calc_text_size(text, False, px(300))
        after = imgui.calc_text_size(keys).x + imgui.get_style().item_spacing.x if keys else 0.0
        _place_tooltip(lines.x + after + 2 * px(9), lines.y + 2 * px(6))
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(9), px(6)))
        if imgui.begin_tooltip():
            imgui.push_text_wrap_pos(px(300))
            imgui.text_unformatted(text)
            imgui.pop_text_wrap_pos()
            if keys:
                imgui.same_line()
                imgui.text_disabled(keys)
            imgui.end_tooltip()
        imgui.pop_style_var()


def _place_tooltip(wide: float, tall: float) -> None:
    """Places a tooltip of this size beside a narrow window, on the side with more room; in a wide window, or where
    neither side has enough, below the item or above it, within the screen."""
    low, high, space = imgui.get_item_rect_min(), imgui.get_item_rect_max(), px(8)
    left, width, middle = imgui.get_window_pos().x, imgui.get_window_size().x, (low.y + high.y) / 2
    screen = imgui.get_main_viewport()
    before, after = left - screen.pos.x, screen.pos.x + screen.size.x - left - width
    if width > px(600) or max(before, after) < wide + space:
        below = high.y + space + tall < screen.pos.y + screen.size.y
        x = max(min(low.x, screen.pos.x + screen.size.x - wide - space), screen.pos.x)
        imgui.set_next_window_pos(ImVec2(x, high.y + space if below else low.y - space - tall))
    elif before > after:
        imgui.set_next_window_pos(ImVec2(left - space, middle), imgui.Cond_.always, ImVec2(1, 0.5))
    else:
        imgui.set_next_window_pos(ImVec2(left + width + space, middle), imgui.Cond_.always, ImVec2(0, 0.5))


def key_caps(keys: str) -> None:
    """Draws a shortcut as keys: 'Ctrl+Z' as two keys."""
    p, draw, inset = palette(), imgui.get_window_draw_list(), ImVec2(px(KEY_INSET), px(2))
    for number, key in enumerate(_each_key(keys)):
        if number:
            imgui.same_line(0, px(KEY_GAP))
        size = imgui.calc_text_size(key)
        low = imgui.get_cursor_screen_pos()
        high = ImVec2(low.x + size.x + 2 * inset.x, low.y + size.y + 2 * inset.y)
        draw.add_rect_filled(low, high, u32(p.field), px(4))
        draw.add_rect(low, high, u32(p.line), px(4))
        draw.add_line(ImVec2(low.x + px(3), high.y), ImVec2(high.x - px(3), high.y), u32(p.pressed), px(2))
        draw.add_text(ImVec2(low.x + inset.x, low.y + inset.y), u32(p.text), key)
        imgui.dummy(ImVec2(high.x - low.x, high.y - low.y))


def key_caps_width(keys: str) -> float:
    """How wide `key_caps` draws a shortcut."""
    each = _each_key(keys)
    return sum(imgui.calc_text_size(key).x + 2 * px(KEY_INSET) for key in each) + (len(each) - 1) * px(KEY_GAP)


def _each_key(keys: str) -> list[str]:
    return re.split(r"(?<=[^+])\+", keys)


def knife_icon(draw: imgui.ImDrawList, low: ImVec2, high: ImVec2, colour: int) -> None:
    """Draws a kitchen knife in a square, its blade pointing up to the left, since the font has no such icon."""
    side = high.x - low.x

    def at(x: float, y: float) -> ImVec2:
        return ImVec2(low.x + x * side, low.y + y * side)

    draw.path_line_to(at(0.24, 0.24))
    draw.path_bezier_quadratic_curve_to(at(0.25, 0.52), at(0.50, 0.66))
    draw.path_line_to(at(0.60, 0.56))
    draw.path_fill_convex(colour)
    draw.add_line(at(0.60, 0.61), at(0.75, 0.76), colour, 0.105 * side)


@contextmanager
def disabled(when: bool) -> Iterator[None]:
    """Greys out and disables the items in the block."""
    imgui.begin_disabled(when)
    yield
    imgui.end_disabled()


@contextmanager
def font(kind: imgui.ImFont | None) -> Iterator[None]:
    """Uses another loaded font, at its own size, in the block."""
    if kind is None:
        yield
        return
    imgui.push_font(kind, kind.legacy_size)
    yield
    imgui.pop_font()


@contextmanager
def colours(**roles: ImVec4) -> Iterator[None]:
    """Uses other colours in the block, given by their names in `imgui.Col_`."""
    for role, colour in roles.items():
        imgui.push_style_color(getattr(imgui.Col_, role), colour)
    yield
    imgui.pop_style_color(len(roles))


@contextmanager
def modal(name: str, width: float) -> Iterator[bool]:
    """A modal window in the middle, in front of all others, which the block fills; yields whether it is open."""
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
    imgui.set_next_window_size(ImVec2(px(width), 0))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(18), px(16)))
    flags = imgui.WindowFlags_.no_title_bar | imgui.WindowFlags_.no_resize
    opened = imgui.begin_popup_modal(name, None, flags)[0]
    yield opened
    if opened:
        imgui.end_popup()
    imgui.pop_style_var()


def cancel_button() -> bool:
    """Draws the button that cancels a modal window; true if it or Esc was pressed."""
    return imgui.button(_("Cancel"), ImVec2(px(90), px(32))) or imgui.is_key_pressed(imgui.Key.escape)


def heading(text: str) -> None:
    """Draws the heading of a section of the inspector."""
    imgui.dummy(ImVec2(0, px(2)))
    with font(Fonts.bold):
        imgui.text_unformatted(text)
    imgui.separator()
    imgui.dummy(ImVec2(0, px(1)))


def secondary(text: str, wrap: bool = False) -> None:
    """Draws secondary text, in a weaker colour."""
    with colours(text=rgba(palette().second)):
        imgui.text_wrapped(text) if wrap else imgui.text_unformatted(text)


def row_label(text: str, width: float) -> None:
    """Labels the next item, at its left in a column `width` units wide; the item takes the rest of the row."""
    imgui.align_text_to_frame_padding()
    secondary(text)
    imgui.same_line(px(width))
    imgui.set_next_item_width(-1)


def list_row(label: str, chosen: bool, width: float, height: float) -> bool:
    """Draws a line of a list; returns whether it was clicked. `width` in ImGui's units, `height` in those of `px`."""
    imgui.push_style_var(imgui.StyleVar_.selectable_text_align, ImVec2(0.0, 0.5))
    clicked = imgui.selectable(label, chosen, 0, ImVec2(width, px(height)))[0]
    imgui.pop_style_var()
    return clicked


def clipped(text: str, width: float) -> str:
    """The text, or as much of its beginning as fits into `width`, with an ellipsis."""
    if imgui.calc_text_size(text).x <= width:
        return text
    fits = bisect_left(range(len(text)), width, key=lambda count: imgui.calc_text_size(f"{text[:count]}…").x)
    return f"{text[: max(fits - 1, 0)].rstrip()}…"


def right_text(text: str) -> None:
    """Draws secondary text on the same line, aligned to the right edge."""
    imgui.same_line()
    right = imgui.get_cursor_pos_x() + imgui.get_content_region_avail().x
    imgui.set_cursor_pos_x(max(imgui.get_cursor_pos_x(), right - imgui.calc_text_size(text).x))
    secondary(text)


def icon_button(label: str, size: float, active: bool = False, quiet: bool = False, colour: str = "") -> bool:
    """A square button with an icon; an active one is accented, a quiet one has no background until it is hovered.

    `colour`: the icon's, '#RRGGBB'; empty: that of text.
    """
    p = palette()
    if active:
        button = hovered = pressed = rgba(p.accent)
    else:
        button, hovered, pressed = rgba(p.field, 0.0 if quiet else 1.0), rgba(p.hover), rgba(p.pressed)
    text = rgba(p.on_accent if active else colour or p.text)
    imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(0, 0))
    with colours(button=button, button_hovered=hovered, button_active=pressed, text=text):
        clicked = imgui.button(label, ImVec2(px(size), px(size)))
    imgui.pop_style_var()
    return clicked


def main_button(label: str, width: float = -1.0) -> bool:
    """A button for the main action; wider than `width` if its label needs it."""
    p = palette()
    if width > 0:
        width = max(width, imgui.calc_text_size(label).x + 2 * imgui.get_style().frame_padding.x)
    usual, hovered, pressed = map(rgba, (p.accent, p.accent_hovered, p.accent_pressed))
    with colours(button=usual, button_hovered=hovered, button_active=pressed, text=rgba(p.on_accent)):
        return imgui.button(label, ImVec2(width, px(32)))


def share(width: float, *labels: str) -> float:
    """Width of each of these buttons side by side in `width`; -1, for a row each, if a label needs more room."""
    each = (width - (len(labels) - 1) * imgui.get_style().item_spacing.x) / len(labels)
    return each if max(imgui.calc_text_size(label).x for label in labels) + px(12) < each else -1.0


def segmented(name: str, labels: Sequence[str], current: int, width: float, hints: Sequence[str] = ()) -> int:
    """A choice of one among labels side by side, or in a list if they have no room; returns the chosen index.

    `width`: of all of them together, window units.
    """
    p = palette()
    if max(imgui.calc_text_size(label).x for label in labels) + px(6) > width / len(labels):
        return _listed(name, labels, current, width, hints)
    each, height = width / len(labels), imgui.get_frame_height()
    origin = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(origin, ImVec2(origin.x + width, origin.y + height), u32(p.field), px(5))
    imgui.begin_group()
    for index, label in enumerate(labels):
        low = ImVec2(origin.x + each * index, origin.y)
        imgui.set_cursor_screen_pos(low)
        if imgui.invisible_button(f"{label}##{name}", ImVec2(each, height), imgui.ButtonFlags_.enable_nav):
            current = index
        hovered = imgui.is_item_hovered()
        if hints:
            tooltip(hints[index])
        high = ImVec2(low.x + each, low.y + height)
        if index == current:
            inset = px(2)
            draw.add_rect_filled(
                ImVec2(low.x + inset, low.y + inset), ImVec2(high.x - inset, high.y - inset), u32(p.pressed), px(4)
            )
        size = imgui.calc_text_size(label)
        draw.add_text(
            ImVec2(low.x + (each - size.x) / 2, low.y + (height - size.y) / 2),
            u32(p.text if index == current or hovered else p.second),
            label,
        )
    imgui.end_group()
    return current


def _listed(name: str, labels: Sequence[str], current: int, width: float, hints: Sequence[str]) -> int:
    """The same choice as a drop-down list."""
    imgui.set_next_item_width(width)
    if imgui.begin_combo(f"##{name}", labels[current], imgui.ComboFlags_.no_arrow_button):
        for index, label in enumerate(labels):
            if imgui.selectable(label, index == current)[0]:
                current = index
            if hints:
                tooltip(hints[index])
        imgui.end_combo()
    return current


def float_slider(
    name: str, value: float, low: float, high: float, hint: str, width: float = -1.0, text: str = ""
) -> tuple[bool, float]:
    """A slider with its number, or `text`, at the right. A double click or Ctrl+click lets the user type the number, of
    which the nearest in [low, high] is taken."""
    margin = imgui.calc_text_size("-00.00").x + px(6)
    full = imgui.get_content_region_avail().x if width < 0 else width
    imgui.set_next_item_width(full - margin)
    changed, new = imgui.slider_float(name, value, low, high, "", imgui.SliderFlags_.always_clamp)
    changed = changed and math.isfinite(new)
    value = new if changed else value
    tooltip(hint)
    _number_at_right(text or f"{value if abs(value) >= 0.005 else 0.0:.2f}", margin)
    return changed, value


def text_field(name: str, text: str, hint: str = "", flags: int = 0) -> tuple[bool, str]:
    """A field for as much text as a project file may hold."""
    changed, new = imgui.input_text_with_hint(name, hint, text, flags)
    return changed, new[:LONGEST_TEXT]


def int_slider(name: str, value: int, low: int, high: int) -> tuple[bool, int]:
    """A slider for integers, as wide as possible, with its number at the right."""
    margin = imgui.calc_text_size("0000").x + px(6)
    imgui.set_next_item_width(imgui.get_content_region_avail().x - margin)
    changed, value = imgui.slider_int(name, value, low, high, "", imgui.SliderFlags_.always_clamp)
    _number_at_right(str(value), margin)
    return changed, value


def range_slider(name: str, ends: tuple[float, float], hint: str) -> tuple[bool, tuple[float, float]]:
    """A slider with two ends in [0, 1], at least 0.01 apart. A drag moves the nearer one, a double click selects all.

    By keyboard the left and right arrow move the lower end, and with Shift the upper one.
    """
    p, draw = palette(), imgui.get_window_draw_list()
    margin = imgui.calc_text_size("0000").x + px(6)
    width, height = imgui.get_content_region_avail().x - margin, imgui.get_frame_height()
    origin, grab, inset = imgui.get_cursor_screen_pos(), px(10), px(2)
    track = width - 2 * inset - grab
    imgui.invisible_button(name, ImVec2(width, height), imgui.ButtonFlags_.enable_nav)
    hovered, active = imgui.is_item_hovered(), imgui.is_item_active()
    at = (imgui.get_mouse_pos().x - origin.x - inset - grab / 2) / track
    storage, key = imgui.get_state_storage(), imgui.get_id(name)
    if imgui.is_item_activated():
        first = abs(at - ends[0]) < abs(at - ends[1]) or (ends[0] == ends[1] and at < ends[0])
        storage.set_int(key, 0 if first else 1)
    new = ends
    if hovered and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
        new = (0.0, 1.0)
    elif active and imgui.is_mouse_dragging(imgui.MouseButton_.left, 1.0):
        at = round(min(1.0, max(0.0, at)), 2)
        new = (min(at, ends[1] - 0.01), ends[1]) if storage.get_int(key) == 0 else (ends[0], max(at, ends[0] + 0.01))
        new = (round(max(new[0], 0.0), 2), round(min(new[1], 1.0), 2))
    elif imgui.is_item_focused():
        new = _pressed_ends(ends)
    low, high = (origin.x + inset + part * track for part in new)
    draw.add_rect_filled(
        origin, ImVec2(origin.x + width, origin.y + height), u32(p.hover if hovered or active else p.field), px(5)
    )
    top, bottom = origin.y + inset, origin.y + height - inset
    draw.add_rect_filled(ImVec2(low, top), ImVec2(high + grab, bottom), u32(p.pressed), px(4))
    for x in (low, high):
        draw.add_rect_filled(ImVec2(x, top), ImVec2(x + grab, bottom), u32(p.text if active else p.second), px(4))
    tooltip(hint)
    _number_at_right(_("all") if new == (0.0, 1.0) else f"{new[1] - new[0]:.0%}", margin)
    return new != ends, new


def _pressed_ends(ends: tuple[float, float]) -> tuple[float, float]:
    """The ends of a range after a press of the left or right arrow: it moves the lower end, with Shift the upper."""
    low, high = ends
    for key, step in ((imgui.Key.left_arrow, -0.01), (imgui.Key.right_arrow, 0.01)):
        imgui.internal.set_key_owner(key, imgui.get_item_id())
        if imgui.is_key_pressed(key) and imgui.get_io().key_shift:
            high = min(1.0, max(high + step, low + 0.01))
        elif imgui.is_key_pressed(key):
            low = max(0.0, min(low + step, high - 0.01))
    return round(low, 2), round(high, 2)


def _number_at_right(text: str, margin: float) -> None:
    """Draws text that ends `margin` to the right of the last item, vertically centred on it."""
    low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
    size = imgui.calc_text_size(text)
    at = ImVec2(high.x + margin - size.x, (low.y + high.y - size.y) / 2)
    imgui.get_window_draw_list().add_text(at, u32(palette().text), text)
    imgui.same_line(0, 0)
    imgui.dummy(ImVec2(margin, high.y - low.y))


def thin_bar(part: float, paused: bool = False) -> None:
    """A thin progress bar."""
    p = palette()
    width, height = imgui.get_content_region_avail().x, px(5)
    low = imgui.get_cursor_screen_pos()
    draw = imgui.get_window_draw_list()
    draw.add_rect_filled(low, ImVec2(low.x + width, low.y + height), u32(p.field), height / 2)
    if part > 0:
        end = low.x + max(height, width * min(part, 1.0))
        draw.add_rect_filled(low, ImVec2(end, low.y + height), u32(p.second if paused else p.accent), height / 2)
    imgui.dummy(ImVec2(width, height))


def format_duration(seconds: float) -> str:
    """The time as minutes and seconds, with hours if there are any: '1:05', '2:03:10'."""
    hours, rest = divmod(round(max(seconds, 0.0)), 3600)
    return f"{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{rest // 60}:{rest % 60:02d}"


def eye_icon(on: bool) -> str:
    """The icon for something shown or hidden."""
    return icon.ICON_FA_EYE if on else icon.ICON_FA_EYE_SLASH
