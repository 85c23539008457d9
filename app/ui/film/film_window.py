"""The window for saving the film: its format, size, frames a second and background."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from imgui_bundle import ImVec2, imgui

from app.jobs.export import FASTEST_GIF, ffmpeg
from app.model.film.motion import frame_count
from app.model.film.timeline import BACKGROUNDS, Background
from app.model.rigid_transform import Vec3
from app.session.session import Session
from app.translation import _
from app.ui.dialogs.export_window import bounded
from app.ui.dialogs.file_dialogs import FileDialogs
from app.ui.theme import Fonts, palette, px, rgb
from app.ui.widgets import cancel_button, font, main_button, modal, row_label, secondary

__all__ = ["FilmWindow"]

T = TypeVar("T")

FORMS = {".mp4": _("MP4"), ".webp": _("WebP"), ".gif": _("GIF"), "": _("Frames (PNG)")}

SIZES = ((1280, 720), (1920, 1080), (2560, 1440), (3840, 2160), (1080, 1080), (1080, 1920))
"""Width and height in pixels, as screens and feeds use them."""

RATES = (12.0, 24.0, 25.0, 30.0, 50.0, 60.0)

GROUNDS: dict[Background, str] = {
    "window": _("as in the window"),
    "white": _("white"),
    "black": _("black"),
    "own": _("a colour"),
    "transparent": _("transparent"),
}


class FilmWindow:
    """A modal window whose choices are kept with the project."""

    def __init__(self, session: Session, dialogs: FileDialogs) -> None:
        self.session, self.dialogs = session, dialogs
        self.requested = False
        self.form = ".mp4" if ffmpeg() else ".webp"

    def open(self) -> None:
        """Opens the window in the next frame."""
        self.requested = True

    def show(self) -> None:
        """Draws one frame."""
        if self.requested:
            imgui.open_popup("Film")
        with modal("Film", 380) as opened:
            if opened:
                self._body()

    def _body(self) -> None:
        with font(Fonts.bold):
            imgui.text_unformatted(_("Save film"))
        secondary(_("In full detail, in the background: the window can be used on."), wrap=True)
        imgui.dummy(ImVec2(0, px(4)))
        forms = {suffix: name for suffix, name in FORMS.items() if suffix != ".mp4" or ffmpeg()}
        row_label(_("Format"), 132)
        self.form = _choice("##form", self.form if self.form in forms else ".webp", forms)
        look = self.session.viewing.film
        named = {size: f"{size[0]} x {size[1]}" for size in SIZES}
        row_label(_("Size"), 132)
        size = _choice("##size", look.size, named | ({} if look.size in named else {look.size: _("other")}))
        row_label("", 132)
        changed, sides = imgui.input_int2("##sides", list(size))
        size = (bounded(sides[0]), bounded(sides[1])) if changed else size
        rates = {
            rate: f"{rate:g}" for rate in sorted({*RATES, look.rate}) if self.form != ".gif" or rate <= FASTEST_GIF
        }
        row_label(_("Frames a second"), 132)
        rate = _choice("##rate", look.rate if look.rate in rates else 25.0, rates)
        grounds = {g: GROUNDS[g] for g in BACKGROUNDS if g != "transparent" or self.form in (".webp", "")}
        row_label(_("Background"), 132)
        background = _choice("##ground", look.background if look.background in grounds else "white", grounds)
        colour = look.colour
        if background == "own":
            row_label("", 132)
            r, g, b = imgui.color_edit3("##colour", list(colour), imgui.ColorEditFlags_.no_alpha)[1]
            colour = (r, g, b)
        self.session.viewing = replace(
            self.session.viewing, film=replace(look, size=size, rate=rate, background=background, colour=colour)
        )
        seconds = self.session.timeline.seconds
        imgui.dummy(ImVec2(0, px(2)))
        secondary(_("{seconds:.1f} seconds, {count} frames").format(seconds=seconds, count=frame_count(seconds, rate)))
        imgui.dummy(ImVec2(0, px(4)))
        if main_button(_("Choose where..."), px(150)):
            self._choose()
        imgui.same_line()
        if cancel_button():
            self.requested = False
        if not self.requested:
            imgui.close_current_popup()

    def _choose(self) -> None:
        self.requested = False
        session, suffix = self.session, self.form
        scene = session.document.scene
        name = (scene.parent if scene else Path.home()) / f"{scene.stem if scene else 'object'}_film{suffix}"
        kinds = [suffix[1:].upper(), f"*{suffix}"] if suffix else [_("Folder of pictures"), "*"]

        def then(path: Path, asked: bool) -> None:
            act = partial(session.film.save, path, self.ground())
            session.files.write([path] if suffix else [], asked, act)  # frames in a folder are looked after there

        self.dialogs.save(_("Save film"), name, kinds, [suffix] if suffix else [], then)

    def ground(self) -> Vec3 | None:
        """RGB of the background, range [0, 1]; None for a transparent one."""
        look, view = self.session.viewing.film, self.session.viewing
        plain: dict[Background, Vec3 | None] = {
            "window": view.background or rgb(palette().view),
            "white": (1.0, 1.0, 1.0),
            "black": (0.0, 0.0, 0.0),
            "own": look.colour,
            "transparent": None,
        }
        return plain[look.background]


def _choice(name: str, current: T, choices: dict[T, str]) -> T:
    """Draws a list of choices by their labels; returns the chosen one."""
    keys = list(choices)
    index = imgui.combo(name, keys.index(current), [choices[key] for key in keys])[1]
    return keys[index]
