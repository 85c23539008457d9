"""The faces in the document's pictures: found in the background, shown to the user, and corrected by them.

One picture at a time is open. Corrections become part of its family, so that undo, saving and training include them at
once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from app.jobs.face_finder import FaceFinder, FoundFace
from app.jobs.placement_preview import Placed, PlacementPreview, PlacementRequest
from app.model.faces.edit import BrushStroke, Outline, drag_point
from app.model.faces.words import describe_guess
from app.model.history import History
from app.model.project import Work
from app.session.workspace import Workspace
from app.translation import _, ngettext
from training.faces.marks import UNMARKED, Marks, Place
from training.families import Family, Kind

__all__ = ["FaceController", "Hint", "OpenFace"]


@dataclass(frozen=True)
class Hint:
    """A message about what was found in pictures that were just added."""

    kind: Kind
    path: Path
    text: str


class OpenFace:
    """The picture that is open, and the edits of its face."""

    def __init__(self, workspace: Workspace, kind: Kind, path: Path) -> None:
        self.workspace, self.kind, self.path = workspace, kind, path
        self.found: FoundFace | None = None
        """None while the face is being looked for."""
        self.placed: Placed | None = None
        """The latest placement."""
        self._stroke: BrushStroke | None = None

    @property
    def family(self) -> Family | None:
        """The family that has the picture, which undo may have moved to another one; None if no family has it."""
        families = self.workspace.document.families
        return next((f for f in families if f.kind == self.kind and self.path in f.exemplars), None) or next(
            (f for f in families if self.path in f.exemplars), None
        )

    @property
    def cut(self) -> Kind:
        """The kind of cut that the picture is read as; for planes chosen one by one, the kind that they resemble."""
        plane = self.placed.plane if self.placed is not None else None
        return plane.kind if self.kind == "custom" and plane is not None else self.kind

    @property
    def given(self) -> Marks:
        """The marks that the user has set on the face."""
        family = self.family
        return UNMARKED if family is None else family.marks_of(self.path)

    @property
    def known(self) -> Marks:
        """The marks known without placing the picture: as the user gave them, or else as found."""
        given = self.given
        found, beside = (UNMARKED, UNMARKED) if self.found is None else (self.found.marks, self.found.beside)
        # For a corrected outline the core is computed from the outline, as training does.
        core = given.core or beside.core or (found.core if given.outline is None else None)
        return Marks(given.outline or found.outline, core, given.line or found.line)

    @property
    def marks(self) -> Marks:
        """Outline and axis as they are used: as known, or else as found by the latest placement."""
        known, chosen = self.known, self.placed.marks if self.placed is not None else UNMARKED
        return Marks(known.outline, known.core or chosen.core, known.line or chosen.line)

    def set_kind(self, kind: Kind) -> None:
        """Moves the picture to another family."""
        document = self.workspace.document.moved_exemplar(self.path, self.kind, kind)
        if self.workspace.change(_("Kind of cut"), document):
            self.kind = kind

    def find_again(self) -> None:
        """Drops the user's marks, and goes back to the face as it was found."""
        self._set(_("Find face again"), UNMARKED)

    def drag_point(self, before: Outline, index: int, to: Place, soft: bool) -> None:
        """Moves a point of the outline. `before`: the outline when the drag began."""
        assert self.found is not None
        self._set_outline(_("Outline"), drag_point(before, index, to, self.found.aspect, soft), "face outline")

    def drag_core(self, to: Place) -> None:
        """Moves the core of a horizontal cut."""
        self._set(_("Core"), replace(self.given, core=_inside(to)), "face core")

    def drag_end(self, index: int, to: Place) -> None:
        """Moves one end of a core line."""
        line, to = self.marks.line, _inside(to)
        if line is not None and to != line[1 - index]:
            line = (to, line[1]) if index == 0 else (line[0], to)
            self._set(_("Core line"), replace(self.given, line=line), "face axis")

    def paint(self, to: Place, radius: float, add: bool) -> None:
        """Continues a stroke of the brush, or begins one. `radius`: in heights of the picture."""
        assert self.found is not None
        if self._stroke is None:
            self._stroke = BrushStroke(self.marks.outline, self.found.size, radius, add)
        self._stroke.move(to)
        outline = self._stroke.outline
        if outline is not None:
            self._set_outline(_("Add to face") if add else _("Take from face"), outline, "face brush")

    def settle(self) -> None:
        """Ends a drag or a stroke: the next one is a new step of undo."""
        self._stroke = None
        self.workspace.history.settle()

    def _set_outline(self, name: str, outline: Outline, merge: str) -> None:
        """Sets the outline. A core line that was found stays where it is shown."""
        marks = replace(self.given, outline=outline)
        if self.cut == "radial" and marks.line is None:
            marks = replace(marks, line=self.marks.line)
        self._set(name, marks, merge)

    def _set(self, name: str, marks: Marks, merge: str = "") -> None:
        self.workspace.change(name, self.workspace.document.with_marks(self.kind, self.path, marks), merge)


