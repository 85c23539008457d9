"""File dialogs: the system's own if there is one, otherwise a prompt for a path in the window."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from imgui_bundle import imgui
from imgui_bundle import portable_file_dialogs as pfd

from app.model.project import SUFFIX
from app.translation import _
from app.ui.theme import px
from app.ui.widgets import cancel_button, main_button, modal, secondary
from engine.io.formats import SCENE_SUFFIXES
from engine.io.picture_file import PICTURE_SUFFIXES

__all__ = ["FileDialogs"]

Then = Callable[[tuple[Path, ...]], None]


def _patterns(suffixes: Iterable[str]) -> str:
    """Patterns of the files that a dialog shows, also in capitals, as cameras write them and Linux tells apart."""
    return " ".join(f"*{written}" for suffix in suffixes for written in (suffix, suffix.upper()))


SCENES = [_("Scenes"), _patterns((*SCENE_SUFFIXES, SUFFIX)), _("All files"), "*"]
IMAGES = [_("Pictures"), _patterns(PICTURE_SUFFIXES), _("All files"), "*"]


@dataclass
class NativeDialog:
    """An open dialog of the system."""

    dialog: pfd.open_file | pfd.save_file | pfd.select_folder
    then: Then


@dataclass
class PathPrompt:
    """A prompt in the window, with the path typed so far."""

    title: str
    text: str
    then: Then


class FileDialogs:
    """Opens one dialog at a time and calls back with the chosen paths."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        """The folder that dialogs for opening start in, and that typed paths are relative to."""
        self.dialog: NativeDialog | None = None
        self.prompt: PathPrompt | None = None
        native = sys.platform in ("win32", "darwin") or any(map(shutil.which, ("zenity", "kdialog", "matedialog")))
        self.native = native

    def open_scene(self, then: Callable[[Path], None]) -> None:
        """Asks for a scene or a project."""
        self._open(_("Open a capture, a mesh or a project"), SCENES, lambda paths: then(paths[0]))

    def open_pictures(self, then: Then) -> None:
        """Asks for one or several pictures."""
        self._open(_("Choose pictures of a cut face"), IMAGES, then, several=True)

    def save(
        self,
        title: str,
        suggestion: Path,
        kinds: list[str],
        suffixes: Sequence[str],
        then: Callable[[Path, bool], None],
    ) -> None:
        """Asks for the path of a new file, which gets the first of `suffixes` unless it ends in one of them. `then` is
        also told whether the system's dialog has asked about replacing what is there."""

        def finish(paths: tuple[Path, ...]) -> None:
            (path,) = paths
            whole = not suffixes or path.suffix.lower() in suffixes
            then(path if whole else path.with_name(path.name + suffixes[0]), self.native and whole)

        if self.native:
            self.dialog = NativeDialog(pfd.save_file(title, str(suggestion), kinds), finish)
        else:
            self.prompt = PathPrompt(title, str(suggestion), finish)

    def choose_folder(self, title: str, start: Path, then: Callable[[Path], None]) -> None:
        """Asks for a folder."""
        if self.native:
            self.dialog = NativeDialog(pfd.select_folder(title, str(start)), lambda paths: then(paths[0]))
        else:
            self.prompt = PathPrompt(title, str(start), lambda paths: then(paths[0]))

    def _open(self, title: str, kinds: list[str], then: Then, several: bool = False) -> None:
        if self.native:
            options = pfd.opt.multiselect if several else pfd.opt.none
            self.dialog = NativeDialog(pfd.open_file(title, str(self.folder), kinds, options), then)
        else:
            self.prompt = PathPrompt(title, os.path.join(self.folder, ""), then)

    def show(self) -> None:
        """Checks for an answer, and draws the prompt. Called once a frame."""
        current = self.dialog
        if current is not None and current.dialog.ready(0):
            self.dialog = None
            result = current.dialog.result()
            paths = [result] if isinstance(result, str) else result
            if paths and paths[0]:
                current.then(tuple(Path(path) for path in paths))
        if self.prompt is not None:
            self._show_prompt(self.prompt)

    def _show_prompt(self, typed: PathPrompt) -> None:
        imgui.open_popup("Path")
        done = False
        with modal("Path", 520) as opened:
            if not opened:
                return
            imgui.text_unformatted(typed.title)
            imgui.set_next_item_width(-1)
            if imgui.is_window_appearing():
                imgui.set_keyboard_focus_here()
            entered, typed.text = imgui.input_text("##path", typed.text, imgui.InputTextFlags_.enter_returns_true)
            secondary(_("Type a path. Installing zenity or kdialog brings the system's file dialog."), wrap=True)
            if main_button(_("OK"), px(110)) or entered:
                self.prompt, done = None, True
            imgui.same_line()
            if cancel_button():
                self.prompt = None
            if self.prompt is None:
                imgui.close_current_popup()
        if done and typed.text.strip():
            typed.then((self.folder / Path(typed.text.strip()).expanduser(),))
