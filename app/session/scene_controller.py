"""The scene of a session: reads it, makes it solid in the background, and puts it into the workspace step by step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.jobs.scene_loader import SceneLoader, SceneRequest
from app.model.project import Viewing
from app.session.workspace import Workspace
from engine.errors import InputError

__all__ = ["SceneController"]


class SceneController:
    """Loads one scene at a time; a new one takes the place of the last."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace

    def load(self, result: Path | None = None) -> None:
        """Starts loading the document's scene; with a `result`, shows that finished training in its place."""
        workspace = self.workspace
        if workspace.loader is not None:
            workspace.loader.cancel()
        scene, training = workspace.document.scene, workspace.document.training
        assert scene is not None
        try:
            workspace.loader = SceneLoader(SceneRequest(scene, training.detail, training.seed, result))
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
        if workspace.object is not None and new.atoms is None and workspace.object.capture is not None:
            new = replace(workspace.object, request=new.request)  # the same scene again: show it until there is more
        workspace.object = new
        workspace.geometry_version += 1
        if first and workspace.viewing.eye == Viewing().eye:
            workspace.fit()
        if new.trained and workspace.viewing.mode == "capture":
            workspace.viewing = replace(workspace.viewing, mode="solid")
        if new.atoms is not None and not loader.announced:
            loader.announced = True
            workspace.notify(f"{loader.request.scene.name} is solid now. Press K and drag across it to cut it.")
