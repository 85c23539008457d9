"""The window for slicing evenly: across which axis, and into how many slices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import ImVec2, imgui

from app.model.knife import slice_evenly
from app.session.session import Session
from app.translation import _
from app.ui.panels.cut_details import presets
from app.ui.theme import Fonts, px
from app.ui.widgets import cancel_button, font, main_button, modal, row_label, secondary

__all__ = ["SlicesWindow"]

MOST = 30
"""Most slices: more would be thinner than anybody cuts by hand, and take the window longer than a moment."""


class SlicesWindow:
    """A modal window that offers the last choice again."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.requested = False
        self.count = 5
        self.across = _("Level")

    def open(self) -> None:
        """Opens the window in the next frame."""
        self.requested = True

    def show(self) -> None:
        """Draws one frame."""
        if self.requested:
            imgui.open_popup("Slices")
        with modal("Slices", 340) as opened:
            if opened:
                self._body()

    def _body(self) -> None:
        with font(Fonts.bold):
            imgui.text_unformatted(_("Slice evenly"))
        selected = bool(self.session.selected)
        secondary(
            _("What is selected, in slices of one thickness.")
            if selected
            else _("All of it, in slices of one thickness."),
            wrap=True,
        )
        imgui.dummy(ImVec2(0, px(4)))
        normals = presets(np.asarray(self.session.up))
        row_label(_("Slices"), 90)
        self.count = min(max(2, imgui.slider_int("##count", self.count, 2, MOST)[1]), MOST)
        row_label(_("Cuts"), 90)
        if imgui.begin_combo("##across", self.across):
            for name in normals:
                if imgui.selectable(name, name == self.across)[0]:
                    self.across = name
            imgui.end_combo()
        imgui.dummy(ImVec2(0, px(6)))
        if main_button(_("Slice"), px(150)):
            self._slice(normals[self.across])
            self.requested = False
        imgui.same_line()
        if cancel_button():
            self.requested = False
        if not self.requested:
            imgui.close_current_popup()

    def _slice(self, normal: np.ndarray) -> None:
        session = self.session
        sliced = slice_evenly(session.document, session.solid, normal, self.count, session.selected)
        if sliced is None:
            session.notify(_("There is nothing shown to slice."))
            return
        session.viewing = replace(session.viewing, mode="solid" if session.mode == "capture" else session.mode)
        session.change(_("Slice evenly"), sliced)
        session.notify(_("Cut into {count} slices.").format(count=self.count))