class FaceController:
    """Finds faces, tells the user what was found in new pictures, and opens one picture at a time."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.finder, self.placement = FaceFinder(), PlacementPreview()
        self.open_face: OpenFace | None = None
        self.hint: Hint | None = None
        """The message that the user has not yet dismissed or followed."""
        self._history: History[Work] | None = None
        self._known: frozenset[Path] = frozenset()
        """Pictures of the documents that the user has been told about, or that came with a project."""
        self._new: list[tuple[Kind, Path]] = []
        """Added pictures whose faces are still being looked for."""

    def edit(self, kind: Kind, path: Path) -> None:
        """Opens one of the active object's pictures."""
        face = OpenFace(self.workspace, kind, path)
        if face.family is None:
            return
        self.open_face = face
        if self.hint is not None and self.hint.path == path:
            self.hint = None

    def close(self) -> None:
        """Closes the open picture; corrections are kept."""
        self.open_face = None

    def dismiss_hint(self) -> None:
        """Removes the hint, which the user has read."""
        self.hint = None

    @property
    def busy(self) -> bool:
        """Whether the user is waiting for a face to be found or placed."""
        face = self.open_face
        return bool(self._new) or (face is not None and (face.found is None or self.placement.busy))

    def tick(self) -> None:
        """Takes over what was found and placed. Called once a frame."""
        self._watch()
        self._tell()
        face = self.open_face
        if face is None:
            return
        family = face.family
        if family is None:  # the picture was removed, or another document opened
            self.open_face = None
            return
        face.kind, face.found = family.kind, self.finder.get(face.path)
        known = face.known
        if face.found is None or known.outline is None:
            face.placed = None
            return
        workspace = self.workspace
        alone = sum(bool(f.exemplars) for f in workspace.document.families) == 1
        wanted = PlacementRequest(face.found.rgb, known, family, workspace.atoms, workspace.up, alone)
        face.placed = self.placement.update(wanted)

    def _watch(self) -> None:
        """Notes which pictures have been added since the last frame."""
        workspace = self.workspace
        listed = {path: f.kind for document in workspace.documents for f in document.families for path in f.exemplars}
        if workspace.history is not self._history:  # another project
            self._history, self._known, self._new, self.hint = workspace.history, frozenset(listed), [], None
        self._new = [(kind, path) for kind, path in self._new if path in listed]
        self._new += [(kind, path) for path, kind in listed.items() if path not in self._known]
        self._known |= frozenset(listed)
        if self.hint is not None and self.hint.path not in listed:
            self.hint = None

    def _tell(self) -> None:
        """Says what was found in the pictures that were added, once all of them have been looked at."""
        if not self._new:
            return
        faces = [self.finder.get(path) for _, path in self._new]
        if not all(faces):
            return
        found = [(*entry, face) for entry, face in zip(self._new, faces, strict=True) if face is not None]
        # The picture that the user should check most urgently comes first.
        kind, path, face = max(found, key=lambda entry: _doubt(entry[0], entry[2]))
        guess = "" if face.guess is None else _("it {guess}").format(guess=describe_guess(face.guess))
        text = face.verdict if face.problem else guess
        text = f"{text}; {face.note}" if face.note else text
        others = len(found) - 1
        more = ngettext("{count} more was added.", "{count} more were added.", others).format(count=others)
        self.hint, self._new = Hint(kind, path, f"{path.name}: {text}. {more if others else ''}".rstrip()), []
        self.workspace.notify(self.hint.text)

    def release(self) -> None:
        """Ends the background work."""
        self.finder.close()
        self.placement.close()


def _doubt(kind: Kind, face: FoundFace) -> int:
    """3 for a missing face, 2 for one that may be something else, 1 for one that seems to belong elsewhere, else 0."""
    if face.guess is None:
        return 3
    return 2 if face.note else int(face.guess.kind != kind and kind != "custom")


def _inside(place: Place) -> Place:
    return min(max(place[0], 0.0), 1.0), min(max(place[1], 0.0), 1.0)
