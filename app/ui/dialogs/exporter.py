"""Saves pictures and pieces; another thread makes and writes meshes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.jobs.export import save_meshes, save_pieces, save_still, section_picture
from app.session.session import Session
from app.translation import _, ngettext
from app.ui.view.painter import Painter
from engine.errors import InputError
from engine.export.colours import Colours
from engine.scene.camera import Camera
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["Exporter", "Options"]

Frame = NDArray[np.uint8]


@dataclass
class Options:
    """The options of the export window."""

    kind: str = "picture"
    """'picture', 'section', 'pieces' or 'meshes'."""
    width: int = 1600
    height: int = 1000
    transparent: bool = True
    splats: str = ".ply"
    """Suffix of pieces saved as splats."""
    separate: bool = False
    """Whether each piece is saved in its own file."""
    meshes: str = ".glb"


class Exporter:
    """Runs one export at a time."""

    def __init__(self, session: Session, painter: Painter) -> None:
        self.session, self.painter = session, painter
        self.path: Path | None = None
        """The file that is being written."""
        self._thread: threading.Thread | None = None
        self._error = ""
        self._cancelled = False

    @property
    def busy(self) -> bool:
        """Whether meshes are being saved."""
        return self._thread is not None

    def run(self, options: Options, path: Path) -> None:
        """Saves at once, or starts saving meshes. The session shows errors."""
        try:
            if options.kind == "pieces":
                self._pieces(options, path)
            elif options.kind == "meshes":
                self._meshes(path)
            elif options.kind == "section":
                self._section(options, path)
            else:
                camera = self._camera(options)
                save_still(path, self._draw(camera, self._shown()), options.transparent)
                self.session.notify(_("Saved {name}.").format(name=path.name))
        except InputError as error:
            self.session.show_error(error)

    def targets(self, options: Options, path: Path) -> list[Path]:
        """The files that `run` writes."""
        if options.kind != "pieces" or not options.separate:
            return [path]
        return [_numbered(path, number) for number in range(1, len(self.session.members) + 1)]

    def step(self) -> None:
        """Tells the user when meshes have been saved. Called once a frame."""
        if self._thread is None:
            return
        if not self._thread.is_alive():
            name = self.path.name if self.path else ""
            self._thread = None
            if self._error:
                self.session.show_error(self._error)
            else:
                self.session.notify(_("Saved {name}.").format(name=name) if not self._cancelled else _("Stopped."))

    def cancel(self) -> None:
        """Stops before meshes are written, and leaves no file behind."""
        self._cancelled = True

    def _start(self, path: Path, work: Callable[[], object]) -> None:
        """Starts the thread that writes a file."""
        self.path, self._error, self._cancelled = path, "", False
        self._thread = threading.Thread(target=self._write, args=(path, work), daemon=True)
        self._thread.start()

    def _write(self, path: Path, work: Callable[[], object]) -> None:
        try:
            work()
        except InputError as error:
            self._error = "" if self._cancelled else str(error)
        except Exception as error:  # otherwise the window would wait for a dead thread
            self._error = _("{path}: could not be written ({error})").format(path=path, error=error)

    def _section(self, options: Options, path: Path) -> None:
        session = self.session
        size, viewing = max(options.width, 64), session.viewing
        if session.atoms is None:
            raise InputError(_("There is no solid to save yet."))
        session.viewing = replace(viewing, mode="solid")  # a capture is not cut
        try:
            picture = section_picture(
                self._draw, self._plane(), self._uncut(), session.up, session.solid, size, viewing.unit
            )
        finally:
            session.viewing = viewing
        save_still(path, picture, options.transparent)
        session.notify(_("Saved {name}.").format(name=path.name))

    def _plane(self) -> Plane:
        """The plane of the active cut, or else of the last straight one; raises InputError if there is none."""
        cuts = [cut for cut in self.session.document.cuts if not cut.curved]
        if not cuts:
            raise InputError(_("This needs a straight cut. Cut the object or add a plane first."))
        cut = next((cut for cut in cuts if cut.id == self.session.active_cut), cuts[-1])
        return cut.plane(cut.parts[0])

    def _pieces(self, options: Options, path: Path) -> None:
        session = self.session
        solids = session.solids
        if not solids:
            raise InputError(_("There is no solid to save yet."))
        pieces = [(solids[session.documents[m.index].number], m.piece) for m in session.members]
        if not options.separate:
            count = save_pieces(path, pieces, session.view_up, session.viewing.unit.metres)
            session.notify(_("Saved {count:,} Gaussians in {name}.").format(count=count, name=path.name))
            return
        for number, piece in enumerate(pieces, 1):
            save_pieces(_numbered(path, number), [piece], session.view_up, session.viewing.unit.metres)
        session.notify(
            ngettext("Saved {count} piece as {name}.", "Saved {count} pieces beside {name}.", len(pieces)).format(
                count=len(pieces), name=_numbered(path, 1).name
            )
        )

    def _meshes(self, path: Path) -> None:
        session = self.session
        members = [m for m in session.members if m.index == session.active and session.is_cut(m)]
        if session.atoms is None or not members:
            raise InputError(_("There is no piece to save; show or select one."))
        colours = Colours(session.atoms, session.loaded[session.document.number].inside)
        work = partial(
            save_meshes,
            path,
            [m.piece for m in members],
            colours,
            session.view_up,
            session.viewing.unit.metres,
            lambda: not self._cancelled,
        )
        self._start(path, work)

    def _camera(self, options: Options) -> Camera:
        return self.session.viewing.eye.camera(options.width, options.height, self.session.view_up)

    def _shown(self) -> list[Piece]:
        return self.session.drawn(self.session.members)

    def _uncut(self) -> Piece:
        """The whole active object, alone and in its original place."""
        return Piece(solid=list(self.session.solids).index(self.session.document.number))

    def _draw(self, camera: Camera, pieces: Sequence[Piece]) -> Frame:
        return self.painter.picture(self.session, camera, pieces)


def _numbered(path: Path, number: int) -> Path:
    """The file of one of several pieces."""
    return path.with_name(f"{path.stem}_{number}{path.suffix}")
