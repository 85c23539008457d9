"""The window for slicing evenly: across which axis, and into how many."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import ImVec2, imgui

from app.model.knife import slice_evenly
from app.session.session import Session
from app.ui.panels.cut_details import presets
from app.ui.theme import Fonts, px
from app.ui.widgets import font, main_button, secondary

__all__ = ["SlicesWindow"]

MOST = 30
"""Slices: more are thinner than the strokes of anybody's knife, and take the window longer than a moment."""


class SlicesWindow:
    """A modal window; what was chosen last is offered again."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.requested = False
        self.count = 5
        self.across = "Level"

    def open(self) -> None:
        """Opens it with the next frame."""
        self.requested = True

    def show(self) -> None:
        """One frame."""
        if self.requested:
            imgui.open_popup("Slices")
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
        imgui.set_next_window_size(ImVec2(px(340), 0))
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(px(18), px(16)))
        flags = imgui.WindowFlags_.no_title_bar | imgui.WindowFlags_.no_resize
        if imgui.begin_popup_modal("Slices", None, flags)[0]:
            self._body()
            imgui.end_popup()
        imgui.pop_style_var()

    def _body(self) -> None:
        with font(Fonts.bold):
            imgui.text_unformatted("Slice evenly")
        selected = bool(self.session.selection)
        secondary(
            "What is selected, in slices of one thickness." if selected else "All of it, in slices of one thickness."
        )
        imgui.dummy(ImVec2(0, px(4)))
        normals = presets(np.asarray(self.session.up))
        for text in ("Slices", "Cuts"):
            imgui.align_text_to_frame_padding()
            secondary(text)
            imgui.same_line(px(90))
            imgui.set_next_item_width(-1)
            if text == "Slices":
                self.count = min(max(2, imgui.slider_int("##count", self.count, 2, MOST)[1]), MOST)
            elif imgui.begin_combo("##across", self.across):
                for name in normals:
                    if imgui.selectable(name, name == self.across)[0]:
                        self.across = name
                imgui.end_combo()
        imgui.dummy(ImVec2(0, px(6)))
        if main_button("Slice", px(150)):
            self._slice(normals[self.across])
            self.requested = False
        imgui.same_line()
        if imgui.button("Cancel", ImVec2(px(90), px(32))) or imgui.is_key_pressed(imgui.Key.escape):
            self.requested = False
        if not self.requested:
            imgui.close_current_popup()

    def _slice(self, normal: np.ndarray) -> None:
        session = self.session
        sliced = slice_evenly(session.document, session.solid, normal, self.count, session.selection)
        if sliced is None:
            session.notify("There is nothing shown to slice.")
            return
        session.viewing = replace(session.viewing, mode="solid" if session.mode == "capture" else session.mode)
        session.change("Slice evenly", sliced)
        session.notify(f"Cut into {self.count} slices.")
