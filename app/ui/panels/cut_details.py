"""The details that open below a cut in the inspector: where its plane lies, and what can be done with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from imgui_bundle import ImVec2, imgui
from numpy.typing import NDArray

from app.model.document import Cut
from app.model.knife import PlaneAngles
from app.session.session import Session
from app.translation import _
from app.ui.theme import px
from app.ui.view.viewport import Viewport
from app.ui.widgets import row_label, tooltip
from engine.errors import InputError
from engine.scene.camera import equator
from engine.scene.plane import Plane
from training.families import Family

__all__ = ["CutDetails"]

FARTHEST = 100.0
"""Radii. Largest distance of a plane from the middle of the object, which it misses by far."""


class CutDetails:
    """Draws the details of one cut and passes edits on to the session."""

    def __init__(self, session: Session, viewport: Viewport) -> None:
        self.session, self.viewport = session, viewport
        self._numbers: tuple[int, list[float]] | None = None
        """Id of a cut, and a, b, c, d as typed so far."""

    def show(self, cut: Cut) -> None:
        """Draws one frame."""
        session = self.session
        imgui.indent(px(32))
        plane = cut.plane(cut.parts[0])
        if len(cut.parts) == 1:
            self._place(cut, plane)
        if imgui.button(_("Flip")):
            session.change_cut(_("Flip"), cut.id, flipped)
        tooltip(_("Keep the other side") if cut.kind == "section" else _("Swap the sides of the cut"))
        if cut.curved:
            imgui.unindent(px(32))
            return
        imgui.same_line()
        if cut.kind == "section":
            if imgui.button(_("Slice here")):
                session.change_cut(_("Slice"), cut.id, lambda c: replace(c, kind="slice"))
            tooltip(_("Part the object along this plane"))
            imgui.same_line()
        if imgui.button(_("Train here")):
            self._train(plane)
        tooltip(_("Add this plane to the ones that are trained"))
        if len(cut.parts) == 1 and imgui.tree_node_ex(_("Advanced"), imgui.TreeNodeFlags_.span_avail_width):
            self._equation(cut, plane)
            imgui.tree_pop()
        imgui.unindent(px(32))

    def _place(self, cut: Cut, plane: Plane) -> None:
        """Draws the fields for the plane's distance and two angles, a list of axes, and the button for three points."""
        up, centre = np.asarray(self.session.up), self.session.solid.centre
        now = PlaneAngles.of(plane, up, centre)
        speed = self.session.solid.radius / 200  # a drag across the panel moves it by about a radius
        farthest = FARTHEST * self.session.solid.radius
        middle = _("From the middle of the object, in units of the file")
        level = _("Against the level: 0 is a level cut, 90 an upright one")
        for name, title, value, step, low, high, form, hint in (
            ("distance", _("Distance"), now.distance, speed, -farthest, farthest, "%.3f", middle),
            ("tilt", _("Tilt"), now.tilt, 0.5, 0.0, 180.0, "%.1f°", level),
            ("turn", _("Turn"), now.turn, 0.5, -180.0, 180.0, "%.1f°", _("About the upright axis")),
        ):
            row_label(title, 108)
            value = value if abs(value) >= 5e-4 else 0.0  # so that "-0.000" is never shown
            changed, new = imgui.drag_float(f"##{name}", value, step, low, high, form, imgui.SliderFlags_.always_clamp)
            tooltip(_("{hint}. Drag, or double click to type.").format(hint=hint))
            if changed and np.isfinite(new):
                self._set(cut, replace(now, **{name: new}).plane(up, centre), merge=f"cut {cut.id}")
        width = (imgui.get_content_region_avail().x - px(8)) / 2
        imgui.set_next_item_width(width)
        if imgui.begin_combo("##across", _("Along...")):
            for name, normal in presets(up).items():
                if imgui.selectable(name, False)[0]:
                    self._set(cut, Plane.through(centre + now.distance * normal, normal))
            imgui.end_combo()
        tooltip(_("Level, upright, or across an axis of the file, at the same distance"))
        imgui.same_line()
        picker = self.viewport.point_picker
        picking = picker.cut_id == cut.id
        if imgui.button(_("Cancel") + "##points" if picking else _("Three points"), ImVec2(-1, 0)):
            picker.cancel() if picking else picker.begin(cut.id)
        tooltip(_("Click three points on the object: the plane goes through them"))

    def _equation(self, cut: Cut, plane: Plane) -> None:
        values = [*plane.normal, plane.offset]
        editing = self._numbers[1] if self._numbers is not None and self._numbers[0] == cut.id else values
        imgui.set_next_item_width(-1)
        changed, editing = imgui.input_float4("##numbers", editing, "%.3f")
        if changed:
            self._numbers = (cut.id, list(editing))
        if imgui.is_item_deactivated_after_edit() and self._numbers is not None:
            try:
                plane = Plane.of(self._numbers[1][:3], self._numbers[1][3])
                if abs(plane.distance(self.session.solid.centre[None])[0]) <= FARTHEST * self.session.solid.radius:
                    self._set(cut, plane)
                else:
                    self.session.notify(_("This plane is too far from the object."))
            except InputError:
                self.session.notify(_("a, b, c must not all be zero."))
        if not imgui.is_item_active():
            self._numbers = None
        tooltip(_("a, b, c, d of the plane a x + b y + c z + d = 0; the side below 0 stays"))

    def _set(self, cut: Cut, plane: Plane, merge: str = "") -> None:
        self.session.change_cut(_("Set {name}").format(name=cut.name), cut.id, lambda c: c.with_plane(plane), merge)

    def _train(self, plane: Plane) -> None:
        session = self.session
        family = session.document.family("custom")
        planes = (*(family.custom if family else ()), plane)
        single = family or Family("custom", 1, custom=planes)
        new = replace(single, count=len(planes), custom=planes)
        session.change(_("Train plane"), session.document.with_family(new))
        session.notify(_("Added to the family of single planes. Give it a picture."))


def flipped(cut: Cut) -> Cut:
    """The cut with its two sides swapped."""
    parts = tuple(replace(part, plane=cut.plane(part).flipped()) for part in cut.parts)
    return replace(cut, parts=parts, shift=0.0)


def presets(up: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Names of planes and their unit normals (3,)."""
    first, second = equator(up)
    axes = {_("Across {name}").format(name=name): axis for name, axis in zip("xyz", np.eye(3), strict=True)}
    return {_("Level"): up, _("Upright"): first, _("Upright, across"): second, **axes}
