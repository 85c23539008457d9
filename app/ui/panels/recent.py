"""The content of the empty window: what to do first, and recent files with their pictures."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import moderngl
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.session.recent_pictures import SIZE, keep_picture, picture_of, remove_pictures
from app.session.session import Session
from app.translation import _
from app.ui.panels.thumbnails import Thumbnails
from app.ui.theme import Fonts, palette, px, u32
from app.ui.view.painter import Painter
from app.ui.widgets import clipped, font, icon_button, main_button, secondary, tooltip

__all__ = ["RecentFiles"]

EVERY = 3.0
"""Seconds between two checks of which files still exist."""

CARD = 196.0
"""Width of a card at 96 DPI."""

COLUMNS = 4
"""Most cards side by side."""


class RecentFiles:
    """Keeps a picture of what is open, and draws the pictures of recent files."""

    def __init__(self, session: Session, painter: Painter, ctx: moderngl.Context) -> None:
        self.session, self.painter = session, painter
        self.thumbnails = Thumbnails(ctx, max(SIZE))
        self.missing: frozenset[str] = frozenset()
        """Recent files that did not exist at the last check."""
        self._looked = -EVERY
        self._looking: threading.Thread | None = None
        self._kept: object = None
        """What the last picture was of."""

    def keep(self) -> None:
        """Keeps a picture of what is shown, once for each file, save and solid. Call it while nothing moves."""
        session = self.session
        key = (session.path or session.document.scene, id(session.history.saved), session.geometry_version)
        if key == self._kept or session.object is None or session.loader is not None:
            return
        pixels = self.painter.snapshot()
        if pixels is None:
            return
        self._kept, name = key, session.files.recent_name
        if name is not None:
            keep_picture(name, pixels)
            remove_pictures(session.settings.recent)

    def show(
        self, origin: ImVec2, size: tuple[int, int], open_: Callable[[], None], sample: Callable[[], None]
    ) -> None:
        """Draws one frame, in the middle of a rectangle."""
        names = self.session.settings.recent
        gap, margin = px(16), px(20)
        width = min(px(CARD), size[0] - 2 * margin)
        columns = max(1, min(COLUMNS, int((size[0] - 2 * margin + gap) / (width + gap)), len(names)))
        rows = -(-len(names) // columns)
        card = width * SIZE[1] / SIZE[0] + px(52)
        top, room = px(16), size[1] - px(32)
        height = min(room, px(150) + (px(40) + rows * (card + gap) if names else 0))
        full = max(columns * (width + gap) - gap, min(px(300), size[0] - 2 * margin))
        left = origin.x + (size[0] - full) / 2
        imgui.set_cursor_screen_pos(ImVec2(left - px(8), origin.y + top + 0.4 * (room - height)))
        padded = imgui.ChildFlags_.always_use_window_padding | imgui.ChildFlags_.nav_flattened
        padded |= imgui.ChildFlags_.auto_resize_y
        imgui.set_next_window_size_constraints(ImVec2(0, 0), ImVec2(size[0], room))
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(8), px(4)))
        imgui.begin_child("##empty", ImVec2(full + px(16) + imgui.get_style().scrollbar_size, 0), padded)
        self._first(full, open_, sample)
        if names:
            imgui.dummy(ImVec2(0, px(10)))
            secondary(_("Open again"))
            corner = imgui.get_cursor_screen_pos()
            for index, name in enumerate(names):
                row, column = divmod(index, columns)
                imgui.set_cursor_screen_pos(ImVec2(corner.x + column * (width + gap), corner.y + row * (card + gap)))
                self._card(index, name, ImVec2(width, card))
            self._look()
        imgui.end_child()
        imgui.pop_style_var()

    def _first(self, full: float, open_: Callable[[], None], sample: Callable[[], None]) -> None:
        """Draws what to do while nothing is open."""
        with font(Fonts.bold):
            imgui.text_unformatted(_("Open a capture to slice it"))
        secondary(_("or drop it here: .ply, .splat, .spz, .sog, .ksplat, .obj, .glb"), wrap=True)
        imgui.dummy(ImVec2(0, px(2)))
        width = min(px(300), full)
        if main_button(f"{icon.ICON_FA_FOLDER_OPEN}  " + _("Open..."), width):
            open_()
        if imgui.button(_("Try the watermelon"), ImVec2(width, px(32))):
            sample()

    def _card(self, index: int, name: str, size: ImVec2) -> None:
        """Draws one recent file: its picture, name and folder."""
        p, draw, path = palette(), imgui.get_window_draw_list(), Path(name)
        low = imgui.get_cursor_screen_pos()
        high = ImVec2(low.x + size.x, low.y + size.x * SIZE[1] / SIZE[0])
        gone = name in self.missing
        imgui.set_next_item_allow_overlap()
        if imgui.invisible_button(f"##file {index}", size, imgui.ButtonFlags_.enable_nav):
            self.session.files.open(path)
        hovered = imgui.is_item_hovered()
        removed = imgui.is_item_focused() and imgui.is_key_pressed(imgui.Key.delete)
        tooltip(_("{name} is no longer there").format(name=name) if gone else name)
        texture = self.thumbnails.get(picture_of(name))
        if texture is not None:
            tint = u32("#FFFFFF", 0.35 if gone else 1.0)
            draw.add_image_rounded(imgui.ImTextureRef(texture.glo), low, high, ImVec2(0, 0), ImVec2(1, 1), tint, px(6))
        else:
            draw.add_rect_filled(low, high, u32(p.field), px(6))
            symbol, side = icon.ICON_FA_CUBE, px(30)
            at = ImVec2((low.x + high.x - side) / 2, (low.y + high.y - side) / 2)
            draw.add_text(imgui.get_font(), side, at, u32(p.second, 0.6), symbol)
        draw.add_rect(low, high, u32(p.second if hovered else p.line), px(6), px(1))
        line, below, room = imgui.get_text_line_height(), high.y + px(6), size.x - px(28)
        draw.add_text(ImVec2(low.x, below), u32(p.second if gone else p.text), clipped(path.name, room))
        words = f"{icon.ICON_FA_LINK_SLASH}  " + _("no longer there") if gone else path.parent.name or str(path.parent)
        draw.add_text(ImVec2(low.x, below + line + px(2)), u32(p.second), clipped(words, room))
        imgui.set_cursor_screen_pos(ImVec2(high.x - px(24), below - px(2)))
        removed = icon_button(f"{icon.ICON_FA_XMARK}##gone {index}", 24, quiet=True) or removed
        tooltip(_("Take it off this list"))
        if removed:
            self.session.files.forget_recent(name)

    def _look(self) -> None:
        """Checks now and then which files exist, in a thread: a drive that is gone may take long to respond."""
        now = time.monotonic()
        if now - self._looked < EVERY or (self._looking is not None and self._looking.is_alive()):
            return
        self._looked, names = now, self.session.settings.recent

        def look() -> None:
            self.missing = frozenset(name for name in names if not Path(name).is_file())

        self._looking = threading.Thread(target=look, daemon=True)
        self._looking.start()

    def release(self) -> None:
        """Frees the textures."""
        self.thumbnails.release()
