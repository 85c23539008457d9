"""The panel at the right: object, cuts and pieces, and interior, in the order in which a user works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.model.document import Cut, Document
from app.model.rigid_transform import Vec3
from app.session.session import Session
from app.translation import _
from app.ui.panels.cut_details import CutDetails
from app.ui.panels.footer import Footer
from app.ui.panels.interior import InteriorPanel
from app.ui.panels.isolate import IsolatePanel
from app.ui.panels.measures import MeasuresPanel
from app.ui.panels.pieces import PiecesPanel
from app.ui.theme import palette, px, rgba
from app.ui.widgets import (
    clipped,
    colours,
    eye_icon,
    float_slider,
    heading,
    icon_button,
    list_row,
    secondary,
    text_field,
    tooltip,
)

__all__ = ["Inspector"]

AXES: dict[str, Vec3] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}


def axis_name(axis: Vec3) -> str:
    """Name of an axis, such as '+z', or 'tilted' if it is none of the six."""
    for name, known in AXES.items():
        if np.dot(known, axis) > 0.9999:
            return name
    return _("tilted")


class Inspector:
    """Draws the panel and passes edits on to the session."""

    def __init__(self, session: Session, interior: InteriorPanel, measures: MeasuresPanel) -> None:
        self.session, self.interior, self.measures = session, interior, measures
        self.isolate = IsolatePanel(session)
        self.footer = Footer(session)
        self.pieces = PiecesPanel(session)
        self.details = CutDetails(session, interior.viewport)
        self._up: list[float] | None = None
        """The up axis as typed so far, while its list is open."""
        self._renamed: int | None = None
        """Number of the object whose name is being typed."""
        self._typing = False
        """Whether the field for the name has been drawn, and has the keyboard focus."""

    def show(self) -> None:
        """Draws one frame."""
        above = imgui.get_content_region_avail().y - self.footer.height
        imgui.begin_child("##sections", ImVec2(0, max(above, px(80))), imgui.ChildFlags_.nav_flattened)
        self._object()
        if self.session.document.scene is not None:
            if self.session.tool == "isolate":
                self.isolate.show()
            self._cuts()
            self.measures.show()
            self.interior.show()
        imgui.end_child()
        self.footer.show()

    # Object

    def _object(self) -> None:
        session = self.session
        document = session.document
        heading(_("Object"))
        if document.scene is None:
            secondary(_("Nothing is open. Drop a capture on the window."), wrap=True)
            return
        imgui.align_text_to_frame_padding()
        secondary(clipped(document.scene.name, imgui.get_content_region_avail().x - px(98)))
        notes = session.object.notes if session.object is not None else ()
        tooltip("\n".join([str(document.scene), *notes]))
        imgui.same_line(imgui.get_content_region_avail().x - px(90))
        imgui.set_next_item_width(px(90))
        self._up_axis()
        if len(session.documents) > 1:
            self._objects()

    def _objects(self) -> None:
        """Draws the list of objects, which can be shown, hidden, selected and named."""
        for index, document in enumerate(self.session.documents):
            imgui.push_id(document.number)
            self._listed_object(index, document)
            imgui.pop_id()

    def _listed_object(self, index: int, document: Document) -> None:
        session = self.session
        if icon_button(f"{eye_icon(document.visible)}##seen", 22, quiet=True):
            name = _("Hide object") if document.visible else _("Show object")
            session.change_object(name, index, replace(document, visible=not document.visible))
        tooltip(_("Hide it") if document.visible else _("Show it"))
        imgui.same_line()
        if self._renamed == document.number:
            imgui.set_next_item_width(-1)
            if not self._typing:
                imgui.set_keyboard_focus_here()
            changed, text = text_field("##name", document.name or document.title)
            if changed:
                session.change_object(_("Name"), index, replace(document, name=text.strip()), merge=f"name {index}")
            ended = self._typing and not imgui.is_item_active()
            self._typing, self._renamed = not ended, None if ended else self._renamed
            return
        active = index == session.active
        mark = f"{icon.ICON_FA_CHECK}  " if active and session.object_selected else ""
        width = imgui.get_content_region_avail().x - px(104)
        with colours(text=rgba(palette().text if document.visible else palette().second), header=rgba(palette().field)):
            clicked = list_row(f"{mark}{document.title}###object", active, width, 22)
        if clicked:
            session.activate(index, not (active and session.object_selected))
        if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self._renamed, self._typing = document.number, False
            session.activate(index)  # whatever the first click did
        tooltip(_("The selected object is the one that is cut; click again to cut all. Double click to name it."))
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        secondary(self._state(document))

    def _state(self, document: Document) -> str:
        """The state of an object in a word or two; empty for a solid without an inside."""
        if any(job.document.number == document.number and not job.ended for job in self.session.training.jobs):
            return _("in training")
        loaded = self.session.loaded.get(document.number)
        if loaded is None or loaded.atoms is None:
            return _("not solid yet")
        return _("with an inside") if loaded.trained else ""

    def _up_axis(self) -> None:
        """Draws the choice of the up axis: one of six axes, as detected, by a face, or as numbers, which are taken when
        the list closes."""
        session, document = self.session, self.session.document
        current = axis_name(session.up)
        flags = imgui.ComboFlags_.no_arrow_button | imgui.ComboFlags_.height_largest
        if imgui.begin_combo("##up", _("up  {current}").format(current=current), flags):
            chosen: Callable[[], object] | None = None
            for name, axis in AXES.items():
                if imgui.selectable(_("up  {name}").format(name=name), name == current)[0]:
                    chosen = partial(session.set_up, _("Up {name}").format(name=name), axis)
            if session.object is not None and imgui.selectable(_("as detected"), False)[0]:
                chosen = partial(session.change, _("Up as detected"), replace(document, up=None))
            if session.object is not None and imgui.selectable(_("stand on a face..."), False)[0]:
                chosen = partial(session.select_tool, "upright")
            imgui.set_next_item_width(px(170))
            changed, numbers = imgui.input_float3("##up numbers", self._up or list(session.up), "%.3f")
            tooltip(_("The up axis in the axes of the file; taken when this list closes"))
            if changed:
                self._up = list(numbers)
            if chosen is not None:
                self._up = None
                chosen()
            escaped = imgui.is_key_pressed(imgui.Key.escape)
            if escaped or imgui.is_key_pressed(imgui.Key.enter):
                imgui.close_current_popup()
                self._up = None if escaped else self._up
            imgui.end_combo()
        elif self._up is not None:
            if np.isfinite(self._up).all() and np.linalg.norm(self._up) > 1e-6:
                session.set_up(_("Up"), self._up)
            else:
                session.notify(_("The up axis needs a direction: three numbers that are not all 0."))
            self._up = None
        reason = session.object.up_reason if session.object is not None else ""
        if document.up is not None:
            reason = _("({:.3g}, {:.3g}, {:.3g}), chosen by you").format(*document.up)
        tooltip(_("Which way is up: {reason}.").format(reason=reason) if reason else _("Which way is up."))

    # Cuts

    def _cuts(self) -> None:
        session = self.session
        heading(_("Cuts"))
        for cut in session.document.cuts:
            self._cut(cut)
        if imgui.button(f"{icon.ICON_FA_PLUS}  " + _("Add plane"), ImVec2(-1, 0)):
            session.add_plane()
        tooltip(_("A plane that opens the object. Sweep it with its slider."), "P")
        if len(session.pieces) > 1 or any(p.removed for _, p in session.document.placements):
            self.pieces.show()

    def _cut(self, cut: Cut) -> None:
        session = self.session
        imgui.push_id(cut.id)
        if icon_button(f"{eye_icon(cut.on)}##on", 24, quiet=True):
            session.change_cut(
                _("Show cut") if not cut.on else _("Hide cut"), cut.id, lambda c: replace(c, on=not c.on)
            )
        tooltip(
            (_("Take the cut back for now") if cut.kind == "slice" else _("Show all of it for now"))
            if cut.on
            else _("Cut again")
        )
        imgui.same_line()
        active = session.active_cut == cut.id
        wide = imgui.get_content_region_avail().x > px(190)
        row = px(76) if wide else imgui.get_content_region_avail().x - px(32)
        with colours(text=rgba(palette().text if cut.on else palette().second), header=rgba(palette().field)):
            clicked = list_row(cut.name, active, row, 24)
        if clicked:
            session.active_cut = None if active else cut.id
        tooltip(_("Click to say where it lies"))
        imgui.same_line()
        if wide:
            self._slider(cut)
            imgui.same_line()
        if icon_button(f"{icon.ICON_FA_XMARK}##gone", 24, quiet=True):
            session.remove_cut(cut.id)
            imgui.pop_id()
            return
        tooltip(_("Remove: what it parted is one again") if cut.kind == "slice" else _("Remove"))
        if not wide:
            self._slider(cut)
        if active and session.active_cut == cut.id:
            self.details.show(cut)
        imgui.pop_id()

    def _slider(self, cut: Cut) -> None:
        """A slider for the plane's distance from the object's centre, in radii."""
        session, solid = self.session, self.session.solid
        if cut.curved:
            secondary(_("curved"))
            imgui.same_line()
            imgui.dummy(ImVec2(imgui.get_content_region_avail().x - px(40), px(1)))
            return
        plane = cut.plane(cut.parts[0])
        place = -float(plane.distance(solid.centre)) / solid.radius
        width = max(imgui.get_content_region_avail().x - px(32), px(60))
        changed, new = float_slider("##place", place, -1.0, 1.0, _("Sweeps the plane through the object"), width)
        if changed:
            shift = cut.shift + (new - place) * solid.radius
            session.change_cut(
                _("Move {name}").format(name=cut.name), cut.id, lambda c: replace(c, shift=shift), merge=f"cut {cut.id}"
            )
