"""The list of pieces, which can be shown, hidden, named, marked and grouped, and how far they stand apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby

from imgui_bundle import ImVec2, imgui
from imgui_bundle import icons_fontawesome_6 as icon

from app.model.document import MARKS, Key, Mark, Placement
from app.model.pieces import PlacedPiece
from app.session.session import Session
from app.translation import _
from app.ui.theme import palette, px
from app.ui.widgets import (
    MARK_ICONS,
    MARK_NAMES,
    eye_icon,
    float_slider,
    icon_button,
    list_row,
    main_button,
    mark_colour,
    row_label,
    secondary,
    text_field,
    tooltip,
)

__all__ = ["PiecesPanel"]


class PiecesPanel:
    """Draws the list and passes edits on to the session."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._renamed: Key | None = None
        """The piece whose name is being typed."""
        self._typing = False
        """Whether the field for the name has been drawn, and has the keyboard focus."""
        self._group = ""
        """Name of a group as typed so far."""

    def show(self) -> None:
        """Draws one frame."""
        session, document = self.session, self.session.document
        imgui.dummy(ImVec2(0, px(2)))
        for label, name, value, hint in (
            (_("Gap"), "gap", document.gap, _("How far the sides of a cut stand apart")),
            (_("Explode"), "explode", document.explode, _("How far the pieces stand from the middle")),
        ):
            row_label(label, 76)
            changed, new = float_slider(f"##{name}", value, 0.0, 1.0 if name == "gap" else 2.0, hint)
            if changed:
                changed_one = replace(document, gap=new) if name == "gap" else replace(document, explode=new)
                session.change(label, changed_one, merge=name)
        # Sorting is stable: pieces keep their order within a group, and without one.
        grouped = sorted(session.pieces, key=lambda piece: (not piece.group, piece.group))
        for group, pieces in groupby(grouped, key=lambda piece: piece.group):
            members = list(pieces)
            if group:
                self._header(group, members)
            for piece in members:
                imgui.push_id(str(piece.key))
                self._piece(piece)
                imgui.pop_id()
        if imgui.button(_("Put back together"), ImVec2(-1, 0)):
            session.reassemble()
        tooltip(_("Every piece back in its place; cuts, names and groups stay"), "Ctrl+G")

    def rename(self) -> None:
        """Lets the user type the name of the selected piece."""
        if len(self.session.selected) == 1:
            (self._renamed,), self._typing = self.session.selected, False
        else:
            self.session.notify(_("Select one piece to name it."))

    def _header(self, group: str, members: Sequence[PlacedPiece]) -> None:
        """Draws the name of a group; a click on it selects the whole group."""
        session, keys = self.session, frozenset(piece.key for piece in members)
        imgui.push_id(f"group {group}")
        shown = any(piece.visible for piece in members)
        if icon_button(f"{eye_icon(shown)}###seen", 22, quiet=True):
            session.change_placements(_("Hide") if shown else _("Show"), keys, lambda p: replace(p, visible=not shown))
        tooltip(_("Hide the group") if shown else _("Show the group"))
        imgui.same_line()
        if list_row(
            f"{icon.ICON_FA_LAYER_GROUP}  {group}", keys <= session.selected, imgui.get_content_region_avail().x, 22
        ):
            session.selected = keys
        tooltip(_("Click to select all of the group"))
        imgui.pop_id()

    def _piece(self, piece: PlacedPiece) -> None:
        session = self.session
        if icon_button(f"{eye_icon(piece.visible)}###seen", 22, quiet=True):
            session.change_placements(
                _("Hide") if piece.visible else _("Show"),
                frozenset([piece.key]),
                lambda p: replace(p, visible=not piece.visible),
            )
        tooltip(_("Hide it") if piece.visible else _("Show it"))
        imgui.same_line()
        if self._renamed == piece.key:
            self._field(piece)
            return
        mark = MARK_ICONS[piece.mark] if piece.mark else icon.ICON_FA_TAG
        colour = mark_colour(piece.mark) if piece.mark else palette().second
        if icon_button(f"{mark}###mark", 22, quiet=True, colour=colour):
            if piece.key not in session.selected:
                session.selected = frozenset([piece.key])
            self._group = piece.group
            imgui.open_popup("mark")
        tooltip(_("Mark it, or put it into a group; all that is selected"))
        self._popup()
        imgui.same_line()
        chosen = piece.key in session.selected
        if list_row(f"{piece.name}###piece", chosen, imgui.get_content_region_avail().x - px(30), 22):
            only = frozenset([piece.key])
            session.selected = session.selected ^ only if imgui.get_io().key_ctrl else only
        if imgui.is_item_hovered() and imgui.is_mouse_double_clicked(imgui.MouseButton_.left):
            self._renamed, self._typing = piece.key, False
        tooltip(_("Double click to name it"), "F2")
        imgui.same_line()
        if icon_button(f"{icon.ICON_FA_XMARK}##gone", 22, quiet=True):
            session.selected = frozenset([piece.key])
            session.delete()
        tooltip(_("Delete the piece"), "Del")

    def _field(self, piece: PlacedPiece) -> None:
        """Draws the field in which a name is typed; left empty, the piece is numbered again."""
        session = self.session
        imgui.set_next_item_width(-1)
        if not self._typing:
            imgui.set_keyboard_focus_here()
        given = session.document.placement(piece.key).name
        changed, text = text_field("##name", given, piece.name)
        if changed:
            named = session.document.placed(piece.key, lambda p: replace(p, name=text.strip()))
            session.change(_("Name"), named, merge=f"name {piece.key}")
        ended = self._typing and not imgui.is_item_active()
        self._typing, self._renamed = not ended, None if ended else self._renamed

    def _popup(self) -> None:
        """Draws the choice of a mark, and the field for the name of a group."""
        session = self.session
        if not imgui.begin_popup("mark"):
            return
        choices: tuple[Mark, ...] = ("", *MARKS)
        for mark in choices:
            symbol = MARK_ICONS[mark] if mark else icon.ICON_FA_BAN
            colour = mark_colour(mark) if mark else palette().second
            if icon_button(f"{symbol}###{mark or 'none'}", 28, quiet=True, colour=colour):
                session.change_placements(_("Mark"), session.selected, partial(_marked, mark))
            tooltip(MARK_NAMES[mark] if mark else _("No mark"))
            imgui.same_line()
        imgui.new_line()
        imgui.align_text_to_frame_padding()
        secondary(_("Group"))
        imgui.same_line()
        imgui.set_next_item_width(px(150))
        flags = imgui.InputTextFlags_.enter_returns_true
        entered, self._group = text_field("##group", self._group, _("name of the group"), flags)
        imgui.same_line()
        if main_button(_("Set"), px(52)) or entered:
            group = self._group.strip()
            session.change_placements(_("Group"), session.selected, lambda p: replace(p, group=group))
            imgui.close_current_popup()
        imgui.end_popup()


def _marked(mark: Mark, placement: Placement) -> Placement:
    """The placement with this mark."""
    return replace(placement, mark=mark)
