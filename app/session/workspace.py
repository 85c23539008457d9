"""What the controllers of a session share: its state, every edit of the document, and messages to the user.

Nothing here opens a file or starts a process; the controllers do that and store the results here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from app.jobs.scene_loader import LoadedObject, SceneLoader
from app.model.autosave import Autosave
from app.model.capture_view import CaptureView
from app.model.document import Cut, Document, Key, Part, Placement
from app.model.film.timeline import Timeline
from app.model.history import History
from app.model.knife import Outcome, Stroke, slice_object
from app.model.pieces import Member, PlacedPiece, PointSample, pieces, sections, shown_points
from app.model.project import Project, Viewing, Work
from app.model.rigid_transform import Motion, Vec3, vec3
from app.model.upright import face_normal, turn_between
from app.session.messages import Messages
from app.translation import _, ngettext
from engine.io.picture_file import PICTURE_SUFFIXES
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.families import Kind

__all__ = ["TOOLS", "Documents", "Tool", "Workspace"]

Tool = Literal["select", "knife", "blade", "plane", "move", "turn", "upright", "isolate"]
TOOLS: tuple[Tool, ...] = get_args(Tool)

EMPTY = PointSample.of(np.zeros((0, 3)))

Documents = tuple[Document, ...]
"""The documents of a scene's objects, at least one. Their numbers differ."""


