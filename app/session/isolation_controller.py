"""Isolates the object in a session: selects parts of the capture, keeps or removes them, and proposes what to remove.

Finding the selected Gaussians may take a second in a large capture, so it happens in a thread of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from app.model.capture_view import CaptureView, view_of
from app.model.document import Document
from app.model.marking import Marker, Point, shape_of
from app.model.rigid_transform import Vec3
from app.session.workspace import Workspace
from app.translation import _
from engine.isolate.floor import find_floor
from engine.isolate.selection import (
    INVERT,
    MOST_STEPS,
    NO_SURROUNDINGS,
    Below,
    Box,
    Detected,
    Isolation,
    Selection,
    Step,
    removed,
    split_bodies,
)
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.solid.denoise_capture import haze_and_fragments

__all__ = ["How", "IsolationController", "Proposal"]

How = Literal["replace", "add", "subtract"]
"""What a new shape does to the present selection."""

REMOVED = _("Left out, not lost: undo brings it back. The rest is being made solid.")


@dataclass(frozen=True)
class Proposal:
    """A part of the capture that probably does not belong to the object."""

    name: str
    hint: str
    selection: Selection
    count: int
    """Number of Gaussians that it removes. At least 1."""


class IsolationController:
    """Edits which part of the capture is the object, and keeps the view of the capture up to date."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self.marker: Marker = "box"
        """The shape of the next drag."""
        self.how: How = "replace"
        """What the next shape does, unless a key says otherwise."""
        self.tint: Vec3 = (1.0, 0.42, 0.29)
        """RGB that tints what is selected; the window sets it to the theme's accent. Range [0, 1]."""
        self._thread = ThreadPoolExecutor(1, "isolate")
        self._view: Future[CaptureView] | None = None
        self._proposals: Future[tuple[Proposal, ...]] | None = None
        self._proposed_for: tuple[Gaussians, Isolation] | None = None
        self._bodies: Future[tuple[Selection, ...]] | None = None
        self._bodies_of: tuple[Document, Gaussians] | None = None
        self._told_apart: set[Isolation] = set()
        """Isolations that were already searched for separate bodies, so that an undone split is not made again."""
        self._asked = False
        """Whether the user has asked for separate bodies and waits for the answer."""

    @property
    def available(self) -> bool:
        """Whether there is a capture to isolate parts of: an object that was opened with its inside has none."""
        shown = self.workspace.object
        if shown is None or shown.capture is None:
            return False
        return not shown.trained or shown.request.trained is not None

    @property
    def pending(self) -> bool:
        """Whether the thread is working."""
        return any(future is not None and not future.done() for future in (self._view, self._proposals, self._bodies))

    @property
    def view(self) -> CaptureView | None:
        """The view of the document as it is now; None until it is found."""
        workspace, view = self.workspace, self.workspace.capture_view
        document, shown = workspace.document, workspace.object
        if view is None or shown is None or shown.capture is None:
            return None
        current = view.is_for(shown.capture, document.isolation, document.selection, self.tint, self._beside)
        return view if current else None

    @property
    def _beside(self) -> tuple[Isolation, ...]:
        """The isolations of the other visible objects."""
        workspace = self.workspace
        return tuple(d.isolation for d in workspace.documents if d is not workspace.document and d.visible)

    @property
    def proposals(self) -> tuple[Proposal, ...] | None:
        """What could be removed next, which the first call starts to look for; None until it is found."""
        view, workspace = self.workspace.capture_view, self.workspace
        if view is None or view.isolation != workspace.document.isolation:
            return None
        wanted = (view.capture, view.isolation)
        known = self._proposed_for
        if known is None or known[0] is not wanted[0] or known[1] != wanted[1]:
            self._proposals, self._proposed_for = self._thread.submit(find_proposals, view.left), wanted
        assert self._proposals is not None
        return self._proposals.result() if self._proposals.done() else None

    # Selecting

    @property
    def last_box(self) -> Box | None:
        """The box that was drawn last, while the isolate tool is in use; None if the last step was not a box."""
        workspace = self.workspace
        steps = workspace.document.selection
        if workspace.tool != "isolate" or workspace.mode != "capture" or not steps:
            return None
        shape = steps[-1].shape
        return shape if isinstance(shape, Box) else None

    def reshape(self, box: Box) -> None:
        """Replaces the box that was drawn last."""
        steps = self.workspace.document.selection
        changed = (*steps[:-1], replace(steps[-1], shape=box))
        self.workspace.change(_("Change the box"), replace(self.workspace.document, selection=changed), merge="box")

    def select(self, camera: Camera, path: Sequence[Point], how: How) -> None:
        """Selects what is in the shape that a drag along `path`, in pixels of the camera's picture, describes."""
        view = self.workspace.capture_view
        if view is None:
            return
        eye = self.workspace.viewing.eye
        depth = float((np.asarray(eye.target) - camera.position) @ camera.forward)
        shape = shape_of(self.marker, camera, path, view.left, max(depth, 1e-6))
        if shape is None:
            self.workspace.notify(_("Drag over the part that you mean."))
            return
        step = Step("subtract" if how == "subtract" else "add", shape)
        before = () if how == "replace" else self.workspace.document.selection
        if how == "subtract" and not before:
            self.workspace.notify(_("Nothing is selected yet that could be taken away."))
            return
        self._select(
            {"replace": _("Select"), "add": _("Select more"), "subtract": _("Select less")}[how],
            (*before, step),
        )

    def propose(self, proposal: Proposal) -> None:
        """Selects what a proposal would remove."""
        self._select(_("Select {name}").format(name=proposal.name.lower()), proposal.selection)

    def invert(self) -> None:
        """Selects exactly what is not selected."""
        self._select(_("Invert selection"), (*self.workspace.document.selection, INVERT))

    def grow(self) -> None:
        """Also selects what touches the selected parts."""
        if self.workspace.document.selection:
            self._select(_("Grow selection"), (*self.workspace.document.selection, Step("grow")))

    def clear(self) -> None:
        """Selects nothing."""
        self._select(_("Select nothing"), ())

    def _select(self, name: str, steps: Selection) -> None:
        if len(steps) > MOST_STEPS:
            self.workspace.notify(_("This selection has too many steps. Keep or remove it, or clear it."))
            return
        self.workspace.change(name, replace(self.workspace.document, selection=steps))

    # Isolating

    def keep_selected(self) -> None:
        """Removes everything but what is selected."""
        self._isolate(_("Keep only this"), (*self.workspace.document.selection, INVERT))

    def remove_selected(self) -> None:
        """Removes what is selected."""
        self._isolate(_("Remove"), self.workspace.document.selection)

    def remove_proposal(self, proposal: Proposal) -> None:
        """Removes what was proposed, regardless of what is selected."""
        document = self.workspace.document
        changed = replace(document, isolation=(*document.isolation, proposal.selection), selection=())
        self.workspace.change(_("Remove {name}").format(name=proposal.name.lower()), changed)
        self.workspace.notify(REMOVED)

    def restore(self) -> None:
        """Brings back all of the capture, as one object with the cuts and settings of the active one."""
        document = self.workspace.document
        whole = replace(document, isolation=(), selection=(), number=0, name="", visible=True)
        film = self.workspace.timeline.renumbered(document.number, (0,))
        self.workspace.change_all(_("Bring everything back"), (whole,), film=film)

    def _isolate(self, name: str, selection: Selection) -> None:
        workspace, document = self.workspace, self.workspace.document
        if self._can_isolate(document):
            workspace.change(name, replace(document, isolation=(*document.isolation, selection), selection=()))
            workspace.notify(REMOVED)

    def _can_isolate(self, document: Document) -> bool:
        """Whether some, but not all, of what is left is selected; tells the user why if not."""
        workspace, view = self.workspace, self.view
        if view is None:
            workspace.notify(_("One moment: what is selected is still being found."))
        elif not view.selected.any():
            workspace.notify(_("Nothing is selected. Drag over the part that you mean."))
        elif view.selected.all():
            workspace.notify(_("Everything is selected. Select a part of it."))
        elif len(document.isolation) >= MOST_STEPS:
            workspace.notify(_("Too much was removed step by step. Bring everything back and keep the object alone."))
        else:
            return True
        return False

    # Several objects

    def find_objects(self) -> None:
        """Makes each separate body of the active object an object of its own."""
        self._asked = True

    def split_selected(self) -> None:
        """Makes what is selected an object of its own."""
        document = self.workspace.document
        if self._can_isolate(document):
            self._split(_("Split off"), document, (document.selection, (*document.selection, INVERT)))

    def _split(self, name: str, document: Document, removed: tuple[Selection, ...]) -> None:
        """Replaces an object by several with its settings, each without one of the selections `removed`."""
        workspace = self.workspace
        others = [one for one in workspace.documents if one is not document]
        used = {one.number for one in others}
        free = [n for n in range(1, len(used) + len(removed) + 1) if n not in used]
        new = []
        for number, selection in zip(free, removed, strict=False):
            out = document.training.out
            out = None if out is None else out.with_name(f"{out.name}-{number}")
            isolation, training = (*document.isolation, selection), replace(document.training, out=out)
            new.append(replace(document, isolation=isolation, selection=(), number=number, name="", training=training))
            if document.number in workspace.loaded:  # its capture is shown until it is solid
                loaded = workspace.loaded[document.number]
                workspace.loaded[number] = replace(loaded, atoms=None, trained=False)
        index = workspace.documents.index(document)
        documents = (*workspace.documents[:index], *new, *workspace.documents[index + 1 :])
        film = workspace.timeline.renumbered(document.number, tuple(one.number for one in new))
        workspace.change_all(name, documents, film=film)

    def _tell_bodies_apart(self, document: Document) -> None:
        """Starts the search for separate bodies in what is left, and makes them objects; only once for each isolation,
        and not for a project that was just opened."""
        workspace, view = self.workspace, self.view
        if self._bodies is not None:
            if self._bodies.done():
                selections, self._bodies = self._bodies.result(), None
                self._make_objects(selections)
            return
        opened = workspace.path is not None and workspace.history.cursor == 0
        if view is None or not self.available or (opened and not self._asked):
            return
        if self._bodies_of is None or self._bodies_of[1] is not view.capture:
            self._told_apart.clear()  # another scene
        if self._asked or document.isolation not in self._told_apart:
            self._told_apart.add(document.isolation)
            self._bodies_of = document, view.capture
            self._bodies = self._thread.submit(split_bodies, view.left)

    def _make_objects(self, selections: tuple[Selection, ...]) -> None:
        """Makes objects of the bodies that were found, if the object that they were found in is still the same."""
        workspace = self.workspace
        assert self._bodies_of is not None
        asked, capture = self._bodies_of
        shown = workspace.loaded.get(asked.number)
        same = [d for d in workspace.documents if d.number == asked.number and d.isolation == asked.isolation]
        asked_for, self._asked = self._asked, False
        if len(selections) < 2 or not same or shown is None or shown.capture is not capture:
            if asked_for:
                workspace.notify(_("This is one object: no part of it stands apart and has an inside of its own."))
            return
        untouched = not workspace.history.changed
        self._split(_("{count} objects").format(count=len(selections)), same[0], selections)
        if untouched and len(workspace.history.entries) == 2:  # just opened: no work of the user would be lost
            workspace.history.saved = workspace.history.state
        workspace.notify(
            _("There are {count} separate objects. Select one in the list to cut it alone.").format(
                count=len(selections)
            )
        )

    # Following the document

    def tick(self) -> None:
        """Takes over a view that was found, and starts to find the next one. Called once a frame."""
        workspace, shown = self.workspace, self.workspace.object
        if self._view is not None:
            if not self._view.done():
                return
            workspace.capture_view, self._view = self._view.result(), None
        if shown is None or shown.capture is None:
            workspace.capture_view = None
            return
        document, beside = workspace.document, self._beside
        isolation = document.isolation if self.available else ()
        selected = document.selection if self.available else ()
        before = workspace.capture_view
        if before is None or not before.is_for(shown.capture, isolation, selected, self.tint, beside):
            self._view = self._thread.submit(view_of, shown.capture, isolation, selected, self.tint, before, beside)
        self._tell_bodies_apart(document)


def find_proposals(capture: Gaussians) -> tuple[Proposal, ...]:
    """The parts of a capture that probably do not belong to the object: surroundings, floor, small pieces, haze."""
    result = []
    around = removed(capture, (NO_SURROUNDINGS,))
    if around.any():
        hint = _("The room or view around the object")
        result.append(Proposal(_("Surroundings"), hint, NO_SURROUNDINGS, int(around.sum())))
    floor = find_floor(capture[~around])
    if floor is not None:
        steps = (Step("add", Below(floor)),)
        count = int(Below(floor).contains(capture.means).sum())
        result.append(Proposal(_("Floor"), _("The surface that it stands on, and what lies under it"), steps, count))
    haze, fragments = haze_and_fragments(capture)
    for name, found, rows, hint in (
        (_("Small pieces"), Detected("fragments"), fragments, _("Specks that float apart from the object")),
        (_("Haze"), Detected("haze"), haze, _("Large faint veils that belong to no surface")),
    ):
        if rows.any() and not rows.all():
            result.append(Proposal(name, hint, (Step("add", found),), int(rows.sum())))
    return tuple(result)
