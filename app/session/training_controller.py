"""Training in a session: starts jobs, follows them, and shows the colours that they have reached."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from app.jobs.live_colours import LiveColours
from app.jobs.results import find_result, result_folder
from app.jobs.training_job import Job
from app.model.document import Document
from app.session.scene_controller import SceneController
from app.session.workspace import Workspace
from app.translation import _
from engine.errors import InputError

__all__ = ["TrainingController"]

EVENTS_EVERY = 0.25
"""Seconds between two reads of a running job's events: often enough for a bar that moves."""

COLOURS_EVERY = 1.0
"""Seconds between two checks for newer colours: the trainer rarely writes checkpoints, and loading one takes time."""


@dataclass
class Followed:
    """A job that is followed, and its state when it was last looked at."""

    job: Job
    colours: LiveColours
    phase: str


class TrainingController:
    """Follows the jobs that train the session's objects, at most one for each."""

    def __init__(self, workspace: Workspace, scene: SceneController) -> None:
        self.workspace, self.scene = workspace, scene
        self.program: tuple[str, ...] = ()
        """A command that runs in place of the trainer and writes the same events; for tests."""
        self._followed: dict[int, Followed] = {}
        """The followed jobs by their objects' numbers."""
        self._next_events = 0.0
        self._next_colours = 0.0

    @property
    def job(self) -> Job | None:
        """The job that trains the active object, running or ended."""
        followed = self._followed.get(self.workspace.document.number)
        return None if followed is None else followed.job

    @property
    def jobs(self) -> list[Job]:
        """The jobs of all objects."""
        return [followed.job for followed in self._followed.values()]

    @property
    def running(self) -> bool:
        """Whether a process trains any of the objects."""
        return any(not job.ended for job in self.jobs)

    def forget(self) -> None:
        """Stops following all jobs, since another scene follows."""
        self._followed.clear()

    def result_for(self, document: Document) -> Path | None:
        """The finished result for the part of the scene that the document keeps; None while there is none."""
        return None if document.number in self._followed else find_result(document)

    def prepare_again(self, document: Document) -> None:
        """Makes an object solid again after its isolation has changed."""
        workspace, shown = self.workspace, self.workspace.loaded.get(document.number)
        result = self.result_for(document)
        if shown is not None and shown.trained and result is None:
            workspace.notify(
                _("The inside belonged to another part of the capture. Give this one an inside of its own.")
            )
        self.scene.load(result, document)

    def find_job(self, document: Document) -> None:
        """Follows the job of a document that was just opened, if one is running or was interrupted."""
        out = result_folder(document)
        job = None if out is None else Job.find(out)
        if job is None or job.scene != document.scene:
            return
        while job.poll() and not job.ended:
            pass
        job.poll()
        if job.phase != "done":
            self._follow(job, document.number)
            if not job.ended:
                self.workspace.notify(_("Training went on while the window was closed."))

    @property
    def busy(self) -> bool:
        """Whether the active object's job is running, paused or about to stop."""
        return self.job is not None and self.job.phase in ("running", "paused", "stopping")

    @property
    def can_pause(self) -> bool:
        """Whether the active object's job is running or paused, and was not told to stop."""
        return self.job is not None and self.job.phase in ("running", "paused")

    def start(self) -> None:
        """Trains the document as it is now."""
        workspace, document = self.workspace, self.workspace.document
        out = result_folder(document)
        if out is None:
            workspace.notify(_("Open an object first."))
            return
        try:
            job = Job.start(document, workspace.up, out, program=self.program)
        except InputError as error:
            workspace.show_error(error)
            return
        workspace.change_settings(workspace.settings.with_job(out))
        self._follow(job, document.number)
        shown = workspace.object
        same = shown is not None and (shown.request.detail, shown.request.seed) == (
            document.training.detail,
            document.training.seed,
        )
        if shown is not None and (shown.trained or not same):
            self.scene.load()  # makes the same atoms as the trainer, so that its colours fit
        workspace.notify(_("Training in the background. You can keep cutting."))

    def resume(self) -> None:
        """Continues from the last checkpoint."""
        if self.job is None:
            return
        try:
            job = self.job.resume(self.program)
        except InputError as error:
            self.workspace.show_error(error)
            return
        self.workspace.change_settings(self.workspace.settings.with_job(job.out))
        self._follow(job, self.workspace.document.number)
        self.workspace.notify(_("Training goes on from where it stopped."))

    def toggle_pause(self) -> None:
        """Pauses the job, or lets it continue."""
        if self.job is None:
            return
        if self.job.phase == "paused":
            self.job.unpause()
            self.workspace.notify(_("Training goes on."))
        elif self.job.phase == "running":
            self.job.pause()
            self.workspace.notify(_("Training is paused."))

    def stop(self) -> None:
        """Ends the job; it can be resumed."""
        if self.job is not None:
            self.job.stop()
            self.workspace.notify(_("Stopping. What was done is kept."))

    def tick(self) -> None:
        """Reads the jobs' events and colours when they are due. Called once a frame."""
        now = time.monotonic()
        events, colours = now >= self._next_events, now >= self._next_colours
        if events:
            self._next_events = now + EVENTS_EVERY
        if colours:
            self._next_colours = now + COLOURS_EVERY
        for number, followed in list(self._followed.items()):
            if events:
                followed.job.poll()
                phase = followed.job.phase
                if phase != followed.phase:
                    followed.phase = phase
                    self._phase_changed(followed.job, phase, number)
            if colours and number in self._followed:
                self._take_colours(followed, number)

    def recolour(self) -> None:
        """Colours new atoms of the same objects at once, rather than at the next checkpoint."""
        for followed in self._followed.values():
            followed.colours.reset()
            self._next_colours = 0.0

    def _follow(self, job: Job, number: int) -> None:
        self.scene.stop_refit()  # training fits the skin as well
        self._followed[number] = Followed(job, LiveColours(job.out), job.phase)
        self._next_events = self._next_colours = 0.0

    def _phase_changed(self, job: Job, phase: str, number: int) -> None:
        """If the job has ended, tells the user how, and shows the result."""
        workspace = self.workspace
        if phase not in ("done", "failed", "stopped"):
            return
        workspace.change_settings(workspace.settings.without_job(job.out))
        document = next((one for one in workspace.documents if one.number == number), None)
        if phase == "done":
            del self._followed[number]
            result = None if document is None else self.result_for(document)
            if document is None or (result is None and job.document.isolation != document.isolation):
                workspace.notify(
                    _("The inside is ready, but for what was the object when training began. Undo to see it.")
                )
                return
            several = len(workspace.documents) > 1
            ready = (
                _("The inside of {name} is ready. Cut anywhere.")
                if several
                else _("The inside is ready. Cut anywhere.")
            )
            workspace.notify(ready.format(name=document.title))
            self.scene.load(result, document)
        elif phase == "failed":
            workspace.notify(_("Training ended early. Resume goes on from the last checkpoint."))
            last = job.log_tail()
            workspace.show_error(
                _("Training ended early: ")
                + (last[-1].removeprefix("fruitninja-train: ") if last else _("no reason given"))
            )
        else:
            workspace.notify(_("Stopped. Resume goes on from the last checkpoint."))

    def _take_colours(self, followed: Followed, number: int) -> None:
        workspace, shown = self.workspace, self.workspace.loaded.get(number)
        if shown is None or shown.atoms is None or shown.trained:
            return
        if followed.job.document.isolation != shown.request.isolation:
            return  # the job's atoms are different ones
        atoms = followed.colours.newer(shown.atoms)
        if atoms is not None:
            workspace.loaded[number] = replace(shown, atoms=atoms)
            workspace.colour_version += 1
            same = atoms.interior.means is shown.atoms.interior.means
            if not same or atoms.surface.sh.shape != shown.atoms.surface.sh.shape:
                workspace.geometry_version += 1
