"""A pseudo-language: every word is accented, longer and in brackets. It shows which words are untranslated, and which
have no room to grow."""

from __future__ import annotations

import gettext
import re
from collections.abc import Callable
from typing import Any

from imgui_bundle import imgui

__all__ = ["Pseudo", "Watch"]

ACCENTS = str.maketrans("aeiouyAEIOUYcnszCNSZ", "àéîöüýÀÉÎÖÜÝçñšžÇÑŠŽ")
LONGER = 1.3
"""Length over English: that of German."""

OF_THE_WORLD = re.compile(
    r"(Ctrl|Shift|Alt|Esc|Del|Space|Tab|Enter|F\d+|px|mm|cm|units|WebP|GIF|PNG|MP4|fps)(?![a-z])|[\w ./-]*\.\w{2,10}"
)
"""Names of keys, units and formats, and file names: the same in all languages."""


class Pseudo(gettext.NullTranslations):
    """The catalogue of the pseudo-language."""

    def gettext(self, message: str) -> str:
        parts = re.split(r"(\{[^}]*\})", message)
        text = "".join(part if part.startswith("{") else part.translate(ACCENTS) for part in parts)
        return f"«{text}{'~' * round((LONGER - 1) * len(message))}»"

    def ngettext(self, msgid1: str, msgid2: str, n: int) -> str:
        return self.gettext(msgid1 if n == 1 else msgid2)


class Watch:
    """Watches every text that ImGui is given to draw."""

    def __init__(self) -> None:
        self.bare: set[str] = set()
        """Texts that no catalogue was asked for."""
        self.cramped: set[str] = set()
        """Labels wider than their buttons, and lines that run out of their windows."""
        for name in ("button", "checkbox", "begin_menu", "menu_item", "menu_item_simple", "selectable", "tree_node_ex"):
            self._read(name)
        for name in ("text_unformatted", "text_wrapped", "text_disabled", "begin_combo", "radio_button"):
            self._read(name)

    def _read(self, name: str) -> None:
        write: Callable[..., Any] = getattr(imgui, name)

        def read(text: str, *arguments: Any, **named: Any) -> Any:
            self._look(name, text, arguments)
            if name == "begin_combo" and arguments:
                self._look(name, arguments[0], ())
            return write(text, *arguments, **named)

        setattr(imgui, name, read)

    def _look(self, name: str, text: str, arguments: tuple[Any, ...]) -> None:
        shown = text.partition("##")[0]
        outside = re.sub(r"«.*?»", "", OF_THE_WORLD.sub("", shown), flags=re.S)
        if re.search(r"[A-Za-z]{3}", outside):
            self.bare.add(shown)
        width = imgui.calc_text_size(shown).x
        if name == "button" and arguments and 0 < arguments[0].x < width:
            self.cramped.add(shown)
        if name == "text_unformatted" and imgui.get_window_width() > 0:
            window = imgui.internal.get_current_window()
            wrapped = window.dc.text_wrap_pos >= 0
            grows = window.flags & (imgui.WindowFlags_.always_auto_resize | imgui.WindowFlags_.tooltip)
            if not wrapped and not grows and imgui.get_cursor_pos_x() + width > imgui.get_window_width() + 1:
                self.cramped.add(shown)
