"""Opens, saves and closes in a session; unsaved work is never dropped without asking."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.jobs.scene_loader import LoadedObject
from app.model.autosave import UnsavedWork
from app.model.document import Document
from app.model.film.timeline import Timeline
from app.model.history import History
from app.model.project import SUFFIX, Outside, Viewing, Work, load_project, save_project
from app.session.film_controller import FilmController
from app.session.question import Choice
from app.session.recent_pictures import remove_pictures
from app.session.scene_controller import SceneController
from app.session.training_controller import TrainingController
from app.session.workspace import Documents, Workspace
from app.translation import _
from engine.errors import InputError
from engine.io.picture_file import PICTURE_SUFFIXES

__all__ = ["ProjectFiles"]

PATHS_LISTED = 6
"""Most files outside a project's folder that the question names; more would not fit the window."""


@dataclass(frozen=True)
class _Opened:
    """What was open, kept while something else is being read in its place."""

    history: History[Work]
    viewing: Viewing
    path: Path | None
    active: int
    loaded: dict[int, LoadedObject]


class ProjectFiles:
    """Opens the session's documents from files, and saves them."""

    def __init__(
        self, workspace: Workspace, scene: SceneController, training: TrainingController, film: FilmController
    ) -> None:
        self.workspace, self.scene, self.training, self.film = workspace, scene, training, film
        self.choose_path: Callable[[Callable[[Path], None]], None] | None = None
        """Opens the window's dialog for a new project's path, and calls its argument with the path chosen."""
        self._before: _Opened | None = None
        """What comes back if the scene that is being read turns out to be unreadable."""

    def open(self, path: Path) -> None:
        """Opens a scene or a project, after asking about unsaved changes, or adds a picture to a family."""
        if path.suffix.lower() in PICTURE_SUFFIXES:
            if self.workspace.document.scene is None:
                self.workspace.notify(_("Open an object first, then add pictures of its cut faces."))
            else:
                self.workspace.add_pictures(None, (path,))
            return
        act = self._open_project if path.suffix == SUFFIX else self._open_scene
        self.after_saving(lambda: act(path))

    def open_document(self, document: Document, viewing: Viewing, opened: bool = False) -> None:
        """The same as `open_documents` for a single object without a project."""
        self.open_documents((document,), viewing, None, opened=opened)

    def open_documents(
        self,
        documents: Documents,
        viewing: Viewing,
        path: Path | None,
        film: Timeline | None = None,
        opened: bool = False,
    ) -> None:
        """Replaces the session's documents and film, finds their training jobs and loads their scene. `path`: their
        project file. `opened`: as in `SceneController.load`."""
        workspace = self.workspace
        if workspace.object is not None:
            self._before = _Opened(
                workspace.history, workspace.viewing, workspace.path, workspace.active, dict(workspace.loaded)
            )
        workspace.history = History(Work(documents, film or Timeline()))
        workspace.active, workspace.object_selected = 0, False
        workspace.viewing, workspace.path = viewing, path
        workspace.selected, workspace.active_cut, workspace.tool = frozenset(), None, "select"
        workspace.error = ""
        workspace.loaded.clear()
        workspace.geometry_version += 1
        self.scene.forget()
        self.training.forget()
        for document in documents:
            self.training.find_job(document)
        if workspace.document.scene is None:
            self._stop_loading()
            return
        result = self.training.result_for(workspace.document)
        self.scene.load(result, opened=opened and result is None)

    def close_scene(self) -> None:
        """Closes what is open, after asking about unsaved changes."""
        self.after_saving(self._open_nothing)

    def _open_nothing(self) -> None:
        self.open_document(Document(), Viewing())

    def _stop_loading(self) -> None:
        """Nothing is loaded, and nothing comes back in its place."""
        if self.workspace.loader is not None:
            self.workspace.loader.cancel()
        self.workspace.loader = self._before = None

    def tick(self) -> None:
        """Goes back to what was open before if the new scene could not be read. Called once a frame."""
        workspace, before = self.workspace, self._before
        if before is None or workspace.loader is not None:
            return
        self._before = None
        if workspace.loaded:
            return
        error = workspace.error
        self.scene.forget()
        self.training.forget()
        workspace.history, workspace.viewing, workspace.path = before.history, before.viewing, before.path
        workspace.active, workspace.loaded = before.active, before.loaded
        workspace.geometry_version += 1
        for document in workspace.documents:
            self.training.find_job(document)
        if workspace.atoms is None:  # it was still being made solid
            self.scene.load(self.training.result_for(workspace.document))
        workspace.show_error(error)

    def after_saving(self, act: Callable[[], None]) -> None:
        """Calls `act` at once, or once the user has decided what happens to unsaved changes."""
        if not self.workspace.history.changed:
            act()
            return

        def save_first() -> None:
            self.save(then=act)

        self.workspace.ask(
            _("Unsaved changes"),
            _("Save the changes to {name} first?").format(name=self.workspace.title.removesuffix(" *")),
            Choice(_("Save"), save_first, main=True),
            Choice(_("Don't save"), act),
        )

    def _open_scene(self, path: Path) -> None:
        if not path.is_file():
            self.workspace.show_error(_("{path}: no such file").format(path=path))
            return
        self.open_document(Document(scene=path.absolute()), Viewing(mode="capture"), opened=True)
        self.workspace.change_settings(self.workspace.settings.with_recent(path))

    def _open_project(self, path: Path, outside: bool = False) -> None:
        settings = self.workspace.settings
        try:
            project = load_project(path, outside=outside or settings.trusts(path))
            settings = settings.with_recent(path)
            settings = settings.with_trusted(path) if outside else settings
        except Outside as error:
            names = "\n".join(str(p) for p in error.paths[:PATHS_LISTED])
            names += "\n..." if len(error.paths) > PATHS_LISTED else ""
            self.workspace.ask(
                _("Files outside of the project's folder"),
                _(
                    "{name} uses files that are not in its folder:\n{names}\nOpen it only if you know where it is from."
                ).format(name=path.name, names=names),
                Choice(_("Open anyway"), lambda: self._open_project(path, outside=True)),
            )
            return
        except InputError as error:
            self.workspace.show_error(error)
            return
        self.workspace.change_settings(settings)
        self.open_documents(project.documents, project.viewing, path, project.film)

    def recover(self, work: UnsavedWork) -> None:
        """Opens the unsaved work of a session that crashed."""
        try:
            project = work.load()
        except InputError as error:
            self.workspace.show_error(error)
            return
        self.open_documents(project.documents, project.viewing, work.project, project.film)
        self._before = None  # recovered work stays open even if its scene cannot be read
        self.workspace.history.saved = None  # still unsaved
        self.workspace.notify(_("Your unsaved work is back. Save it to keep it."))
        self.workspace.autosave.take_over(work)

    @property
    def recent_name(self) -> str | None:
        """The name of what is open in the list of recent files; None if it is not listed, such as a sample."""
        path = self.workspace.path or self.workspace.document.scene
        name = None if path is None else str(path.resolve())
        return name if name in self.workspace.settings.recent else None

    def forget_recent(self, *names: str) -> None:
        """Takes files off the list of recent ones, and removes their pictures."""
        settings = self.workspace.settings
        for name in names:
            settings = settings.without_recent(name)
        self.workspace.change_settings(settings)
        remove_pictures(settings.recent)

    def save(self, path: Path | None = None, then: Callable[[], None] = lambda: None) -> None:
        """Saves the project, asking for a path if it has none, and calls `then` once it is saved."""
        path = path or self.workspace.path
        if path is None:
            if self.choose_path is not None:
                self.choose_path(lambda chosen: self.save(chosen, then))
            return
        try:
            save_project(path, self.workspace.project)
            # A project that the user saved here is opened again without asking.
            settings = self.workspace.settings.with_recent(path).with_trusted(path)
        except InputError as error:
            self.workspace.show_error(error)
            return
        self.workspace.path, self.workspace.history.saved = path, self.workspace.history.state
        self.workspace.autosave.clear()
        self.workspace.change_settings(settings)
        self.workspace.notify(_("Saved {name}.").format(name=path.name))
        then()

    def write(self, paths: Sequence[Path], asked: bool, act: Callable[[], None]) -> None:
        """Calls `act`, which writes files, unless one of them is open here; asks before others are replaced, if a
        dialog has not `asked`."""
        there = [path for path in paths if path.exists()]
        results = [self.training.result_for(document) for document in self.workspace.documents]
        used = [document.scene for document in self.workspace.documents] + results
        for path in there:
            if any(file is not None and file.exists() and path.samefile(file) for file in used):
                self.workspace.show_error(_("{path}: is open here; give another name").format(path=path))
                return
        if asked or not there:
            act()
            return
        names = ", ".join(path.name for path in there[:PATHS_LISTED]) + ", ..." * (len(there) > PATHS_LISTED)
        text = _("Already in this folder: {names}").format(names=names)
        self.workspace.ask(_("Replace what is there?"), text, Choice(_("Replace"), act, main=True))

    def close(self) -> None:
        """Closes the session, after asking about unsaved changes, a film that is being saved and a running job."""
        self.after_saving(self._ask_about_film)

    def _ask_about_film(self) -> None:
        if not self.film.busy:
            self._ask_about_job()
            return

        def stop() -> None:
            self.film.cancel()
            self._ask_about_job()

        text = _("It ends with the window. Frames in a folder are kept, and go on from there when it is saved again.")
        self.workspace.ask(_("A film is still being saved"), text, Choice(_("Stop it"), stop, main=True))

    def _ask_about_job(self) -> None:
        running = [job for job in self.training.jobs if job.phase in ("running", "paused")]
        if not running:
            self._close_now()
            return

        def stop() -> None:
            for job in running:
                job.stop()
            self._close_now()

        self.workspace.ask(
            _("Training is still running"),
            _("It can go on without the window, and is found again when you come back."),
            Choice(_("Leave it running"), self._close_now, main=True),
            Choice(_("Stop it"), stop),
        )

    def _close_now(self) -> None:
        if self.workspace.loader is not None:
            self.workspace.loader.cancel()
        self.workspace.autosave.clear()
        self.workspace.closing = True
