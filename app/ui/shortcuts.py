"""The list of everything that keys and the pointer do, drawn over the window."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, pairwise
from typing import TypeAlias

from imgui_bundle import ImVec2, imgui

from app.translation import _
from app.ui.commands import Command
from app.ui.theme import Fonts, palette, px, rgba
from app.ui.widgets import font, key_caps, key_caps_width, secondary

__all__ = ["show_shortcuts"]

POINTER = (
    (_("Drag"), _("Look around, or use the tool")),
    (_("Right drag"), _("Look around")),
    (_("Alt+Drag"), _("Look around with any tool")),
    (_("Middle drag"), _("Shift the picture")),
    (_("Shift+Right drag"), _("Shift the picture")),
    (_("Wheel"), _("Nearer, to the pointer")),
    (_("Ctrl+Click"), _("Select several pieces")),
    (_("Wheel"), _("The next cut, in a slice")),
    (_("Ctrl+Wheel"), _("Nearer, in a slice")),
    (_("Shift"), _("Level and upright, while cutting")),
    (_("Esc"), _("Do not cut, while cutting")),
    (_("Shift"), _("Select more, while isolating")),
    (_("Alt"), _("Select less, while isolating")),
)
"""What the pointer does, for the list of shortcuts."""

KEYBOARD = (
    ("F6", _("The next part of the window")),
    (_("Tab"), _("The next control")),
    (_("Enter"), _("Press it; with the knife: place a plane, cut")),
    (_("Arrows"), _("Look around; move and tilt the plane or piece")),
    (_("Shift+Arrows"), _("Shift the picture; turn the plane")),
    (_("Ctrl+Arrows"), _("The same, finely")),
    ("+", _("Nearer; - farther")),
    ("F10", _("The menus")),
    (_("Space"), _("The button of a pointer moved by keys")),
    (_("Enter"), _("Hold that button; let it go")),
)
"""What keys do apart from the commands, for the same list."""

MOST_COLUMNS, GAP, PADDING = 4, 36, (22, 18)
"""Columns on a wide screen, and the space between them and around the list in pixels."""

Group: TypeAlias = tuple[str, list[tuple[str, str]]]
"""A title, and keys with what they do."""


def show_shortcuts(commands: Sequence[Command], menus: Mapping[str, str]) -> bool:
    """Draws one frame of the list; returns whether it stays open. `menus`: titles in the menu bar's order, by the names
    in commands."""
    screen, stays = imgui.get_main_viewport(), True
    imgui.set_next_window_pos(screen.get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
    imgui.set_next_window_size_constraints(ImVec2(0, 0), screen.work_size)
    imgui.push_style_color(imgui.Col_.window_bg, rgba(palette().panel, 0.98))
    imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(PADDING[0]), px(PADDING[1])))
    flags = imgui.WindowFlags_.no_title_bar | imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.no_docking
    flags |= imgui.WindowFlags_.horizontal_scrollbar
    imgui.begin("##shortcuts", None, flags | imgui.WindowFlags_.no_saved_settings)
    with font(Fonts.bold):
        imgui.text_unformatted(_("Shortcuts"))
    imgui.separator()
    groups = [(_("Pointer"), [*POINTER]), (_("Keyboard"), [*KEYBOARD])]
    groups += [(title, found) for menu, title in menus.items() if (found := _keys(commands, menu))]
    room = screen.work_size.x - 2 * px(PADDING[0]) - imgui.get_style().scrollbar_size
    for number, column in enumerate(_columns(groups, room)):
        if number:
            imgui.same_line(0, px(GAP))
        imgui.begin_group()
        for title, rows in column:
            secondary(title)
            if imgui.begin_table(f"##{title}", 2, imgui.TableFlags_.sizing_fixed_fit):
                for keys, label in rows:
                    imgui.table_next_row()
                    imgui.table_next_column()
                    key_caps(keys)
                    imgui.table_next_column()
                    imgui.text_unformatted(label)
                imgui.end_table()
            imgui.dummy(ImVec2(0, px(4)))
        imgui.end_group()
    outside = imgui.is_mouse_clicked(imgui.MouseButton_.left) and not imgui.is_window_hovered()
    if outside or imgui.is_key_pressed(imgui.Key.escape):
        stays = False
    imgui.end()
    imgui.pop_style_var()
    imgui.pop_style_color()
    return stays


def _columns(groups: list[Group], room: float) -> list[list[Group]]:
    """The groups, in their order, in as many columns as are `room` pixels wide together, and as low as these can be."""
    widths = [max(imgui.calc_text_size(title).x, _width(rows)) for title, rows in groups]
    heights = [len(rows) + 2 for _, rows in groups]  # in lines, with a title and the space below

    def tallest(ends: Iterable[int]) -> int:
        return max(sum(heights[first:end]) for first, end in pairwise(ends))

    for count in range(MOST_COLUMNS, 1, -1):
        divided = [(0, *cuts, len(groups)) for cuts in combinations(range(1, len(groups)), count - 1)]
        gaps = (count - 1) * px(GAP)
        fits = [ends for ends in divided if sum(max(widths[a:b]) for a, b in pairwise(ends)) + gaps <= room]
        if fits:
            return [groups[first:end] for first, end in pairwise(min(fits, key=tallest))]
    return [groups]


def _width(rows: list[tuple[str, str]]) -> float:
    """How wide the table of these rows is."""
    keys = max((key_caps_width(keys) for keys, _ in rows), default=0.0)
    labels = max((imgui.calc_text_size(label).x for _, label in rows), default=0.0)
    return keys + labels + 4 * imgui.get_style().cell_padding.x


def _keys(commands: Sequence[Command], menu: str) -> list[tuple[str, str]]:
    """Shortcuts and names of a menu's commands, in the menu's order."""
    return [(c.keys, c.label.removesuffix("...")) for c in commands if c.keys and c.menu == menu]
