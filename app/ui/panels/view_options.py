"""The options that open beside the switch of the view mode: how splats are drawn, and what is drawn over the object."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.model.project import SPLAT_SIZES
from app.session.session import Session
from app.translation import _
from app.ui.theme import Fonts, px
from app.ui.widgets import disabled, float_slider, font, icon_button, row_label, tooltip
from engine.render.culling.draw_options import SplatLook

__all__ = ["SWITCHES", "ViewOptions"]

SWITCHES = {
    _("Light on cut faces"): "face_light",
    _("Names of pieces"): "names",
    _("Body as lines"): "wires",
    _("Calm motion"): "motion",
    _("Statistics"): "statistics",
}
"""Settings that can be switched on and off, by their labels."""


class ViewOptions:
    """Draws the button and the options that it opens."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def show(self) -> None:
        """Draws one frame, to the right of the last item. The button is accented while size or opacity is altered."""
        session = self.session
        imgui.same_line(0, px(8))
        size = imgui.get_frame_height() / px(1)
        if icon_button(f"{icon.ICON_FA_SLIDERS}##options", size, active=session.viewing.splats != SplatLook()):
            imgui.open_popup("view options")
        tooltip(_("How it is drawn: size and opacity of splats, lines, names"))
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(14), px(12)))
        imgui.set_next_window_size(ImVec2(px(290), 0))
        if imgui.begin_popup("view options"):
            self._splats()
            imgui.separator()
            for label, flag in SWITCHES.items():
                changed, on = imgui.checkbox(label, getattr(session.settings, flag))
                if changed:
                    new: dict[str, Any] = {flag: on}
                    session.change_settings(replace(session.settings, **new))
            imgui.end_popup()
        imgui.pop_style_var()

    def _splats(self) -> None:
        session = self.session
        look = session.viewing.splats
        with font(Fonts.bold):
            imgui.text_unformatted(_("Splats"))
        row_label(_("Size"), 80)
        low, high = (math.log2(size) for size in SPLAT_SIZES)
        changed, power = float_slider(
            "##size", math.log2(look.size), low, high, _("Smaller: see what it is made of"), text=f"{look.size:.0%}"
        )
        if changed:
            size = 1.0 if abs(power) < 0.06 else min(max(2.0**power, SPLAT_SIZES[0]), SPLAT_SIZES[1])
            look = replace(look, size=size)
        row_label(_("Opacity"), 80)
        capture = session.mode == "capture"
        with disabled(not capture):
            hint = _("Lower: see through the capture") if capture else _("Of the capture; the solid is opaque")
            changed, opacity = float_slider("##opacity", look.opacity, 0.0, 1.0, hint, text=f"{look.opacity:.0%}")
        if changed:
            look = replace(look, opacity=opacity)
        with disabled(look == SplatLook()):
            if imgui.button(_("As they are"), ImVec2(-1, 0)):
                look = SplatLook()
        if look != session.viewing.splats:
            session.viewing = replace(session.viewing, splats=look)
