"""The inspector's section for isolating the object: what is selected in the capture, and what to do with it."""

from __future__ import annotations

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.model.marking import MARKERS, Marker
from app.session.isolation_controller import How, Proposal
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px, rgb
from app.ui.widgets import disabled, heading, icon_button, list_row, main_button, secondary, segmented, share, tooltip

__all__ = ["IsolatePanel"]

MARKER_LABELS: dict[Marker, str] = {"box": _("Box"), "sphere": _("Ball"), "lasso": _("Lasso")}
MARKER_HINTS: dict[Marker, str] = {
    "box": _("Drag from corner to corner of a box, seen as from here; it reaches through the whole depth"),
    "sphere": _("Drag from the middle of a part to its rim"),
    "lasso": _("Draw around a part; it reaches through the whole depth"),
}
HOW_LABELS: dict[How, str] = {"replace": _("New"), "add": _("Add"), "subtract": _("Take away")}
HOW_HINTS: dict[How, str] = {
    "replace": _("Each drag begins a new selection"),
    "add": _("Each drag adds to the selection, as with Shift"),
    "subtract": _("Each drag takes away from the selection, as with Alt"),
}


class IsolatePanel:
    """Draws the section and passes edits on to the session."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def show(self) -> None:
        """Draws one frame."""
        session, isolation = self.session, self.session.isolation
        isolation.tint = rgb(palette().accent)
        heading(_("Isolate"))
        if not isolation.available:
            text = _("This object was opened with its inside; open the capture that it was made from.")
            if session.object is None:
                text = _("Open a capture first.")
            elif session.object.coarse is not None:
                text = _("One moment: the rest of the capture is being read.")
            secondary(text, wrap=True)
            return
        width = imgui.get_content_region_avail().x
        index = segmented(
            "marker", list(MARKER_LABELS.values()), MARKERS.index(isolation.marker), width, list(MARKER_HINTS.values())
        )
        isolation.marker = MARKERS[index]
        hows = list(HOW_LABELS)
        index = segmented("how", list(HOW_LABELS.values()), hows.index(isolation.how), width, list(HOW_HINTS.values()))
        isolation.how = hows[index]
        if session.mode != "capture":
            secondary(_("The selection is made in the capture."), wrap=True)
            if imgui.button(_("Show the capture"), ImVec2(-1, 0)):
                session.select_tool("isolate")
        self._selection(width)
        self._proposals()
        self._left_out()

    def _selection(self, width: float) -> None:
        session, isolation = self.session, self.session.isolation
        view = isolation.view
        if view is None:
            secondary(_("Finding what is selected..."))
        elif not session.document.selection:
            secondary(_("Nothing is selected. Drag over the capture."), wrap=True)
        else:
            secondary(_("{some:,} of {count:,} selected").format(some=int(view.selected.sum()), count=len(view.left)))
        each = (width - 2 * imgui.get_style().item_spacing.x) / 3
        with disabled(not session.document.selection):
            if imgui.button(_("Invert"), ImVec2(each, 0)):
                isolation.invert()
            tooltip(_("Select everything else"))
            imgui.same_line()
            if imgui.button(_("Grow"), ImVec2(each, 0)):
                isolation.grow()
            tooltip(_("Add everything that the selection touches"))
            imgui.same_line()
            if imgui.button(_("Clear"), ImVec2(each, 0)):
                isolation.clear()
            tooltip(_("Select nothing"))
            half = share(width, _("Keep only this"), _("Remove"))
            if main_button(_("Keep only this"), half):
                isolation.keep_selected()
            tooltip(_("Remove everything that is not selected"))
            if half > 0:
                imgui.same_line()
            if imgui.button(_("Remove"), ImVec2(half, px(32))):
                isolation.remove_selected()
            tooltip(_("Remove what is selected"), "Del")
            if imgui.button(_("Make it an object of its own"), ImVec2(-1, 0)):
                isolation.split_selected()
            tooltip(_("Two objects: what is selected, and the rest"))

    def _proposals(self) -> None:
        proposals = self.session.isolation.proposals
        imgui.dummy(ImVec2(0, px(2)))
        if proposals is None:
            secondary(_("Looking for a floor, specks and haze..."), wrap=True)
        elif not proposals:
            secondary(_("No floor, specks or haze found."), wrap=True)
        else:
            secondary(_("Probably not part of the object"))
            for proposal in proposals:
                self._proposal(proposal)

    def _proposal(self, proposal: Proposal) -> None:
        session = self.session
        imgui.push_id(proposal.name)
        shown = session.document.selection == proposal.selection
        if list_row(proposal.name, shown, imgui.get_content_region_avail().x - px(118), 24):
            session.isolation.clear() if shown else session.isolation.propose(proposal)
        tooltip(_("{hint}. Click to see it in the capture.").format(hint=proposal.hint))
        imgui.same_line()
        imgui.align_text_to_frame_padding()
        secondary(f"{proposal.count:,}")
        imgui.same_line(imgui.get_content_region_avail().x + imgui.get_cursor_pos_x() - px(24))
        if icon_button(f"{icon.ICON_FA_XMARK}##remove", 24, quiet=True):
            session.isolation.remove_proposal(proposal)
        tooltip(_("Remove: {what}").format(what=proposal.hint.lower()))
        imgui.pop_id()

    def _left_out(self) -> None:
        session, view = self.session, self.session.isolation.view
        if not session.document.isolation:
            return
        if imgui.button(_("Bring everything back"), ImVec2(-1, 0)):
            session.isolation.restore()
        if view is not None:
            tooltip(_("{count:,} are left out now").format(count=len(view.capture) - len(view.left)))
