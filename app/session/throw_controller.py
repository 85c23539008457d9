"""Throw and slice: the object is thrown up and cut in flight; the project changes only if the user keeps the cuts."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from app.model.film.throw import SECONDS, Throw, in_flight, sliced, thrown
from app.model.knife import Stroke
from app.session.workspace import Workspace
from app.translation import _, ngettext
from engine.scene.camera import Camera

__all__ = ["ThrowController"]


class ThrowController:
    """Throws the active object again and again, until the user leaves the game or keeps the cuts."""

    def __init__(self, workspace: Workspace, clock: Callable[[], float] = time.monotonic) -> None:
        self.workspace, self.clock = workspace, clock
        self.throw: Throw | None = None
        """The object in the air; None if there is none."""
        self._begun = 0.0
        self._camera: Camera | None = None

    @property
    def active(self) -> bool:
        """Whether something is in the air."""
        return self.throw is not None

    @property
    def pieces(self) -> int:
        """Number of pieces in the air."""
        return len(self.throw.flights) if self.throw is not None else 0

    def begin(self, camera: Camera) -> None:
        """Throws the object up into the picture of a camera."""
        workspace = self.workspace
        if workspace.atoms is None:
            workspace.notify(_("There is no solid to throw yet."))
            return
        if workspace.viewing.mode == "capture":
            workspace.viewing = replace(workspace.viewing, mode="solid")
        workspace.selected, workspace.active_cut = frozenset(), None
        self._camera = camera
        self._start()
        workspace.notify(_("Cut it in flight. Enter keeps the cuts, Esc ends the game."))

    def _start(self) -> None:
        assert self._camera is not None
        workspace = self.workspace
        self._begun = self.clock()
        distance = workspace.viewing.eye.distance
        self.throw = thrown(workspace.document, workspace.solid, self._camera, distance, 0.0)
        self._show()

    def slice(self, camera: Camera, stroke: Stroke) -> None:
        """Cuts what is in the air along a stroke."""
        if self.throw is not None:
            workspace = self.workspace
            passed = self.clock() - self._begun
            self.throw = sliced(self.throw, workspace.solid, camera, stroke, workspace.up, passed)
            self._show()

    def keep(self) -> None:
        """Ends the game and makes the cuts of the flight in the object, as one step of undo."""
        throw, workspace = self.throw, self.workspace
        self.stop()
        if throw is not None and throw.cuts and throw.document.number == workspace.document.number:
            workspace.change(_("Throw and slice"), replace(workspace.document, cuts=throw.document.cuts))
            workspace.notify(
                ngettext("Kept: {count} piece.", "Kept: {count} pieces.", len(workspace.pieces)).format(
                    count=len(workspace.pieces)
                )
            )

    def stop(self) -> None:
        """Ends the game; the object is as it was before."""
        if self.throw is not None:
            self.throw = self.workspace.previewed = None
            self.workspace.notify("")

    def tick(self) -> None:
        """Moves the pieces on; once they have fallen, the whole object is thrown again. Called once a frame."""
        if self.throw is None:
            return
        if self.workspace.drawn_documents is self.workspace.documents or self.workspace.atoms is None:
            self.throw = None  # the object has changed
        elif self.throw.document.number != self.workspace.document.number:
            self.stop()  # another object was chosen
        elif self.clock() - self._begun > SECONDS:
            self._start()
        else:
            self._show()

    def _show(self) -> None:
        assert self.throw is not None
        workspace = self.workspace
        flying = in_flight(self.throw, self.clock() - self._begun)
        documents = tuple(flying if one is workspace.document else one for one in workspace.documents)
        workspace.previewed = workspace.documents, documents
