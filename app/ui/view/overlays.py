"""Texts and controls over the viewport: switch of the mode, names, what a film shows, the tool's hint, statistics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from imgui_bundle import ImVec2, imgui

from app.model.camera_control import project_points
from app.model.pieces import Member, PlacedPiece
from app.model.project import VIEW_MODES
from app.session.session import Session
from app.translation import _, ngettext
from app.ui.theme import palette, px, u32
from app.ui.view.annotations import label
from app.ui.view.plane_lines import PlaneLines
from app.ui.widgets import MARK_ICONS, mark_colour, segmented
from engine.scene.camera import Camera
from training.families import Kind

__all__ = ["FAMILY_TITLES", "family_names", "film_label", "mode_switch", "piece_names", "statistics", "tool_hint"]

HINTS = {
    "select": "",
    "knife": _("Drag across the object to cut it"),
    "blade": _("Draw a line to cut along, or all around what is to be punched out"),
    "plane": _("Drag to place a plane"),
    "move": _("Drag a piece to move it"),
    "turn": _("Drag a piece to turn it"),
    "upright": _("Click the face it stands on"),
    "isolate": _("Drag over a part of the capture to select it"),
}

FAMILY_TITLES: dict[Kind, str] = {
    "horizontal": _("Horizontal"),
    "radial": _("Radial"),
    "parallel": _("Parallel"),
    "custom": _("Single planes"),
}

MODE_LABELS = (_("Capture"), _("Solid"), _("Interior"))
MODE_HINTS = (
    _("The capture as it came, hollow"),
    _("The object as a solid that can be cut"),
    _("The inside alone, without its skin"),
)


def mode_switch(session: Session, origin: ImVec2, size: tuple[int, int]) -> str | None:
    """Draws the switch between capture, solid and interior; returns the mode if one was chosen in this frame."""
    inset = px(14)
    imgui.set_cursor_screen_pos(ImVec2(origin.x + inset, origin.y + inset))
    width = max(min(px(252), size[0] - 2 * inset - px(38)), px(24))
    current = VIEW_MODES.index(session.mode)
    chosen = segmented("view", MODE_LABELS, current, width, MODE_HINTS)
    if chosen == current:
        return None
    if session.atoms is None:
        session.notify(_("The object is not solid yet."))
        return None
    session.viewing = replace(session.viewing, mode=VIEW_MODES[chosen])
    return VIEW_MODES[chosen]


def piece_names(session: Session, camera: Camera, pieces: Sequence[PlacedPiece], origin: ImVec2) -> None:
    """Draws the marks and names that the user has given to pieces of the active object, on the pieces."""
    p, draw, document = palette(), imgui.get_window_draw_list(), session.document
    for piece in pieces:
        name = document.placement(piece.key).name
        if not piece.visible or not (name or piece.mark) or not len(piece.rows):
            continue
        middle = piece.motion.apply(session.solid.points[piece.rows].mean(0))
        pixels, depth = project_points(camera, middle[None])
        if depth[0] <= 0:
            continue
        symbol = f"{MARK_ICONS[piece.mark]}  " if piece.mark else ""
        text = (symbol + name).rstrip()
        size = imgui.calc_text_size(text)
        low = ImVec2(origin.x + float(pixels[0, 0]) - size.x / 2, origin.y + float(pixels[0, 1]) - size.y / 2)
        high = ImVec2(low.x + size.x + px(7), low.y + size.y + px(4))
        draw.add_rect_filled(ImVec2(low.x - px(7), low.y - px(4)), high, u32(p.view, 0.9), px(5))
        draw.add_text(low, u32(p.text), text)
        if piece.mark:
            draw.add_text(low, u32(mark_colour(piece.mark)), symbol.rstrip())


CORNERS: dict[Kind, tuple[float, float]] = {
    "horizontal": (1, 0),
    "radial": (0, -1),
    "parallel": (0.7, 0.7),
    "custom": (-1, 0),
}
"""Direction, x to the right and y down, in which a family's name lies on the outline of its own plane: apart from the
names of others."""


def family_names(
    session: Session,
    kinds: Collection[Kind],
    lines: PlaneLines,
    camera: Camera,
    pieces: Sequence[PlacedPiece],
    origin: ImVec2,
) -> None:
    """Draws the names of these families and of their pictures, each beside the family's own plane."""
    for family in session.document.families:
        if family.kind not in kinds:
            continue
        pixels, depth = project_points(camera, lines.of_family(family, pieces, own=True).reshape(-1, 3))
        pixels = pixels[depth > 0]
        if not len(pixels):
            continue
        x, y = CORNERS[family.kind]
        place = pixels[int((pixels @ (x, y)).argmax())]
        text = FAMILY_TITLES[family.kind]
        if family.exemplars:
            more = len(family.exemplars) - 1
            text += f": {family.exemplars[0].stem}" + (_(" and {count} more").format(count=more) if more else "")
        size = imgui.calc_text_size(text)
        left = px(14) if x > 0 else -size.x - px(14) if x < 0 else -size.x / 2
        high = -size.y - px(14) if y < 0 else -size.y / 2
        at = ImVec2(origin.x + float(place[0]) + left, origin.y + float(place[1]) + high)
        label(imgui.get_window_draw_list(), at, text)


def film_label(session: Session, origin: ImVec2, size: tuple[int, int]) -> None:
    """Says that a film or a thrown object is shown, and how to leave it."""
    if session.throw.active:
        count = session.throw.pieces
        text = (
            ngettext("{count} piece", "{count} pieces", count).format(count=count)
            + _("    Enter: keep the cuts    Esc: end")
            if count > 1
            else _("Cut it in flight    Esc: end")
        )
    elif session.film.shown:
        text = _("Film, {time:.1f} s").format(time=session.film.time)
        text += "" if session.film.playing else _("    Esc: the object as it is")
    else:
        return
    width = imgui.calc_text_size(text).x
    label(imgui.get_window_draw_list(), ImVec2(origin.x + (size[0] - width) / 2, origin.y + size[1] - px(34)), text)


def statistics(
    session: Session, members: Sequence[Member], milliseconds: float, origin: ImVec2, size: tuple[int, int]
) -> None:
    """Draws a line at the bottom: the number of Gaussians, or of points and pieces, and the time of a frame."""
    if session.object is None:
        return
    if session.mode == "capture":
        capture = session.shown_capture
        what = _("{count:,} Gaussians").format(count=len(capture)) if capture is not None else ""
    else:
        count = len(members)
        pieces = ngettext("{count} piece", "{count} pieces", count).format(count=count)
        pieces = f"    {pieces}" if count != 1 else ""
        solids = session.solids.values()
        total = sum(len(one) if session.mode == "solid" else len(one.interior) for one in solids)
        what = _("{count:,} points").format(count=total) + pieces
    line = f"{what}    {milliseconds:.0f} ms" if milliseconds else what
    at = ImVec2(origin.x + px(14), origin.y + size[1] - px(14) - imgui.get_text_line_height())
    imgui.get_window_draw_list().add_text(at, u32(palette().second), line)


def tool_hint(session: Session) -> None:
    """Says beside the pointer what to do with the tool; for the knife until the first cut, for isolating until
    something is selected."""
    text = "" if session.previewing else HINTS[session.tool]
    idle = bool(session.document.selection) if session.tool == "isolate" else session.atoms is None
    if not text or idle or (session.tool == "knife" and session.settings.seen_hint):
        return
    mouse = imgui.get_mouse_pos()
    label(imgui.get_window_draw_list(), ImVec2(mouse.x + px(24), mouse.y + px(12)), text)
