"""Reads the scene of a session, makes its objects solid in the background, one after the other, and puts them into the
workspace step by step."""

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
    """Loads one object at a time; a new load replaces the one before."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.strokes: list[tuple[Camera, Stroke]] = []
        """Knife strokes through an object that is not solid yet: they cut once it is."""
        self._isolations: dict[int, Isolation] = {}
        """The isolation with which each object was last loaded, by its number."""
        self._loading = 0
        """Number of the object that the loader loads."""
        self._interrupted: set[int] = set()
        """Numbers of the objects whose load was ended by another one: they are loaded again later."""

    def forget(self) -> None:
        """Forgets the scene, since another one follows."""
        self.strokes.clear()
        self._isolations.clear()
        self._interrupted.clear()

    @property
    def outdated(self) -> Document | None:
        """An object that was never loaded, or whose isolation differs from that of the solid that is shown or being
        made; the active one first. None if there is none, or while an object of several that is up to date is being
        made."""
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
        loader = workspace.loader
        waiting = loader is not None and not loader.request.refit and self._loading in numbers
        return stale[0] if stale and not (waiting and len(documents) > 1) else None

    def load(self, result: Path | None = None, document: Document | None = None, opened: bool = False) -> None:
        """Starts loading an object, by default the active one. `result`: a finished training result to show in its
        place. `opened`: whether to leave out its surroundings, if there are any."""
        workspace = self.workspace
        document = document or workspace.document
        if workspace.loader is not None and not self.stop_refit():
            workspace.loader.cancel()
            self._interrupted.add(self._loading)
        self._interrupted.discard(document.number)
        scene, training, isolation = document.scene, document.training, document.isolation
        assert scene is not None
        shown = workspace.loaded.get(document.number)
        if shown is not None and isolation != shown.request.isolation:
            # The solid no longer matches the isolation; the capture is shown until there is a new one.
            workspace.loaded[document.number] = replace(shown, atoms=None, trained=False)
        self._isolations[document.number], self._loading = isolation, document.number
        try:
            workspace.loader = SceneLoader(
                SceneRequest(scene, training.detail, training.seed, result, isolation, opened)
            )
        except InputError as error:  # no space for temporary files
            workspace.loader = None
            workspace.show_error(error)

    @property
    def rough(self) -> Document | None:
        """An object whose skin can still be fitted more closely, the active one first; None if there is none."""
        workspace = self.workspace
        documents = sorted(workspace.documents, key=lambda document: document is not workspace.document)
        loaded = workspace.loaded
        return next((d for d in documents if d.number in loaded and loaded[d.number].rough), None)

    def refit(self, document: Document) -> None:
        """Starts to fit the skin of a solid that is shown as closely as training does."""
        workspace, shown = self.workspace, self.workspace.loaded[document.number]
        request = replace(shown.request, refit=True)
        self._isolations[document.number], self._loading = request.isolation, document.number
        try:
            workspace.loader = SceneLoader(request, shown)
        except InputError as error:  # no space for temporary files
            self._accept_skin()
            workspace.show_error(error)
            return
        workspace.loader.announced = True

    def stop_refit(self) -> bool:
        """Stops fitting the skin of a solid that is shown, if that is being done, until there is nothing else to do;
        whether it was."""
        loader = self.workspace.loader
        if loader is None or not loader.request.refit:
            return False
        loader.cancel()
        self.workspace.loader = None
        return True

    def _accept_skin(self) -> None:
        """Leaves the skin of the object that was loaded last as it is."""
        loaded = self.workspace.loaded
        if self._loading in loaded:
            loaded[self._loading] = replace(loaded[self._loading], rough=False)

    def cancel(self) -> None:
        """Stops loading; what was loaded stays."""
        if self.workspace.loader is not None:
            self.workspace.loader.cancel()
            self.workspace.loader = None
            self.strokes.clear()
            self._accept_skin()
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
                self._accept_skin()
            workspace.loader = None
        return changed

    def _show(self, loader: SceneLoader) -> None:
        workspace = self.workspace
        before = workspace.loaded.get(self._loading)
        first = all(one.solid is None for one in workspace.loaded.values())
        new = loader.scene
        # If the same scene is loaded again, or another object of it, they share one copy of the capture.
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
        """Adopts the isolation of a scene that was just opened, whose surroundings were found and left out."""
        workspace = self.workspace
        document, changed = replace(workspace.document, isolation=isolation), workspace.history.changed
        if find_result(document) is None:  # otherwise the result is loaded in place of this solid
            self._isolations[self._loading] = isolation
        workspace.change(_("Leave out the surroundings"), document)
        if not changed:  # the user has done nothing that should be saved
            workspace.history.saved = workspace.history.state
        workspace.notify(_("What is around the object is left out. Undo brings it back."))