@dataclass
class Workspace(Messages):
    """The objects' documents and their history, how they are viewed, what is selected, and messages to the user."""

    history: History[Work] = field(default_factory=lambda: History(Work((Document(),))))
    viewing: Viewing = field(default_factory=Viewing)
    active: int = 0
    """Index of the object that the panels show and that is edited."""
    object_selected: bool = False
    """Whether the user has selected the active one of several objects, so that the knife cuts only this one."""
    loaded: dict[int, LoadedObject] = field(default_factory=dict)
    """What is loaded of each object so far, by its number."""
    capture_view: CaptureView | None = None
    """The shown part of the capture; it is found in the background and may belong to an earlier document."""
    loader: SceneLoader | None = None
    """Reads the scene in the background; None when it is done."""
    path: Path | None = None
    """The project file; None until the project is saved."""
    tool: Tool = "select"
    selected: frozenset[Key] = frozenset()
    active_cut: int | None = None
    """Id of the cut whose plane is shown with its handles."""
    previewed: tuple[Documents, Documents] | None = None
    """The documents, and others to draw in their place, as in a film or a throw, until the documents change."""
    closing: bool = False
    """Whether the window may close now."""
    geometry_version: int = 0
    """Grows when there are new atoms or a new capture to draw."""
    colour_version: int = 0
    """Grows when the same atoms get new colours."""
    autosave: Autosave = field(default_factory=Autosave)
    folder: Path = field(default_factory=Path.home)
    """The user's current folder, where dialogs begin."""
    _pieces: dict[tuple[int, bool], tuple[Document, PointSample, list[PlacedPiece]]] = field(
        default_factory=dict, repr=False
    )
    """Document, solid and the pieces found for them, by the object's number and whether the document is real."""

    # Derived state

    @property
    def documents(self) -> Documents:
        """The documents at the history's cursor."""
        return self.history.state.documents

    @property
    def timeline(self) -> Timeline:
        """The film at the history's cursor."""
        return self.history.state.film

    @property
    def project(self) -> Project:
        """Everything that a project file holds."""
        return Project(self.documents, self.viewing, self.timeline)

    @property
    def previewing(self) -> bool:
        """Whether something other than the documents is drawn: a film, or a thrown object."""
        return self.drawn_documents is not self.documents

    @property
    def drawn_documents(self) -> Documents:
        """The documents as they are drawn: the previewed ones while there is a preview."""
        preview = self.previewed
        return preview[1] if preview is not None and preview[0] is self.documents else self.documents

    @property
    def document(self) -> Document:
        """The document of the active object."""
        return self.documents[self.active]

    @property
    def object(self) -> LoadedObject | None:
        """What is loaded of the active object so far."""
        return self.loaded.get(self.document.number)

    @object.setter
    def object(self, loaded: LoadedObject | None) -> None:
        if loaded is None:
            self.loaded.pop(self.document.number, None)
        else:
            self.loaded[self.document.number] = loaded

    @property
    def solid(self) -> PointSample:
        """The points of the active object, none before it is loaded."""
        return self.solid_of(self.document)

    def solid_of(self, document: Document) -> PointSample:
        """The points of an object, none before it is loaded."""
        loaded = self.loaded.get(document.number)
        return loaded.solid if loaded is not None and loaded.solid is not None else EMPTY

    @property
    def solids(self) -> dict[int, Atoms]:
        """The atoms of the objects that are solid, by the objects' numbers, in the order of the documents."""
        loaded = {document.number: self.loaded.get(document.number) for document in self.documents}
        return {number: one.atoms for number, one in loaded.items() if one is not None and one.atoms is not None}

    @property
    def atoms(self) -> Atoms | None:
        """The atoms of the object; None until it is solid."""
        return self.object.atoms if self.object is not None else None

    @property
    def shown_capture(self) -> Gaussians | None:
        """The capture to draw, without what does not belong to the object, or the sample that stands in for it; None
        while neither is known."""
        capture = self.object.capture if self.object is not None else None
        if self.object is not None and capture is None:
            return self.object.coarse
        if self.capture_view is not None and self.capture_view.capture is capture:
            return self.capture_view.shown
        return None if self.document.isolation else capture

    @property
    def up(self) -> Vec3:
        """The active object's up axis: as chosen, or as detected."""
        return self.up_of(self.document)

    @property
    def view_up(self) -> Vec3:
        """The up axis of the view: that of the first object."""
        return self.up_of(self.documents[0])

    def up_of(self, document: Document) -> Vec3:
        """An object's up axis: as chosen, or as detected."""
        if document.up is not None:
            return document.up
        loaded = self.loaded.get(document.number)
        return loaded.up if loaded is not None else (0.0, 0.0, 1.0)

    @property
    def mode(self) -> str:
        """What is drawn: the mode of the view, but the capture until the object is solid, and the solid in a film."""
        shown = self.viewing.mode if self.drawn_documents is self.documents else "solid"
        return shown if self.atoms is not None else "capture"

    @property
    def pieces(self) -> list[PlacedPiece]:
        """The active object's pieces, including hidden ones."""
        return self.pieces_of(self.document)

    def pieces_of(self, document: Document) -> list[PlacedPiece]:
        """An object's pieces, including hidden ones."""
        slot = document.number, any(document is one for one in self.documents)
        cached, solid = self._pieces.get(slot), self.solid_of(document)
        if cached is None or cached[0] is not document or cached[1] is not solid:
            cached = self._pieces[slot] = (document, solid, pieces(document, solid))
        return cached[2]

    @property
    def members(self) -> list[Member]:
        """The visible pieces of all visible objects that are solid, in the order in which they are drawn."""
        solids = self.solids
        return [
            Member(index, piece)
            for index, document in enumerate(self.drawn_documents)
            if document.visible and document.number in solids
            for piece in self.pieces_of(document)
            if piece.visible
        ]

    def is_cut(self, member: Member) -> bool:
        """Whether a knife stroke that crosses this piece cuts it: only if it is selected, or if nothing is."""
        if member.index != self.active:
            return not self.object_selected
        return not self.selected or member.piece.key in self.selected

    def drawn(self, members: Sequence[Member]) -> list[Piece]:
        """The renderer's pieces for members, one for each cell, without what their objects' sections hide."""
        order = {number: k for k, number in enumerate(self.solids)}
        documents = self.drawn_documents
        return [
            replace(piece, solid=order[documents[m.index].number])
            for m in members
            for piece in m.piece.drawn(sections(documents[m.index]))
        ]

    @property
    def title(self) -> str:
        """The window's title: the project's or the scene's name, with a star while there are unsaved changes."""
        name = self.path.stem if self.path else self.document.scene.stem if self.document.scene else "FruitNinja"
        return f"{name}{' *' if self.history.changed else ''}"

    # Editing

    def change(self, name: str, document: Document, merge: str = "") -> bool:
        """Changes the active object; consecutive steps with the same `merge` tag are undone as one."""
        return self.change_object(name, self.active, document, merge)

    def change_object(self, name: str, index: int, document: Document, merge: str = "") -> bool:
        """Changes one of the objects."""
        documents = (*self.documents[:index], document, *self.documents[index + 1 :])
        return self.change_all(name, documents, merge)

    def change_all(self, name: str, documents: Documents, merge: str = "", film: Timeline | None = None) -> bool:
        """Adds a step to the history; consecutive steps with the same `merge` tag are undone as one."""
        before, up = self.documents, self.view_up
        done = self.history.do(name, Work(documents, self.timeline if film is None else film), merge)
        self._follow(before, up)
        return done

    def change_film(self, name: str, film: Timeline, merge: str = "") -> bool:
        """Changes the film as `change_all` changes the documents."""
        return self.history.do(name, replace(self.history.state, film=film), merge)

    def undo(self) -> None:
        """One step back."""
        name = self.history.entries[self.history.cursor].name
        done = self.jump(self.history.cursor - 1)
        self.notify(_("Undone: {name}.").format(name=name) if done else _("Nothing to undo."))

    def redo(self) -> None:
        """One step forward again."""
        if self.jump(self.history.cursor + 1):
            self.notify(_("Done again: {name}.").format(name=self.history.entries[self.history.cursor].name))
        else:
            self.notify(_("Nothing to redo."))

    def jump(self, index: int) -> bool:
        """Goes to an entry of the history, by its index; False if there is none."""
        before, up = self.documents, self.view_up
        done = self.history.jump(index)
        if done and len(before) == len(self.documents):  # show what has changed
            changed = [k for k, pair in enumerate(zip(before, self.documents, strict=True)) if pair[0] != pair[1]]
            if changed and self.active not in changed:
                self.activate(changed[0], self.object_selected)
        self._follow(before, up)
        return done

    def _follow(self, before: Documents, up: Vec3) -> None:
        """Brings all that is not in the history into line with the documents."""
        if len(before) != len(self.documents):
            self.activate(0, False)
        self._prune_selected()
        self._follow_up(up)

    def activate(self, index: int, selected: bool = True) -> None:
        """Makes an object the active one. `selected`: new value of `object_selected`."""
        self.object_selected = selected
        if index != self.active:
            self.active, self.selected, self.active_cut = index, frozenset(), None

    def _prune_selected(self) -> None:
        """Drops pieces and cuts that the document no longer has."""
        keys = {piece.key for piece in self.pieces}
        self.selected = frozenset(key for key in self.selected if key in keys)
        if self.active_cut not in {cut.id for cut in self.document.cuts}:
            self.active_cut = None

    def select_tool(self, tool: Tool) -> None:
        """Changes the tool, and shows what it works on: the solid for cutting, the capture for isolating."""
        self.tool = tool
        if tool == "isolate":
            self.viewing = replace(self.viewing, mode="capture")
        if tool in ("knife", "blade", "plane") and self.viewing.mode == "capture":
            self.viewing = replace(self.viewing, mode="solid")

    def slice(self, camera: Camera, stroke: Stroke) -> None:
        """Cuts the pieces that a knife stroke crosses, of the selected object or, if none is selected, of all. Tells
        the user if nothing was cut."""
        met = dict.fromkeys(member.index for member in self.members)
        alone = len(self.documents) == 1 or self.object_selected
        targets = [index for index in met if index == self.active or not alone]
        if not targets:
            hidden = self.atoms is not None
            self.notify(_("It is hidden. Show it to cut it.") if hidden else _("There is no solid to cut."))
            return
        outcomes: dict[int, Outcome] = {}
        for index in targets:
            document, selected = self.documents[index], self.selected if index == self.active else frozenset[Key]()
            up, solid = self.up_of(document), self.solid_of(document)
            outcomes[index] = slice_object(document, solid, camera, stroke, up, selected)
        cut = {index: outcome.document for index, outcome in outcomes.items() if outcome.document is not None}
        if cut:
            self.viewing = replace(self.viewing, mode="solid" if self.mode == "capture" else self.mode)
            self.change_all(_("Cut"), tuple(cut.get(k, document) for k, document in enumerate(self.documents)))
            self.activate(self.active if self.active in cut else min(cut), self.object_selected)
            self.active_cut = self.document.cuts[-1].id
        first = next(iter(cut), targets[0])
        several = ngettext("Cut {count} object.", "Cut {count} objects.", len(cut))
        self.notify(outcomes[first].message if len(cut) < 2 else several.format(count=len(cut)))

    def add_plane(self, plane: Plane | None = None) -> None:
        """Adds a section plane; by default the one across the up axis through the centre."""
        plane = plane or Plane.through(self.solid.centre, self.up)
        if self.viewing.mode == "capture":
            self.viewing = replace(self.viewing, mode="solid")
        self.change(_("Add plane"), self.document.with_cut((Part(plane),), _("Plane"), "section"))
        self.active_cut = self.document.cuts[-1].id
        self.notify(_("Move the slider to sweep the plane through the object."))

    def change_cut(self, name: str, cut_id: int, change: Callable[[Cut], Cut], merge: str = "") -> None:
        """Changes one cut."""
        self.change(name, self.document.changed_cut(cut_id, change), merge)

    def remove_cut(self, cut_id: int) -> None:
        """Removes a cut; the pieces on its two sides become one again."""
        self.change(_("Remove cut"), self.document.without_cut(cut_id))

    def place(self, name: str, keys: frozenset[Key], motion: Motion, merge: str = "") -> None:
        """Moves pieces by a motion in world space."""
        document = self.document
        for key in keys:
            document = document.placed(key, lambda p: replace(p, motion=motion.after(p.motion)))
        self.change(name, document, merge)

    def change_placements(self, name: str, keys: frozenset[Key], change: Callable[[Placement], Placement]) -> None:
        """Hides, shows or removes pieces."""
        document = self.document
        for key in keys:
            document = document.placed(key, change)
        self.change(name, document)

    def hide(self) -> None:
        """Hides the selected pieces, or the selected object."""
        if not self.selected:
            if self.object_selected:
                self.change_object(_("Hide object"), self.active, replace(self.document, visible=False))
            else:
                self.notify(_("Select a piece first."))
            return
        self.change_placements(_("Hide"), self.selected, lambda p: replace(p, visible=False))
        self.selected = frozenset()

    def delete(self) -> None:
        """Removes the selected pieces; 'Put back together' brings them back."""
        if not self.selected:
            self.notify(_("Select a piece first."))
        elif len(self.selected) == len(self.pieces):
            self.notify(_("That would leave nothing. Keep at least one piece."))
        else:
            self.change_placements(_("Delete"), self.selected, lambda p: replace(p, removed=True))

    def reassemble(self) -> None:
        """Moves all pieces back to their places."""
        self.change(_("Put together"), self.document.reassembled())

    # The up axis

    def turn_object(self, turn: NDArray[np.float64]) -> None:
        """Turns the object by a rotation (3, 3) about its centre, as its handles do: its up axis changes, and the view
        follows."""
        up = turn.T @ np.asarray(self.up)
        eye = self.viewing.eye.turned_with(turn, self.solid.centre, self.up)
        turned = replace(self.document, up=vec3(up / np.linalg.norm(up)))
        if self.change(_("Turn upright"), turned, merge="handles") and not self.active:
            self.viewing = replace(self.viewing, eye=eye)  # exactly as turned, including about the up axis

    def set_up(self, name: str, up: ArrayLike) -> None:
        """Makes an axis (3,), of any length but 0, the up axis."""
        axis = np.asarray(up, np.float64)
        self.change(name, replace(self.document, up=vec3(axis / np.linalg.norm(axis))))

    def _follow_up(self, before: Vec3) -> None:
        """If the view's up axis has changed, moves the camera so that the object seems to turn the short way."""
        if self.view_up != before:
            turn = turn_between(np.asarray(self.view_up), np.asarray(before))
            eye = self.viewing.eye.turned_with(turn, self.solid_of(self.documents[0]).centre, before)
            self.viewing = replace(self.viewing, eye=eye)

    def stand_on(self, point: NDArray[np.float64], eye: NDArray[np.float64]) -> None:
        """Stands the object on its face at a point (3,) seen from `eye` (3,), both in object space."""
        shown = self.object
        if shown is None or shown.capture is None:
            return
        skin = shown.atoms.surface.means if shown.atoms is not None else shown.capture.means
        normal = face_normal(skin, point, eye, self.solid.radius)
        if normal is None:
            self.notify(_("There is no face here to stand on."))
            return
        self.set_up(_("Stand on face"), -normal)
        self.notify(_("It stands on this face now. Drag the rings to turn it further."))

    # Families

    def add_pictures(self, kind: Kind | None, paths: tuple[Path, ...]) -> None:
        """Adds pictures of cut faces to a family; for None to the first family, or to a new horizontal one."""
        paths = tuple(path.absolute() for path in paths if path.suffix.lower() in PICTURE_SUFFIXES)
        if not paths:
            self.notify(_("Not a picture. Use one of {kinds}.").format(kinds=", ".join(PICTURE_SUFFIXES)))
            return
        if kind is None:
            kind = self.document.families[0].kind if self.document.families else "horizontal"
        self.change(_("Picture for {kind}").format(kind=kind), self.document.with_exemplars(kind, paths))
        self.notify(_("Looking for the cut face in {name}.").format(name=paths[0].name))

    # Viewing

    def fit(self, aspect: float = 1.0) -> None:
        """Fits what is shown of all visible objects into a picture of this aspect (width / height)."""
        seen = [document for document in self.documents if document.visible]
        parts = [
            shown_points(piece, self.solid_of(document), sections(document))
            for document in seen
            for piece in self.pieces_of(document)
            if piece.visible
        ]
        if self.mode == "capture":
            parts = [loaded.extent for d in seen if (loaded := self.loaded.get(d.number)) is not None]
        box = PointSample.of(np.concatenate(parts)) if sum(len(part) for part in parts) else self.solid
        self.viewing = replace(self.viewing, eye=self.viewing.eye.fitted(vec3(box.centre), box.radius, aspect))
