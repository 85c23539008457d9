"""Commands, which menus, keyboard shortcuts and the list of shortcuts are made from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import imgui

__all__ = ["Command", "press_shortcuts"]

Key, Ctrl, Shift = imgui.Key, imgui.Key.mod_ctrl, imgui.Key.mod_shift


@dataclass(frozen=True)
class Command:
    """An action of the user, with its place in the menus and its shortcut."""

    menu: str
    label: str
    act: Callable[[], None]
    keys: str = ""
    """The shortcut as shown, for example 'Ctrl+Shift+Z'."""
    chord: int = 0
    """The shortcut as ImGui's key chord; 0: none."""
    enabled: Callable[[], bool] = lambda: True
    checked: Callable[[], bool] | None = None
    """Whether the menu shows a check mark; None: it never does."""
    separated: bool = False
    """Whether the menu has a separator above it."""


def press_shortcuts(commands: list[Command], pressing: bool) -> None:
    """Runs the command whose shortcut was pressed, unless the user is typing into a field or a popup is open.

    `pressing`: whether a control has the keyboard focus, so that Space presses it and is not a shortcut.
    """
    if imgui.get_io().want_text_input or imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        return
    for command in commands:
        if pressing and command.chord == Key.space:
            continue
        if command.chord and imgui.is_key_chord_pressed(command.chord) and command.enabled():
            command.act()
            return
