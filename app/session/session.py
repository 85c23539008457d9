"""One window's worth of work, without the window: the workspace and the controllers that act on it.

The window draws a session and calls its methods; tests do the same without drawing.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from app.model.knife import Stroke
from app.session.face_controller import FaceController
from app.session.film_controller import FilmController
from app.session.isolation_controller import IsolationController
from app.session.keyboard_controller import KeyboardController
from app.session.project_files import ProjectFiles
from app.session.scene_controller import SceneController
from app.session.throw_controller import ThrowController
from app.session.training_controller import TrainingController
from app.session.workspace import Workspace
from app.translation import _
from engine.errors import InputError
from engine.scene.camera import Camera

__all__ = ["Session"]

AUTOSAVE_RETRY = 60.0
"""Seconds until the next autosave after a failed one: a full disk may have space again later."""


@dataclass
class Session(Workspace):
    """The workspace with its controllers: `scene` loads, `isolation` edits which part of it is the object, `training`
    trains, `faces` finds the faces in pictures, `film` keeps and plays keyframes, `throw` is a game, `keyboard` acts
    without a pointer, `files` opens, saves and closes."""

    def __post_init__(self) -> None:
        self.scene = SceneController(self)
        self.training = TrainingController(self, self.scene)
        self.isolation = IsolationController(self)
        self.faces = FaceController(self)
        self.film = FilmController(self)
        self.throw = ThrowController(self)
        self.keyboard = KeyboardController(self)
        self.files = ProjectFiles(self, self.scene, self.training, self.film)

    @property
    def being_made(self) -> bool:
        """Whether the object is still being made solid, so that nothing can be cut yet."""
        return self.loader is not None and not self.loader.ended and not self.members and self.atoms is None

    def slice(self, camera: Camera, stroke: Stroke) -> None:
        """As in Workspace; a stroke through an object that is still being made solid cuts once it is."""
        if self.throw.active:
            self.throw.slice(camera, stroke)
            return
        if not self.being_made:
            super().slice(camera, stroke)
            return
        self.scene.strokes.append((camera, stroke))
        self.notify(_("The object is still being made solid. It will be cut there."))

    def tick(self) -> None:
        """Takes over what background work has produced, and autosaves. Called once a frame."""
        outdated = self.scene.outdated
        if outdated is not None:
            self.training.prepare_again(outdated)
        elif self.loader is None and not self.training.running and (rough := self.scene.rough) is not None:
            self.scene.refit(rough)
        if self.scene.tick():
            self.training.recolour()
        if self.scene.strokes and not self.being_made:
            strokes, self.scene.strokes = self.scene.strokes, []
            for camera, stroke in strokes:
                super().slice(camera, stroke)
        self.files.tick()
        self.isolation.tick()
        self.training.tick()
        self.faces.tick()
        self.film.tick()
        self.throw.tick()
        if self.closing:
            return  # no autosave of work that the user chose not to save
        try:
            self.autosave.update(self.project, self.history.changed, self.path)
        except InputError as error:
            self.autosave.next = time.monotonic() + AUTOSAVE_RETRY
            self.notify(str(error))
