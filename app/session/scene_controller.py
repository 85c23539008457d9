"""The scene of a session: reads it, makes its objects solid in the background, one after the other, and puts them into
the workspace step by step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.jobs.results import find_result
from app.jobs.scene_loader import SceneLoader, SceneRequest
from app.model.document import Document
from app.model.knife import Stroke
from app.model.project import Viewing
from app.session.workspace import Workspace
from app.translation import _
from engine.errors import InputError
from engine.isolate.selection import Isolation
from engine.scene.camera import Camera

__all__ = ["SceneController"]


class SceneController:
    """Loads one object at a time; a new load takes the place of the last."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.strokes: list[tuple[Camera, Stroke]] = []
        """Of the knife, through an object that is not solid yet: they are done when it is."""
        self._isolations: dict[int, Isolation] = {}
        """What was left out when each object was last loaded, by its number."""
        self._loading = 0
        """Number of the object that the loader loads."""
        self._interrupted: set[int] = set()
        """Numbers of the objects whose load another one has ended: their turn comes again."""

    def forget(self) -> None:
        """Another scene follows: nothing of it has been loaded."""
        self.strokes.clear()
        self._isolations.clear()
        self._interrupted.clear()

    @property
    def outdated(self) -> Document | None:
        """An object of whose capture other parts are left out than in the solid that is shown or being made, or that
        was never loaded; the active one first, and none while one that is up to date is being made."""
        workspace = self.workspace
        documents = sorted(workspace.documents, key=lambda document: document is not workspace.document)
        made = {number: loaded.request.isolation for number, loaded in workspace.loaded.items()} | self._isolations
        stale = [
            document
            for document in documents
            if document.scene is not None
            and (document.number in self._interrupted or document.isolation != made.get(document.number))
        ]
        numbers = {document.number for document in documents} - {document.number for document in stale}
        waiting = workspace.loader is not None and self._loading in numbers
        return stale[0] if stale and not (waiting and len(documents) > 1) else None

    def load(self, result: Path | None = None, document: Document | None = None, opened: bool = False) -> None:
        """Starts loading an object, the active one by default; with a `result`, shows that finished training in its
        place. `opened`: its surroundings, if it has any, are left out."""
        workspace = self.workspace
        document = document or workspace.document
        if workspace.loader is not None:
            workspace.loader.cancel()
            self._interrupted.add(self._loading)
        self._interrupted.discard(document.number)
        scene, training, isolation = document.scene, document.training, document.isolation
        assert scene is not None
        shown = workspace.loaded.get(document.number)
        if shown is not None and isolation != shown.request.isolation:
            # The solid is of something else now; the capture is shown until there is another one.
            workspace.loaded[document.number] = replace(shown, atoms=None, trained=False)
        self._isolations[document.number], self._loading = isolation, document.number
        try:
            workspace.loader = SceneLoader(
                SceneRequest(scene, training.detail, training.seed, result, isolation, opened)
            )
        except InputError as error:  # no space for temporary files
            workspace.loader = None
            workspace.show_error(error)

    def cancel(self) -> None:
        """Stops loading; what is loaded stays."""
        if self.workspace.loader is not None:
            self.workspace.loader.cancel()
            self.workspace.loader = None
            self.strokes.clear()
            self.workspace.notify(_("Stopped."))

    def tick(self) -> bool:
        """Takes over what has been loaded since the last call; True if the object has changed."""
        workspace, loader = self.workspace, self.workspace.loader
        if loader is None:
            return False
        changed = loader.poll()
        if changed:
            self._show(loader)
        if loader.ended:
            if loader.error:
                workspace.show_error(loader.error)
            workspace.loader = None
        return changed

    def _show(self, loader: SceneLoader) -> None:
        workspace = self.workspace
        before = workspace.loaded.get(self._loading)
        first = all(one.solid is None for one in workspace.loaded.values())
        new = loader.scene
        # The same scene again, or another object of it: one copy of the capture is shown until there is more.
        same = (one for one in workspace.loaded.values() if one.request.scene == new.request.scene)
        captures = [one.capture for one in same if one.request.seed == new.request.seed and one.capture is not None]
        if captures and new.capture is not None:
            new = replace(new, capture=captures[0])
        if before is not None and before.capture is not None and new.atoms is None and before.atoms is not None:
            new = replace(before, request=new.request)
        workspace.loaded[self._loading] = new
        if new.request.isolation != self._isolations[self._loading]:
            self._leave_out(new.request.isolation)
        workspace.geometry_version += 1
        if first and workspace.viewing.eye == Viewing().eye:
            workspace.fit()
        if new.trained and workspace.viewing.mode == "capture":
            workspace.viewing = replace(workspace.viewing, mode="solid")
        if new.atoms is not None and not loader.announced:
            loader.announced = True
            names = {document.number: document.title for document in workspace.documents}
            name = names.get(self._loading) if len(names) > 1 else loader.request.scene.name
            workspace.notify(_("{name} is solid now. Press K and drag across it to cut it.").format(name=name))

    def _leave_out(self, isolation: Isolation) -> None:
        """Takes over that surroundings were found in a scene that has just been opened."""
        workspace = self.workspace
        document, changed = replace(workspace.document, isolation=isolation), workspace.history.changed
        if find_result(document) is None:  # else it is loaded in place of this solid
            self._isolations[self._loading] = isolation
        workspace.change(_("Leave out the surroundings"), document)
        if not changed:  # nobody has done anything that should be saved
            workspace.history.saved = workspace.history.state
        workspace.notify(_("What is around the object is left out. Undo brings it back."))
