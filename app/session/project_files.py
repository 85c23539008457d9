"""Opening and saving in a session, and leaving it: never loses work without asking."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from app.model.autosave import Rescued
from app.model.document import Document
from app.model.project import SUFFIX, Outside, Project, Viewing, load_project, save_project
from app.model.question import Choice
from engine.errors import InputError

if TYPE_CHECKING:
    from app.session.session import Session

__all__ = ["PICTURES", "Files"]

PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp")


class Files:
    """Of one session."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.ask_where: Callable[[Callable[[Path], None]], None] | None = None
        """The window's dialog for the place of a new project."""

    def open(self, path: Path) -> None:
        """A scene, a project, or a picture for a family; asks first where work would be lost."""
        if path.suffix.lower() in PICTURES:
            self.session.add_pictures(None, (path,))
            return
        act = self._open_project if path.suffix == SUFFIX else self._open_scene
        self.unless_unsaved(lambda: act(path))

    def unless_unsaved(self, act: Callable[[], None]) -> None:
        """Does it at once, or after asking what becomes of unsaved changes."""
        if not self.session.history.changed:
            act()
            return

        def save_first() -> None:
            self.save(then=act)

        self.session.ask(
            "Unsaved changes",
            f"Save the changes to {self.session.title.removesuffix(' *')} first?",
            Choice("Save", save_first, main=True),
            Choice("Don't save", act),
        )

    def _open_scene(self, path: Path) -> None:
        if not path.is_file():
            self.session.fail(f"{path}: no such file")
            return
        self.session.show(Document(scene=path.absolute()), Viewing(mode="capture"), None)
        self.session.remember(self.session.settings.with_recent(path))

    def _open_project(self, path: Path, outside: bool = False) -> None:
        settings = self.session.settings
        try:
            project = load_project(path, outside=outside or settings.trusts(path))
            settings = settings.with_recent(path)
            settings = settings.with_trusted(path) if outside else settings
        except Outside as error:
            names = "\n".join(str(p) for p in error.paths[:6]) + ("\n..." if len(error.paths) > 6 else "")
            self.session.ask(
                "Files outside of the project's folder",
                f"{path.name} uses files that are not in its folder:\n{names}\n"
                "Open it only if you know where it is from.",
                Choice("Open anyway", lambda: self._open_project(path, outside=True)),
            )
            return
        except InputError as error:
            self.session.fail(error)
            return
        self.session.remember(settings)
        self.session.show(project.document, project.viewing, path)

    def recover(self, rescued: Rescued) -> None:
        """Takes up the unsaved work of a session that crashed."""
        try:
            project = rescued.load()
        except InputError as error:
            self.session.fail(error)
            return
        self.session.show(project.document, project.viewing, rescued.project)
        self.session.history.saved = None  # it is unsaved still
        self.session.say("Your unsaved work is back. Save it to keep it.")
        rescued.discard()

    def save(self, path: Path | None = None, then: Callable[[], None] = lambda: None) -> None:
        """Saves the project, asking for its place where it has none; goes on with `then` once it is saved."""
        path = path or self.session.path
        if path is None:
            if self.ask_where is not None:
                self.ask_where(lambda chosen: self.save(chosen, then))
            return
        path = path if path.suffix == SUFFIX else path.with_name(path.name + SUFFIX)
        try:
            save_project(path, Project(self.session.document, self.session.viewing))
            # What the user saved from here may be opened again without a question.
            settings = self.session.settings.with_recent(path).with_trusted(path)
        except InputError as error:
            self.session.fail(error)
            return
        self.session.path, self.session.history.saved = path, self.session.document
        self.session.autosave.clear()
        self.session.remember(settings)
        self.session.say(f"Saved {path.name}.")
        then()

    def close(self) -> None:
        """The user wants to leave: asks about unsaved work, then about a running job."""
        self.unless_unsaved(self._close_job)

    def _close_job(self) -> None:
        job = self.session.desk.job
        if job is None or job.phase not in ("running", "paused"):
            self._leave()
            return

        def stop() -> None:
            job.stop()
            self._leave()

        self.session.ask(
            "Training is still running",
            "It can go on without the window, and is found again when you come back.",
            Choice("Leave it running", self._leave, main=True),
            Choice("Stop it", stop),
        )

    def _leave(self) -> None:
        if self.session.preparing is not None:
            self.session.preparing.cancel()
        self.session.autosave.clear()
        self.session.closing = True
