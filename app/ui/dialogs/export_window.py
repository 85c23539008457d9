"""The export window: the options of a picture or of pieces, and a note while they are being saved."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import ImVec2, imgui

from app.jobs.export import STILLS
from app.translation import _
from app.ui.dialogs.exporter import Exporter, Options
from app.ui.dialogs.file_dialogs import FileDialogs
from app.ui.theme import Fonts, px
from app.ui.widgets import cancel_button, font, main_button, modal, row_label, secondary
from engine.export.kinds import KINDS
from engine.io.writers.splats import SPLAT_WRITERS

__all__ = ["ExportWindow"]

TITLES = {
    "picture": _("Save picture"),
    "section": _("Save cut face"),
    "pieces": _("Save pieces"),
    "meshes": _("Save pieces as meshes"),
}
HINTS = {
    "picture": _("What the window shows, in any size."),
    "section": _("The active cut looked at straight on, with a scale and nothing around it."),
    "pieces": _("For other programs. Cut faces there are as fine as its points; every 3DGS viewer opens a .ply."),
    "meshes": _(
        "Closed, with cut faces as fine as the pictures, for Blender, game engines and printers. The selected "
        "pieces of this object, or all of them."
    ),
}
LARGEST = 8192
"""Most pixels along a side; OpenGL drivers without a larger limit are common."""


class ExportWindow:
    """A modal window for the options of an export."""

    def __init__(self, exporter: Exporter, dialogs: FileDialogs) -> None:
        self.exporter, self.dialogs = exporter, dialogs
        self.options = Options()
        self.requested = False

    def open(self, kind: str) -> None:
        """Opens the window for this kind of export."""
        self.options.kind = kind
        self.requested = True

    def show(self) -> None:
        """Draws one frame."""
        self.exporter.step()
        if self.exporter.busy:
            self._show_progress()
            return
        if self.requested:
            imgui.open_popup("Export")
        with modal("Export", 380) as opened:
            if opened:
                self._body()

    def _body(self) -> None:
        o = self.options
        with font(Fonts.bold):
            imgui.text_unformatted(TITLES[o.kind])
        secondary(HINTS[o.kind], wrap=True)
        imgui.dummy(ImVec2(0, px(4)))
        if o.kind == "section":
            row_label(_("Size"), 110)
            o.width = bounded(imgui.input_int("##side", o.width, 100)[1])
        elif o.kind not in ("pieces", "meshes"):
            row_label(_("Width"), 110)
            o.width = bounded(imgui.input_int("##width", o.width, 100)[1])
            row_label(_("Height"), 110)
            o.height = bounded(imgui.input_int("##height", o.height, 100)[1])
        if o.kind in ("picture", "section"):
            row_label(_("Background"), 110)
            o.transparent = not imgui.checkbox(_("white") + "##ground", not o.transparent)[1]
        if o.kind == "pieces":
            row_label(_("Format"), 110)
            splats = list(SPLAT_WRITERS)
            o.splats = splats[imgui.combo("##splats", splats.index(o.splats), [s[1:].upper() for s in splats])[1]]
            row_label(_("Files"), 110)
            o.separate = imgui.checkbox(_("one for each piece"), o.separate)[1]
        if o.kind == "meshes":
            row_label(_("Format"), 110)
            meshes = KINDS["mesh"].suffixes
            o.meshes = meshes[imgui.combo("##meshes", meshes.index(o.meshes), [s[1:].upper() for s in meshes])[1]]
        imgui.dummy(ImVec2(0, px(6)))
        if main_button(_("Choose where..."), px(150)):
            self._choose()
        imgui.same_line()
        if cancel_button():
            self.requested = False
        if not self.requested:
            imgui.close_current_popup()

    def _choose(self) -> None:
        o = self.options
        suffix = {"pieces": o.splats, "meshes": o.meshes}.get(o.kind) or ".png"
        scene = self.exporter.session.document.scene
        stem = scene.stem if scene else "object"
        folder = scene.parent if scene else Path.home()
        name = folder / f"{stem}_{o.kind}{suffix}"
        self.requested = False

        def then(path: Path, asked: bool) -> None:
            paths = self.exporter.targets(o, path)
            files = self.exporter.session.files
            files.write(paths, asked and paths == [path], lambda: self.exporter.run(o, path))

        suffixes = {"pieces": tuple(SPLAT_WRITERS), "meshes": KINDS["mesh"].suffixes}.get(o.kind) or STILLS
        own = [suffix, *(other for other in suffixes if other != suffix)]
        self.dialogs.save(TITLES[o.kind], name, [suffix[1:].upper(), f"*{suffix}"], own, then)

    def _show_progress(self) -> None:
        imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
        imgui.set_next_window_size(ImVec2(px(320), 0))
        flags = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_docking | imgui.WindowFlags_.no_saved_settings
        imgui.begin("##exporting", None, flags)
        secondary(_("Saving {name}").format(name=self.exporter.path.name if self.exporter.path else ""))
        if imgui.button(_("Cancel")):
            self.exporter.cancel()
        imgui.end()


def bounded(pixels: int) -> int:
    """The nearest number of pixels that can be drawn along a side."""
    return min(max(16, pixels), LARGEST)
