"""The window's commands, and the menu bar, toolbar, context menu and list of shortcuts made from them."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from imgui_bundle import imgui

from app.model.camera_control import AXIS_VIEWS
from app.model.project import SUFFIX
from app.model.samples import sample_document
from app.session.film_controller import PRESETS
from app.session.session import Session
from app.session.workspace import TOOLS
from app.translation import _
from app.ui.commands import Command, Ctrl, Key, Shift
from app.ui.dialogs.export_window import ExportWindow
from app.ui.dialogs.file_dialogs import FileDialogs
from app.ui.dialogs.slices_window import SlicesWindow
from app.ui.film.film_window import FilmWindow
from app.ui.panels.inspector import Inspector
from app.ui.panels.view_options import SWITCHES
from app.ui.pointer_keys import PointerKeys
from app.ui.shortcuts import show_shortcuts
from app.ui.theme import SCALES, apply
from app.ui.toolbar import TOOL_ICONS, TOOL_NAMES
from app.ui.view.slices import SliceViews
from app.ui.view.viewport import Viewport
from app.ui.widgets import tooltip

__all__ = ["Menus"]

MENUS = {
    "File": _("File"),
    "Edit": _("Edit"),
    "Tools": _("Tools"),
    "Cut": _("Cut"),
    "Interior": _("Interior"),
    "Film": _("Film"),
    "View": _("View"),
    "Help": _("Help"),
}
VIEWS = {
    "front": _("Front"),
    "back": _("Back"),
    "left": _("Left"),
    "right": _("Right"),
    "top": _("Top"),
    "bottom": _("Bottom"),
}
SAMPLES = {"watermelon": _("Watermelon"), "orange": _("Orange"), "bread": _("Bread")}


class Menus:
    """Makes the commands once and draws the menus from them."""

    def __init__(
        self,
        session: Session,
        viewport: Viewport,
        slice_views: SliceViews,
        dialogs: FileDialogs,
        export: ExportWindow,
        film_window: FilmWindow,
        inspector: Inspector,
        pointer: PointerKeys,
    ) -> None:
        self.inspector, self.pointer = inspector, pointer
        self.session, self.viewport, self.slice_views, self.film_window = session, viewport, slice_views, film_window
        self.dialogs, self.export, self.slices = dialogs, export, SlicesWindow(session)
        self.shortcuts_shown = False
        """Whether the list of shortcuts is open."""
        session.files.choose_path = lambda then: dialogs.save(
            _("Save the project"),
            self.suggested_path(),
            [_("FruitNinja project"), f"*{SUFFIX}"],
            [SUFFIX],
            lambda path, asked: session.files.write([path], asked, lambda: then(path)),
        )
        self.commands = self._commands()

    def suggested_path(self) -> Path:
        """The path that the dialog for saving a new project suggests."""
        scene = self.session.document.scene
        return scene.with_suffix(SUFFIX) if scene else Path.home() / f"untitled{SUFFIX}"

    def _commands(self) -> list[Command]:
        s, view = self.session, self.viewport
        training, export = s.training, self.export.open
        picture = partial(export, "picture")

        def opened() -> bool:
            return s.document.scene is not None

        def solid() -> bool:
            return s.atoms is not None

        def separable() -> bool:
            return s.isolation.available

        def selected() -> bool:
            return bool(s.selected)

        def in_capture() -> bool:
            return s.tool == "isolate" and bool(s.document.selection)

        def can_start() -> bool:
            return s.object is not None and not s.object.trained and not training.busy

        def can_resume() -> bool:
            return training.job is not None and not training.busy

        def is_cut() -> bool:
            return bool(s.document.cuts)

        axis_keys = (("1", Key._1), ("3", Key._3), ("2", Key._2), ("4", Key._4), ("6", Key._6), ("5", Key._5))
        look = [Command("View", _("Fit"), view.fit, "F", Key.f, opened)]
        for name, (keys, chord) in sorted(zip(AXIS_VIEWS, axis_keys, strict=True), key=lambda view: view[1][0]):
            look.append(
                Command("View", VIEWS[name], partial(self._look_from, name), keys, chord, separated=name == "front")
            )
        look += [
            Command(
                "View", _("Slices"), self.toggle_slices, "S", Key.s, opened, lambda: s.viewing.slices, separated=True
            ),
            Command(
                "View", _("Measure"), self._measure, "D", Key.d, lambda: s.atoms is not None,
                lambda: s.viewing.slices and self.slice_views.measuring,
            ),
            Command(
                "View",
                _("Perspective"),
                self._toggle_perspective,
                "O",
                Key.o,
                checked=self._in_perspective,
                separated=True,
            ),
            *(self._switch(label, flag) for label, flag in SWITCHES.items()),
            Command(
                "View", _("Larger interface"), partial(self._resize, 1), "Ctrl++", Ctrl | Key.equal,
                lambda: s.settings.scale < SCALES[-1], separated=True,
            ),
            Command(
                "View", _("Smaller interface"), partial(self._resize, -1), "Ctrl+-", Ctrl | Key.minus,
                lambda: s.settings.scale > SCALES[0],
            ),
            Command("View", _("Light theme"), self._toggle_theme, checked=lambda: s.settings.theme == "light"),
            Command(
                "View", _("Move the pointer by keys"), self.pointer.toggle, "F8", Key.f8,
                checked=lambda: self.pointer.on,
            ),
        ]  # fmt: skip
        tools = []
        for tool in TOOLS:
            keys = TOOL_ICONS[tool][2]
            tools.append(
                Command("Tools", TOOL_NAMES[tool], partial(s.select_tool, tool), keys, getattr(Key, keys.lower()))
            )
        return [
            Command("File", _("Open..."), self._open, "Ctrl+O", Ctrl | Key.o),
            Command("File", _("Close"), s.files.close_scene, "Ctrl+W", Ctrl | Key.w, opened),
            Command("File", _("Save"), s.files.save, "Ctrl+S", Ctrl | Key.s, opened, separated=True),
            Command("File", _("Save as..."), self._save_as, "Ctrl+Shift+S", Ctrl | Shift | Key.s, opened),
            Command("File", _("Save picture..."), picture, "Ctrl+E", Ctrl | Key.e, opened, separated=True),
            Command("File", _("Save cut face..."), partial(export, "section"), enabled=is_cut),
            Command("File", _("Save pieces..."), partial(export, "pieces"), enabled=solid),
            Command("File", _("Save pieces as meshes..."), partial(export, "meshes"), enabled=solid),
            Command("File", _("Quit"), s.files.close, "Ctrl+Q", Ctrl | Key.q, separated=True),
            Command("Edit", _("Undo"), s.undo, "Ctrl+Z", Ctrl | Key.z, lambda: s.history.cursor > 0),
            Command(
                "Edit", _("Redo"), s.redo, "Ctrl+Shift+Z", Ctrl | Shift | Key.z,
                lambda: s.history.cursor + 1 < len(s.history.entries),
            ),
            Command("Edit", _("Select all"), self._select_all, "Ctrl+A", Ctrl | Key.a, opened, separated=True),
            Command("Edit", _("Name piece"), self._name_piece, "F2", Key.f2, selected),
            Command("Edit", _("Hide"), s.hide, "H", Key.h, lambda: selected() or s.object_selected),
            Command("Edit", _("Delete"), s.delete, "Del", Key.delete, lambda: selected() and not in_capture()),
            Command("Edit", _("Remove from the capture"), s.isolation.remove_selected, "Del", Key.delete, in_capture),
            Command("Edit", _("Find separate objects"), s.isolation.find_objects, enabled=separable),
            *tools,
            Command("Cut", _("Add plane"), s.add_plane, "", 0, opened),
            Command("Cut", _("Slice evenly..."), self.slices.open, enabled=lambda: s.atoms is not None),
            Command(
                "Cut", _("Throw and slice"), self._throw, "Y", Key.y, lambda: s.atoms is not None,
                lambda: s.throw.active,
            ),
            Command("Cut", _("Put back together"), s.reassemble, "Ctrl+G", Ctrl | Key.g, is_cut),
            Command("Cut", _("Remove all cuts"), self._remove_cuts, enabled=is_cut),
            Command("Interior", _("Give it an inside"), training.start, enabled=can_start),
            Command("Interior", _("Pause"), training.toggle_pause, enabled=lambda: training.can_pause),
            Command("Interior", _("Stop"), training.stop, enabled=lambda: training.busy),
            Command("Interior", _("Resume"), training.resume, enabled=can_resume),
            Command("Interior", _("Choose pictures..."), self._pictures, enabled=opened, separated=True),
            *self._film_commands(),
            *look,
            Command("Help", _("Shortcuts"), self._toggle_shortcuts, "?", Shift | Key.slash),
        ]  # fmt: skip

    def _film_commands(self) -> list[Command]:
        s, film = self.session, self.session.film

        def chosen() -> bool:
            return s.viewing.timeline and not s.selected and film.selected is not None

        def available() -> bool:
            return film.available

        def ready() -> bool:
            return film.ready

        made = [
            Command("Film", label, partial(self._make_film, name), enabled=available, separated=name == "turntable")
            for name, label in PRESETS.items()
        ]
        return [
            Command(
                "Film", _("Timeline"), self._toggle_timeline, "L", Key.l, lambda: s.document.scene is not None,
                lambda: s.viewing.timeline,
            ),
            Command("Film", _("Add keyframe"), self._add_keyframe, "N", Key.n, available, separated=True),
            Command("Film", _("Replace keyframe"), film.update, enabled=chosen),
            Command("Film", _("Remove keyframe"), film.remove, "Del", Key.delete, chosen),
            Command("Film", _("Play"), film.toggle, "Space", Key.space, ready, lambda: film.playing, separated=True),
            Command("Film", _("Keyframe before"), partial(film.step, -1), ",", Key.comma, ready),
            Command("Film", _("Next keyframe"), partial(film.step, 1), ".", Key.period, ready),
            *made,
            Command(
                "Film", _("Save film..."), self.film_window.open, "Ctrl+Shift+E", Ctrl | Shift | Key.e,
                lambda: film.ready and not film.busy, separated=True,
            ),
        ]  # fmt: skip

    # Menus and toolbar

    def show(self) -> None:
        """Draws the menu bar; F10 opens its first menu, from which arrows lead to the others."""
        if imgui.is_key_pressed(Key.f10, False) and not imgui.get_io().want_text_input:
            imgui.open_popup(MENUS[self.commands[0].menu])
        for name in dict.fromkeys(command.menu for command in self.commands):
            if name == "Tools":
                continue  # they are in the toolbar
            if imgui.begin_menu(MENUS[name]):
                for command in self.commands:
                    if command.menu == name:
                        self._item(command)
                        if command.label == _("Open..."):
                            self._recent()
                        if command.label == _("Redo"):
                            self._history()
                imgui.end_menu()

    def _item(self, command: Command) -> None:
        if command.separated:
            imgui.separator()
        checked = command.checked is not None and command.checked()
        keys = command.keys.replace("Ctrl", "Cmd") if sys.platform == "darwin" else command.keys
        if imgui.menu_item(command.label, keys, checked, command.enabled())[0]:
            command.act()

    def _recent(self) -> None:
        if imgui.begin_menu(_("Open recent"), bool(self.session.settings.recent)):
            for name in self.session.settings.recent:
                if imgui.menu_item(Path(name).name, "", False)[0]:
                    self.session.files.open(Path(name))
                tooltip(name)
            imgui.separator()
            if imgui.menu_item_simple(_("Clear this list")):
                self.session.files.forget_recent(*self.session.settings.recent)
            imgui.end_menu()
        if imgui.begin_menu(_("Samples")):
            for name, label in SAMPLES.items():
                if imgui.menu_item(label, "", False)[0]:
                    self.open_sample(name)
            imgui.end_menu()

    def _history(self) -> None:
        history = self.session.history
        if imgui.begin_menu(_("History")):
            first = max(0, len(history.entries) - 30)
            for index in range(first, len(history.entries)):
                label = f"{history.entries[index].name}##{index}"
                if imgui.menu_item(label, "", index == history.cursor)[0]:
                    self.session.jump(index)
            imgui.end_menu()

    def context_menu(self) -> None:
        """Draws the menu of a right click on the object."""
        if self.viewport.menu_requested:
            self.viewport.menu_requested = False
            imgui.open_popup("context")
        if not imgui.begin_popup("context"):
            return
        for label in (_("Hide"), _("Delete"), _("Put back together"), _("Fit")):
            self._item(next(replace(c, separated=False) for c in self.commands if c.label == label))
        if self.viewport.menu_point is not None and imgui.menu_item_simple(_("Stand on this face")):
            self.viewport.stand_on(self.viewport.menu_point)
        hidden = [p.key for p in self.session.pieces if not p.visible]
        if hidden and imgui.menu_item_simple(_("Show all")):
            self.session.change_placements(_("Show all"), frozenset(hidden), lambda p: replace(p, visible=True))
        imgui.end_popup()

    def show_shortcuts(self) -> None:
        """Draws the list of all shortcuts while it is open."""
        if self.shortcuts_shown:
            self.shortcuts_shown = show_shortcuts(self.commands, MENUS)

    # Actions

    def _open(self) -> None:
        self.dialogs.open_scene(self.session.files.open)

    def open_sample(self, name: str) -> None:
        """Opens a sample scene with its pictures, ready to be trained."""
        session = self.session
        session.files.after_saving(
            lambda: session.files.open_document(sample_document(name), replace(session.viewing, mode="capture"))
        )

    def _save_as(self) -> None:
        if self.session.files.choose_path is not None:
            self.session.files.choose_path(self.session.files.save)

    def _pictures(self) -> None:
        self.dialogs.open_pictures(lambda paths: self.session.add_pictures(None, paths))

    def _name_piece(self) -> None:
        self.inspector.pieces.rename()

    def _select_all(self) -> None:
        self.session.selected = frozenset(piece.key for piece in self.session.pieces if piece.visible)

    def _remove_cuts(self) -> None:
        self.session.change(_("Remove all cuts"), replace(self.session.document, cuts=(), placements=()))

    def _toggle_timeline(self) -> None:
        session = self.session
        session.film.leave()
        session.viewing = replace(session.viewing, timeline=not session.viewing.timeline)

    def _add_keyframe(self) -> None:
        self.session.viewing = replace(self.session.viewing, timeline=True)
        self.session.film.add()

    def _make_film(self, name: str) -> None:
        self.session.viewing = replace(self.session.viewing, timeline=True)
        self.session.film.preset(name)

    def toggle_slices(self) -> None:
        """Shows three cut faces beside the object, or the object alone."""
        session = self.session
        session.viewing = replace(session.viewing, slices=not session.viewing.slices)
        if not session.viewing.slices and self.slice_views.measuring:
            self.slice_views.toggle_ruler()

    def _measure(self) -> None:
        self.session.viewing = replace(self.session.viewing, slices=True)
        self.slice_views.toggle_ruler()

    def _toggle_perspective(self) -> None:
        eye = self.session.viewing.eye
        self.session.viewing = replace(self.session.viewing, eye=replace(eye, orthographic=not eye.orthographic))

    def _in_perspective(self) -> bool:
        return not self.session.viewing.eye.orthographic

    def _look_from(self, view: str) -> None:
        self.viewport.go(self.session.viewing.eye.from_side(view))

    def _throw(self) -> None:
        self.session.film.leave()
        if self.session.throw.active:
            self.session.throw.stop()
        else:
            self.session.throw.begin(self.viewport.camera())

    def _switch(self, label: str, flag: str) -> Command:
        """The command for one of SWITCHES."""
        session = self.session

        def is_on() -> bool:
            return bool(getattr(session.settings, flag))

        def switch() -> None:
            changed: dict[str, Any] = {flag: not is_on()}
            session.change_settings(replace(session.settings, **changed))

        return Command("View", label, switch, checked=is_on)

    def _toggle_theme(self) -> None:
        settings = self.session.settings
        new = replace(settings, theme="light" if settings.theme == "dark" else "dark")
        self.session.change_settings(new)
        apply(new.theme, new.scale)

    def _resize(self, way: int) -> None:
        """Makes the interface one size larger or smaller."""
        settings = self.session.settings
        nearest = min(range(len(SCALES)), key=lambda k: abs(SCALES[k] - settings.scale))
        scale = SCALES[min(max(nearest + way, 0), len(SCALES) - 1)]
        self.session.change_settings(replace(settings, scale=scale))
        apply(settings.theme, scale)
        self.session.notify(_("Interface at {scale:.0%}.").format(scale=scale))

    def _toggle_shortcuts(self) -> None:
        self.shortcuts_shown = not self.shortcuts_shown
