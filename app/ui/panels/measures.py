"""Measures: volume and surface area of what is selected, the last distance, and their unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import imgui

from app.jobs.measurer import Measurer
from app.model.measure.units import LENGTHS, UNITS, Unit
from app.model.pieces import Cell
from app.session.session import Session
from app.translation import _, ngettext
from app.ui.theme import px
from app.ui.view.slices import SliceViews
from app.ui.widgets import heading, right_text, secondary, tooltip

__all__ = ["MeasuresPanel"]


class MeasuresPanel:
    """A section of the inspector that is shown while there are slices or pieces are selected."""

    def __init__(self, session: Session, slices: SliceViews) -> None:
        self.session, self.slices = session, slices
        self.measurer = Measurer()

    def show(self) -> None:
        """Draws one frame."""
        session = self.session
        atoms, selected = session.atoms, session.selected
        if atoms is None or not (session.viewing.slices or selected):
            return
        heading(_("Measures"))
        unit = session.viewing.unit
        pieces = [piece for piece in session.pieces if piece.key in selected]
        extent = self.measurer.extent(atoms, [cell for piece in pieces for cell in piece.cells] or [Cell()])
        count = len(pieces)
        for name, several, power in (
            (_("Volume"), ngettext("Volume of {count} piece", "Volume of {count} pieces", count), 3),
            (_("Surface"), ngettext("Surface of {count} piece", "Surface of {count} pieces", count), 2),
        ):
            secondary(several.format(count=count) if count > 1 else name)
            if extent is None:
                right_text("...")
            else:
                right_text(unit.text(extent.volume if power == 3 else extent.surface, power))
                if power == 2:
                    tooltip(
                        _("Skin {skin}, cut faces {faces}").format(
                            skin=unit.text(extent.skin, 2), faces=unit.text(extent.faces, 2)
                        )
                    )
        self._distance(unit)

    def _distance(self, unit: Unit) -> None:
        """Draws the last distance, which the user can set to its real length, and the unit."""
        session, measured = self.session, self.slices.measured
        length = None if measured is None else measured.length
        imgui.align_text_to_frame_padding()
        secondary(_("Distance"))
        if length is not None:
            imgui.same_line(px(108))
            imgui.set_next_item_width(imgui.get_content_region_avail().x - px(88))
            changed, typed = imgui.input_float(
                "##distance", length * unit.length, 0.0, 0.0, "%.4g", imgui.InputTextFlags_.enter_returns_true
            )
            tooltip(_("Type how long it really is, then Enter: everything is told at that scale."))
            if changed and np.isfinite(typed) and length > 0 and LENGTHS[0] <= typed / length <= LENGTHS[1]:
                known = "mm" if unit.name == "units" else unit.name
                session.viewing = replace(session.viewing, unit=Unit(known, typed / length))
        else:
            imgui.same_line(px(108))
            secondary(_("press D"))
            tooltip(_("Two clicks on a face measure it; then it can be set to what it really is."))
        imgui.same_line(imgui.get_content_region_avail().x - px(80))
        imgui.set_next_item_width(px(80))
        if imgui.begin_combo("##unit", unit.name):
            for name in UNITS:
                if imgui.selectable(name, name == unit.name)[0]:
                    session.viewing = replace(session.viewing, unit=unit.named(name))
            imgui.end_combo()
        tooltip(_("The unit that lengths are told in; kept with the project"))
