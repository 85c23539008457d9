"""The film of a session: its keyframes, where the playhead is, and what the viewport shows of it.

While the film is shown, the documents are drawn as in the film (`Workspace.previewed`), but not changed; the camera is
the window's own, so that the user can look around from any keyframe and keep the new view as another one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from app.jobs.film.film_job import FilmJob, FilmRequest, too_large
from app.model.film.record import LONGEST, MOST_KEYFRAMES, MOST_PLANES
from app.model.film.timeline import APART, Played, SceneKeyframe, Timeline, exploding, played, sweeping, turning
from app.model.rigid_transform import Vec3
from app.session.workspace import Workspace
from app.translation import _, ngettext
from engine.errors import InputError
from engine.scene.plane import Plane

__all__ = ["PRESETS", "FilmController"]

STEP = 2.0
"""Seconds between the last keyframe and one added after it: slow enough for the eye to follow any change."""

SECONDS = 6.0
"""Length of a film that is made at a click, the same as on the command line."""

PRESETS = {"turntable": _("Turntable"), "sweep": _("Plane sweep"), "explode": _("Explosion")}
"""Names of the steps that make a film."""


class FilmController:
    """Edits the film, each edit a step of undo, and plays it."""

    def __init__(self, workspace: Workspace, clock: Callable[[], float] = time.monotonic) -> None:
        self.workspace, self.clock = workspace, clock
        self.time = 0.0
        """Position of the playhead, seconds."""
        self.playing = False
        self._selected: tuple[Timeline, int | None] = workspace.timeline, None
        self.job: FilmJob | None = None
        """The film that is being saved, in the background."""
        self._history = workspace.history
        """The history that the film is from: another history means another project."""
        self._last = 0.0
        """When the film was last advanced."""
        self._for: tuple[object, ...] = ()
        """What `_played` was made for: the film, the documents, and the ids of their solids."""
        self._documents: object = None
        """The documents as the film shows them."""
        self._played: Played | None = None
        self._closed = False

    @property
    def selected(self) -> int | None:
        """Index of the keyframe that is selected; None in another film than it was selected in, as after an undo."""
        film, index = self._selected
        return index if film is self.workspace.timeline else None

    @selected.setter
    def selected(self, index: int | None) -> None:
        self._selected = self.workspace.timeline, index

    @property
    def available(self) -> bool:
        """Whether there is a solid to film."""
        return self.workspace.atoms is not None

    @property
    def ready(self) -> bool:
        """Whether there is a film: a solid and at least two keyframes."""
        return self.available and len(self.workspace.timeline.keyframes) > 1

    @property
    def shown(self) -> bool:
        """Whether the viewport shows the film and not the object as it is."""
        return self.workspace.drawn_documents is self._documents

    @property
    def busy(self) -> bool:
        """Whether a film is being saved."""
        return self.job is not None

    def save(self, out: Path, ground: Vec3 | None) -> None:
        """Saves the film in the background. `ground`: RGB behind the object, range [0, 1]; None: transparent."""
        workspace, look = self.workspace, self.workspace.viewing.film
        wrong = too_large(out, look, workspace.timeline.seconds)
        if wrong:
            workspace.show_error(wrong)
            return
        loaded = {number: workspace.loaded[number] for number in workspace.solids}
        light, up = workspace.settings.face_light, workspace.view_up
        try:
            self.job = FilmJob(FilmRequest(out, workspace.project, look, ground, up, light, loaded))
        except InputError as error:
            workspace.show_error(error)

    def cancel(self) -> None:
        """Stops saving."""
        if self.job is not None:
            self.job.cancel()

    def _follow_job(self) -> None:
        job = self.job
        if job is None or not job.ended:
            return
        self.job = None
        if job.error:
            self.workspace.show_error(job.error)
        else:
            self.workspace.notify(
                _("Stopped.")
                if job.cancelled
                else ngettext("Saved {name}, {count} frame.", "Saved {name}, {count} frames.", job.frames).format(
                    name=job.out.name, count=job.frames
                )
            )

    # Edits

    def add(self) -> None:
        """Keeps what is shown as a keyframe: at the playhead or, if one is there, some seconds after the last."""
        film = self.workspace.timeline
        if self._has_too_much(film):
            return
        if not film.keyframes:
            self.time = 0.0
        elif film.at(self.time) is not None:
            self.time = film.seconds + STEP
        new = film.with_keyframe(self._now(self.time))
        self._change(_("Add keyframe"), new)
        self.selected = new.at(self.time)
        count = len(new.keyframes)
        self.workspace.notify(
            _("Kept. Change the view or the planes, then add the next keyframe.")
            if count == 1
            else ngettext("{count} keyframe.", "{count} keyframes.", count).format(count=count)
        )

    def _has_too_much(self, film: Timeline) -> bool:
        """Whether what is shown is more than a project can keep as a keyframe after those of a film; tells the user."""
        planes = max(len(opened.planes) for opened in self._now(0.0).objects)
        wrong = ""
        if planes > MOST_PLANES:
            wrong = _("A keyframe can have {count} open sections of an object. Switch some off.").format(
                count=MOST_PLANES
            )
        elif len(film.keyframes) >= MOST_KEYFRAMES or film.seconds > LONGEST - STEP:
            wrong = _("The film is as long as it can be.")
        if wrong:
            self.workspace.notify(wrong)
        return bool(wrong)

    def update(self) -> None:
        """Replaces the selected keyframe with what is shown."""
        film, index = self.workspace.timeline, self.selected
        if index is not None and not self._has_too_much(Timeline()):
            self._change(_("Change keyframe"), film.with_keyframe(self._now(film.keyframes[index].time)))

    def remove(self) -> None:
        """Removes the selected keyframe."""
        index = self.selected
        if index is not None:
            self._change(_("Remove keyframe"), self.workspace.timeline.without(index))
            self.selected = None

    def clear(self) -> None:
        """Removes all keyframes."""
        self.leave()
        self._change(_("Remove the film"), Timeline())
        self.time, self.selected = 0.0, None

    def move(self, index: int, to: float) -> None:
        """Moves a keyframe to another time; one drag is one step of undo."""
        self._change(_("Move keyframe"), self.workspace.timeline.moved(index, to), merge=f"keyframe {index}")

    def preset(self, name: str) -> None:
        """Replaces the film with one made from what is shown: 'turntable', 'sweep' or 'explode'."""
        workspace, now = self.workspace, self._now(0.0)
        if name == "turntable":
            made = turning(now, SECONDS)
        elif name == "explode":
            made = exploding(now, SECONDS)
        else:
            cut_id, plane = self._swept()
            made = sweeping(now, SECONDS, workspace.document.number, cut_id, plane, workspace.solid)
        self._change(PRESETS[name], made)
        self.selected = None
        self.seek(0.0)
        self.play()

    def _swept(self) -> tuple[int, Plane]:
        """The cut id and plane that a sweep moves: those of the active cut or of the last one, or a new level plane.
        The removed side faces the eye."""
        workspace = self.workspace
        cuts = [cut for cut in workspace.document.cuts if not cut.curved]
        chosen = next((cut for cut in cuts if cut.id == workspace.active_cut), cuts[-1] if cuts else None)
        plane = Plane.of(workspace.up, 0.0) if chosen is None else chosen.plane(chosen.parts[0])
        if np.asarray(plane.normal) @ workspace.viewing.eye.camera(16, 16, workspace.view_up).forward > 0:
            plane = plane.flipped()
        is_section = chosen is not None and chosen.kind == "section"
        return chosen.id if chosen is not None and is_section else workspace.document.next_id, plane

    def _now(self, at: float) -> SceneKeyframe:
        """What the viewport shows, as a keyframe."""
        return SceneKeyframe.of(at, self.workspace.viewing.eye, self.workspace.drawn_documents)

    def _change(self, name: str, film: Timeline, merge: str = "") -> None:
        selected = self.selected
        self.workspace.change_film(name, film, merge)
        self.selected = selected

    # Showing it

    def seek(self, to: float) -> None:
        """Shows the film at a time."""
        self.time = max(0.0, to)
        motion = self._motion()
        if motion is None:
            return
        workspace = self.workspace
        eye, documents = motion(self.time)
        workspace.viewing = replace(workspace.viewing, eye=eye)
        workspace.previewed, self._documents = (workspace.documents, documents), documents

    def step(self, way: int) -> None:
        """Shows the next keyframe, or the previous one if `way` is -1."""
        times = [one.time for one in self.workspace.timeline.keyframes]
        later = [t for t in times if (t - self.time) * way > APART / 2]
        if later:
            self.playing = False
            self.seek(min(later) if way > 0 else max(later))
            self.selected = self.workspace.timeline.at(self.time)

    def play(self) -> None:
        """Plays the film, from its beginning if it is at its end."""
        if not self.ready:
            self.workspace.notify(_("A film needs two keyframes: add one, change the view, add another."))
            return
        if self.time >= self.workspace.timeline.seconds - 1e-6:
            self.time = 0.0
        self.playing, self._last = True, self.clock()
        self.selected = None
        self.seek(self.time)

    def toggle(self) -> None:
        """Plays or pauses."""
        if self.playing:
            self.playing = False
        else:
            self.play()

    def leave(self) -> None:
        """Shows the object as it is again; the camera stays."""
        self.playing = False
        shown = self.workspace.previewed
        if shown is not None and shown[1] is self._documents:
            self.workspace.previewed = None
        self._documents = None

    def tick(self) -> None:
        """Continues playing, and leaves the film if the object has changed. Called once a frame."""
        workspace = self.workspace
        self._follow_job()
        if workspace.history is not self._history:
            self._history, self.time, self.selected = workspace.history, 0.0, None
            self.leave()
        elif self._documents is not None and (not self.shown or not self.available or not workspace.timeline.keyframes):
            self.leave()
        elif self.playing:
            now = self.clock()
            to, end = self.time + now - self._last, workspace.timeline.seconds
            self._last = now
            if to >= end and not (self._closed and end > 0):
                self.playing, to = False, end
            self.seek(to % end if to > end else to)
        elif self.shown and self._for[0] is not workspace.timeline:  # one of its keyframes has changed
            self.seek(self.time)

    def _motion(self) -> Played | None:
        """The motion of the film; None if there is none."""
        workspace = self.workspace
        if not self.available or not workspace.timeline.keyframes:
            return None
        solids = {document.number: workspace.solid_of(document) for document in workspace.documents}
        made_for = (workspace.timeline, workspace.documents, *map(id, solids.values()))
        if len(self._for) != len(made_for) or any(a is not b for a, b in zip(self._for[:2], made_for[:2], strict=True)):
            self._played = None
        if self._played is None or self._for[2:] != made_for[2:]:
            self._played, self._closed = played(workspace.timeline, workspace.documents, solids)
            self._for = made_for
        return self._played
