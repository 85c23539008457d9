"""The scene of a session: reads it, makes it solid in the background, and puts it into the workspace step by step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.jobs.scene_loader import SceneLoader, SceneRequest
from app.model.project import Viewing
from app.session.workspace import Workspace
from engine.errors import InputError
from engine.isolate.selection import Isolation

__all__ = ["SceneController"]


class SceneController:
    """Loads one scene at a time; a new one takes the place of the last."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._isolation: Isolation = ()
        """What was left out when the scene was last loaded."""

    @property
    def outdated(self) -> bool:
        """Whether the document leaves out other parts of the capture than the solid that is shown or being made."""
        document = self.workspace.document
        return document.scene is not None and document.isolation != self._isolation

    def load(self, result: Path | None = None) -> None:
        """Starts loading the document's scene; with a `result`, shows that finished training in its place."""
        workspace = self.workspace
        if workspace.loader is not None:
            workspace.loader.cancel()
        scene, training = workspace.document.scene, workspace.document.training
        assert scene is not None
        isolation = workspace.document.isolation
        if workspace.object is not None and isolation != workspace.object.request.isolation:
            # The solid is of something else now; the capture is shown until there is another one.
            workspace.object = replace(workspace.object, atoms=None, trained=False)
        self._isolation = isolation
        try:
            workspace.loader = SceneLoader(SceneRequest(scene, training.detail, training.seed, result, isolation))
        except InputError as error:  # no space for temporary files
            workspace.loader = None
            workspace.show_error(error)

    def cancel(self) -> None:
        """Stops loading; what is loaded stays."""
        if self.workspace.loader is not None:
            self.workspace.loader.cancel()
            self.workspace.loader = None
            self.workspace.notify("Stopped.")

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
        first = workspace.object is None or workspace.object.solid is None
        new = loader.scene
        before = workspace.object
        if before is not None and before.capture is not None:  # the same scene again: show it until there is more
            if before.request.seed == new.request.seed:
                new = replace(new, capture=before.capture)
            if new.atoms is None and before.atoms is not None:
                new = replace(before, request=new.request)
        workspace.object = new
        workspace.geometry_version += 1
        if first and workspace.viewing.eye == Viewing().eye:
            workspace.fit()
        if new.trained and workspace.viewing.mode == "capture":
            workspace.viewing = replace(workspace.viewing, mode="solid")
        if new.atoms is not None and not loader.announced:
            loader.announced = True
            workspace.notify(f"{loader.request.scene.name} is solid now. Press K and drag across it to cut it.")
