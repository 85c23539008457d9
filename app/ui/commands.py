"""Everything that can be done, once: menus, shortcuts and the shortcut sheet are made from this table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from imgui_bundle import imgui

__all__ = ["Command", "press_shortcuts"]

Key, Ctrl, Shift = imgui.Key, imgui.Key.mod_ctrl, imgui.Key.mod_shift


@dataclass(frozen=True)
class Command:
    """One thing to do."""

    menu: str
    label: str
    act: Callable[[], None]
    keys: str = ""
    """As people read it, for example 'Ctrl+Shift+Z'."""
    chord: int = 0
    """As ImGui reads it; 0: no shortcut."""
    can: Callable[[], bool] = lambda: True
    on: Callable[[], bool] | None = None
    """Shows a check mark."""
    gap: bool = False
    """A line above it in the menu."""


def press_shortcuts(commands: list[Command]) -> None:
    """Runs the command whose keys were pressed; typing in a field is not a shortcut."""
    if imgui.get_io().want_text_input or imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        return
    for command in commands:
        if command.chord and imgui.is_key_chord_pressed(command.chord) and command.can():
            command.act()
            return
