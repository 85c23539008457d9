"""One window's worth of work, without the window: the document and its history, what is opened, what is selected.

The window draws a session and calls its methods; tests do the same without drawing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from app.jobs.scene_loader import Object, Preparing, Request
from app.model.autosave import Autosave
from app.model.document import Cut, Document, Key, Part, Placement
from app.model.history import History
from app.model.knife import Stroke, slice_object
from app.model.pieces import Lying, Solid, pieces
from app.model.project import Project, Viewing
from app.model.question import Choice, Question
from app.model.rigid_transform import Motion, Vec3, vec3
from app.model.settings import Settings, load_settings, save_settings
from app.session.project_files import PICTURES, Files
from app.session.training_controller import Desk
from engine.errors import InputError
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.plane import Plane
from training.families import Kind

__all__ = ["TOOLS", "Session", "Tool"]

Tool = Literal["select", "knife", "plane", "move", "turn"]
TOOLS: tuple[Tool, ...] = ("select", "knife", "plane", "move", "turn")

EMPTY = Solid.of(np.zeros((0, 3)))


@dataclass
class Session:
    """Model of the window."""

    settings: Settings = field(default_factory=load_settings)
    history: History[Document] = field(default_factory=lambda: History(Document()))
    viewing: Viewing = field(default_factory=Viewing)
    object: Object | None = None
    preparing: Preparing | None = None
    path: Path | None = None
    """Of the project file."""
    tool: Tool = "select"
    selection: frozenset[Key] = frozenset()
    active_cut: int | None = None
    """The cut whose plane is shown with its handles."""
    message: str = ""
    """The status line."""
    error: str = ""
    """One line that stays until it is read."""
    question: Question | None = None
    closing: bool = False
    """The window may close now."""
    geometry: int = 0
    """Grows when other atoms or another capture are to be drawn."""
    colours: int = 0
    """Grows when the same atoms have other colours."""
    autosave: Autosave = field(default_factory=Autosave)
    folder: Path = field(default_factory=Path.home)
    """Where the user stands: dialogs begin here."""

    def __post_init__(self) -> None:
        self.desk = Desk(self)
        self.files = Files(self)
        self._pieces: tuple[Document, Solid, list[Lying]] | None = None

    # What there is

    @property
    def document(self) -> Document:
        """The current state."""
        return self.history.state

    @property
    def solid(self) -> Solid:
        """Where the object is."""
        return self.object.solid if self.object is not None and self.object.solid is not None else EMPTY

    @property
    def atoms(self) -> Atoms | None:
        """The solid object, once it is one."""
        return self.object.atoms if self.object is not None else None

    @property
    def up(self) -> Vec3:
        """The object's up axis: as chosen, or as detected."""
        if self.document.up is not None:
            return self.document.up
        return self.object.up if self.object is not None else (0.0, 0.0, 1.0)

    @property
    def mode(self) -> str:
        """What is drawn: the capture for as long as there is no solid."""
        return self.viewing.mode if self.atoms is not None else "capture"

    @property
    def pieces(self) -> list[Lying]:
        """The object's pieces, hidden ones too."""
        kept = self._pieces
        if kept is None or kept[0] is not self.document or kept[1] is not self.solid:
            kept = self._pieces = (self.document, self.solid, pieces(self.document, self.solid))
        return kept[2]

    @property
    def title(self) -> str:
        """For the window's frame."""
        name = self.path.stem if self.path else self.document.scene.stem if self.document.scene else "FruitNinja"
        return f"{name}{' *' if self.history.changed else ''}"

    # Words

    def say(self, text: str) -> None:
        """To the status line."""
        self.message = text

    def fail(self, error: Exception | str) -> None:
        """An error, in words, until it is dismissed."""
        self.error = str(error)

    def ask(self, title: str, text: str, *choices: Choice) -> None:
        """Puts a question; Cancel is added as the last choice."""
        self.question = Question(title, text, (*choices, Choice("Cancel", lambda: None)))

    def answer(self, choice: Choice) -> None:
        """What the user chose; the next question may follow from it."""
        self.question = None
        choice.act()

    # What is shown

    def show(self, document: Document, viewing: Viewing, path: Path | None) -> None:
        """Another document in the place of this one."""
        self.history = History(document)
        self.viewing, self.path = viewing, path
        self.selection, self.active_cut, self.tool = frozenset(), None, "select"
        self.object, self.error = None, ""
        self.geometry += 1
        self.desk.look_for(document)
        if document.scene is not None:
            self.prepare()

    def prepare(self, trained: bool = True) -> None:
        """Reads the scene and makes it solid, in the background; shows a finished training result if there is one."""
        if self.preparing is not None:
            self.preparing.cancel()
        scene, training = self.document.scene, self.document.training
        assert scene is not None
        result = self.desk.result_for(self.document) if trained else None
        try:
            self.preparing = Preparing(Request(scene, training.detail, training.seed, result))
        except InputError as error:  # no room for temporary files
            self.preparing = None
            self.fail(error)

    def remember(self, settings: Settings) -> None:
        """Keeps settings, on disk too."""
        if settings != self.settings:
            self.settings = settings
            save_settings(settings)

    # Editing

    def change(self, name: str, document: Document, merge: str = "") -> bool:
        """One step of work. Steps in a row with the same merge tag are one for undo."""
        done = self.history.do(name, document, merge)
        self._mend_selection()
        return done

    def undo(self) -> None:
        """One step back."""
        name = self.history.entries[self.history.cursor].name
        self.say(f"Undone: {name}." if self.history.undo() else "Nothing to undo.")
        self._mend_selection()

    def redo(self) -> None:
        """One step forward again."""
        if self.history.redo():
            self.say(f"Done again: {self.history.entries[self.history.cursor].name}.")
        else:
            self.say("Nothing to redo.")
        self._mend_selection()

    def jump(self, index: int) -> None:
        """To an entry of the history."""
        self.history.jump(index)
        self._mend_selection()

    def _mend_selection(self) -> None:
        keys = {piece.key for piece in self.pieces}
        self.selection = frozenset(key for key in self.selection if key in keys)
        if self.active_cut not in {cut.id for cut in self.document.cuts}:
            self.active_cut = None

    def take(self, tool: Tool) -> None:
        """Another tool. Tools that cut need a solid to be seen."""
        self.tool = tool
        if tool in ("knife", "plane") and self.viewing.mode == "capture":
            self.viewing = replace(self.viewing, mode="solid")

    def slice(self, camera: Camera, stroke: Stroke) -> None:
        """What the knife does when it is let go."""
        if self.atoms is None:
            waiting = self.preparing is not None and not self.preparing.ended
            self.say(
                "The object is still being made solid. Cut in a moment." if waiting else "There is no solid to cut."
            )
            return
        outcome = slice_object(self.document, self.solid, camera, stroke, self.up, self.selection)
        if outcome.document is not None:
            self.viewing = replace(self.viewing, mode="solid" if self.mode == "capture" else self.mode)
            self.change("Cut", outcome.document)
            self.active_cut = self.document.cuts[-1].id
        self.say(outcome.message)

    def add_plane(self, plane: Plane | None = None) -> None:
        """A section plane, across the up axis through the middle unless given."""
        plane = plane or Plane.through(self.solid.centre, self.up)
        if self.viewing.mode == "capture":
            self.viewing = replace(self.viewing, mode="solid")
        self.change("Add plane", self.document.with_cut((Part(plane),), "Plane", "section"))
        self.active_cut = self.document.cuts[-1].id
        self.say("Move the slider to sweep the plane through the object.")

    def change_cut(self, name: str, cut_id: int, change: Callable[[Cut], Cut], merge: str = "") -> None:
        """One cut, changed."""
        self.change(name, self.document.changed_cut(cut_id, change), merge)

    def remove_cut(self, cut_id: int) -> None:
        """What it parted is one again."""
        self.change("Remove cut", self.document.without_cut(cut_id))

    def place(self, name: str, keys: frozenset[Key], motion: Motion, merge: str = "") -> None:
        """Moves pieces by a motion of the world."""
        document = self.document
        for key in keys:
            document = document.placed(key, lambda p: replace(p, motion=motion.after(p.motion)))
        self.change(name, document, merge)

    def mark(self, name: str, keys: frozenset[Key], change: Callable[[Placement], Placement]) -> None:
        """Hides, shows or removes pieces."""
        document = self.document
        for key in keys:
            document = document.placed(key, change)
        self.change(name, document)

    def hide(self) -> None:
        """The selected pieces are not shown."""
        if not self.selection:
            self.say("Select a piece first.")
            return
        self.mark("Hide", self.selection, lambda p: replace(p, visible=False))
        self.selection = frozenset()

    def delete(self) -> None:
        """The selected pieces are gone; 'Put back together' brings them back."""
        if not self.selection:
            self.say("Select a piece first.")
        elif len(self.selection) == len(self.pieces):
            self.say("That would leave nothing. Keep at least one piece.")
        else:
            self.mark("Delete", self.selection, lambda p: replace(p, removed=True))

    def together(self) -> None:
        """All pieces back in their places."""
        self.change("Put together", self.document.together())

    # Families

    def add_pictures(self, kind: Kind | None, paths: tuple[Path, ...]) -> None:
        """Pictures of cut faces for a family; the first family there is, or a horizontal one, where none is said."""
        paths = tuple(path.absolute() for path in paths if path.suffix.lower() in PICTURES)
        if not paths:
            self.say(f"Not a picture. Use one of {', '.join(PICTURES)}.")
            return
        if kind is None:
            kind = self.document.families[0].kind if self.document.families else "horizontal"
        self.change(f"Picture for {kind}", self.document.with_exemplars(kind, paths))
        self.say(f"{paths[0].name} shows a {kind} cut. Choose another family for it with a right click.")

    # Looking

    def look(self, viewing: Viewing) -> None:
        """Another view; not part of undo."""
        self.viewing = viewing

    def fit(self, aspect: float = 1.0) -> None:
        """All shown pieces in the picture."""
        parts = [piece.motion.apply(self.solid.points[piece.rows]) for piece in self.pieces if piece.visible]
        box = Solid.of(np.concatenate(parts)) if parts and sum(len(p) for p in parts) else self.solid
        eye = self.viewing.eye.fitted(vec3(box.centre), box.radius, aspect)
        self.viewing = replace(self.viewing, eye=eye)

    # Time passes

    def tick(self) -> None:
        """Takes what the background has brought. Called once a frame."""
        if self.preparing is not None:
            self._follow_preparing(self.preparing)
        self.desk.tick()
        try:
            self.autosave.keep(Project(self.document, self.viewing), self.history.changed, self.path)
        except InputError:
            self.autosave.next = time.monotonic() + 60.0  # the disk may have room later

    def _follow_preparing(self, preparing: Preparing) -> None:
        first = self.object is None or self.object.solid is None
        if preparing.poll():
            new = preparing.object
            if self.object is not None and new.atoms is None and self.object.capture is not None:
                new = replace(self.object, request=new.request)  # the same scene again: keep showing it meanwhile
            self.object = new
            self.geometry += 1
            self.desk.recolour()
            if first and self.viewing.eye == Viewing().eye:
                self.fit()
            if new.trained and self.viewing.mode == "capture":
                self.viewing = replace(self.viewing, mode="solid")
            if new.atoms is not None and not preparing.ready:
                preparing.ready = True
                self.say(f"{preparing.request.scene.name} is solid now. Press K and drag across it to cut it.")
        if preparing.ended:
            if preparing.error:
                self.fail(preparing.error)
            self.preparing = None

    def cancel_preparing(self) -> None:
        """Stops reading; what is there stays."""
        if self.preparing is not None:
            self.preparing.cancel()
            self.preparing = None
            self.say("Stopped.")
