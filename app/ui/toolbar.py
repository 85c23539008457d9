"""The tools at the left edge of the window."""

from __future__ import annotations

from collections.abc import Callable

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.session.session import Session
from app.session.workspace import TOOLS, Tool
from app.translation import _
from app.ui.dialogs.export_window import ExportWindow
from app.ui.theme import palette, px, u32
from app.ui.view.viewport import Viewport
from app.ui.widgets import icon_button, knife_icon, tooltip

__all__ = ["TOOL_ICONS", "TOOL_NAMES", "Toolbar"]

TOOL_ICONS: dict[Tool, tuple[str, str, str]] = {
    "select": (icon.ICON_FA_ARROW_POINTER, _("Select pieces; drag to look around"), "V"),
    "knife": ("", _("Knife: drag across the object to cut it"), "K"),
    "blade": (icon.ICON_FA_SCISSORS, _("Blade: draw the line to cut along, or all around a shape"), "B"),
    "plane": (icon.ICON_FA_LAYER_GROUP, _("Plane: drag to open the object along a plane"), "P"),
    "move": (icon.ICON_FA_UP_DOWN_LEFT_RIGHT, _("Move pieces"), "M"),
    "turn": (icon.ICON_FA_ROTATE, _("Turn pieces"), "T"),
    "upright": (icon.ICON_FA_ARROWS_DOWN_TO_LINE, _("Upright: click the face it stands on, or turn it"), "U"),
    "isolate": (icon.ICON_FA_CROP_SIMPLE, _("Isolate: say what of the capture is the object"), "I"),
}


TOOL_NAMES: dict[Tool, str] = {
    "select": _("Select"),
    "knife": _("Knife"),
    "blade": _("Blade"),
    "plane": _("Plane"),
    "move": _("Move"),
    "turn": _("Turn"),
    "upright": _("Upright"),
    "isolate": _("Isolate"),
}

SMALLEST = 26.0
"""Smallest side of a button at 96 DPI, for low windows; in a still lower one the buttons scroll."""


class Toolbar:
    """Draws the tools."""

    def __init__(
        self, session: Session, viewport: Viewport, export: ExportWindow, toggle_slices: Callable[[], None]
    ) -> None:
        self.session, self.viewport, self.export, self.toggle_slices = session, viewport, export, toggle_slices

    def show(self) -> None:
        """Draws one frame."""
        rows = len(TOOLS) + 3
        each = imgui.get_content_region_avail().y / px(rows)
        gap = min(8.0, max(3.0, 0.17 * each))
        side = min(38.0, max(SMALLEST, each - gap - 2 / rows))
        imgui.push_style_var(imgui.StyleVar_.item_spacing, ImVec2(px(gap), px(gap)))
        imgui.push_style_var(imgui.StyleVar_.scrollbar_size, px(4))
        imgui.begin_child("##tools", ImVec2(0, 0), imgui.ChildFlags_.nav_flattened)
        for tool in TOOLS:
            symbol, hint, keys = TOOL_ICONS[tool]
            active = self.session.tool == tool
            if icon_button(f"{symbol}##{tool}", side, active=active):
                self.session.select_tool(tool)
            if tool == "knife":
                colour = u32(palette().on_accent if active else palette().text)
                knife_icon(imgui.get_window_draw_list(), imgui.get_item_rect_min(), imgui.get_item_rect_max(), colour)
            tooltip(hint, keys)
        imgui.dummy(ImVec2(0, px(2)))
        if icon_button(f"{icon.ICON_FA_TABLE_CELLS_LARGE}##slices", side, active=self.session.viewing.slices):
            self.toggle_slices()
        tooltip(_("Slices: three cut faces beside the object"), "S")
        if icon_button(f"{icon.ICON_FA_EXPAND}##fit", side):
            self.viewport.fit()
        tooltip(_("Fit the object into the picture"), "F")
        if icon_button(f"{icon.ICON_FA_CAMERA}##picture", side):
            self.export.open("picture")
        tooltip(_("Save a picture"), "Ctrl+E")
        imgui.end_child()
        imgui.pop_style_var(2)
