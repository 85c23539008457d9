"""The training side of a session: starts the job, follows it, and brings its colours into the window."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from app.jobs.live_colours import Watch
from app.jobs.training_job import Job, default_out
from app.model.document import Document
from engine.errors import InputError
from engine.io.trained import sidecar_path

if TYPE_CHECKING:
    from app.session.session import Session

__all__ = ["Desk"]

LOOK_EVERY = 0.25
"""Seconds between two looks at a running job's events."""

COLOURS_EVERY = 1.0
"""Seconds between two looks for newer colours."""


class Desk:
    """One job at a time belongs to the window's scene."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.job: Job | None = None
        self.program: tuple[str, ...] = ()
        """Something else than the trainer that speaks its events, for tests."""
        self.watch: Watch | None = None
        self._next_look = 0.0
        self._next_colours = 0.0
        self._phase = ""

    def out(self, document: Document) -> Path | None:
        """Where the result of this document goes."""
        if document.scene is None:
            return None
        return document.training.out or default_out(document.scene)

    def result_for(self, document: Document) -> Path | None:
        """A finished result for the document's scene."""
        out = self.out(document)
        if out is None or document.scene is None:
            return None
        path = out / f"{document.scene.stem}.ply"
        return path if path.is_file() and sidecar_path(path).is_file() and self.job is None else None

    def look_for(self, document: Document) -> None:
        """Finds the job of a document that was just opened, if one is running or was cut off."""
        self.job, self.watch = None, None
        out = self.out(document)
        job = None if out is None else Job.find(out)
        if job is None or job.scene != document.scene:
            return
        while job.poll() and not job.ended:
            pass
        job.poll()
        if job.phase != "done":
            self._follow(job)
            if job.phase in ("running", "paused"):
                self.session.say("Training went on while the window was closed.")

    @property
    def busy(self) -> bool:
        """Whether a job of this scene is running or held."""
        return self.job is not None and self.job.phase in ("running", "paused")

    def start(self) -> None:
        """Trains the document as it is."""
        session, document = self.session, self.session.document
        out = self.out(document)
        if out is None:
            session.say("Open an object first.")
            return
        try:
            job = Job.start(document, session.up, out, program=self.program)
        except InputError as error:
            session.fail(error)
            return
        session.remember(session.settings.with_job(out))
        self._follow(job)
        shown = session.object
        same = shown is not None and (shown.request.detail, shown.request.seed) == (
            document.training.detail,
            document.training.seed,
        )
        if shown is not None and (shown.trained or not same):
            session.prepare(trained=False)  # the trainer's atoms, so that its colours fit
        session.say("Training in the background. You can keep cutting.")

    def resume(self) -> None:
        """Goes on from the last checkpoint."""
        if self.job is None:
            return
        try:
            self._follow(self.job.resume(self.program))
        except InputError as error:
            self.session.fail(error)
            return
        self.session.say("Training goes on from where it stopped.")

    def toggle_pause(self) -> None:
        """Holds the job, or lets it go on."""
        if self.job is None:
            return
        if self.job.phase == "paused":
            self.job.go_on()
            self.session.say("Training goes on.")
        else:
            self.job.pause()
            self.session.say("Training is paused.")

    def stop(self) -> None:
        """Ends the job; it can be resumed."""
        if self.job is not None:
            self.job.stop()
            self.session.say("Stopping. What was done is kept.")

    def dismiss(self) -> None:
        """Forgets a job that has ended."""
        if self.job is not None and not self.busy:
            self.job, self.watch = None, None

    def tick(self) -> None:
        """Follows the job."""
        job, now = self.job, time.monotonic()
        if job is None:
            return
        if now >= self._next_look:
            self._next_look = now + LOOK_EVERY
            job.poll()
            phase = job.phase
            if phase != self._phase:
                self._phase = phase
                self._ended(job, phase)
        if now >= self._next_colours:
            self._next_colours = now + COLOURS_EVERY
            self._take_colours()

    def recolour(self) -> None:
        """Other atoms of the same object are shown: they take on at once what training has reached."""
        if self.watch is not None:
            self.watch.forget()
            self._next_colours = 0.0

    def _follow(self, job: Job) -> None:
        self.job, self.watch, self._phase = job, Watch(job.out), job.phase
        self._next_look = self._next_colours = 0.0

    def _ended(self, job: Job, phase: str) -> None:
        """Says how it ended, and shows the result."""
        session = self.session
        if phase not in ("done", "failed", "stopped"):
            return
        session.remember(session.settings.without_job(job.out))
        if phase == "done":
            self.job = None
            session.say("The inside is ready. Cut anywhere.")
            session.prepare()
        elif phase == "failed":
            last = job.last_words()
            session.fail(
                "Training ended early: " + (last[-1].removeprefix("fruitninja-train: ") if last else "no reason given")
            )
        else:
            session.say("Stopped. Resume goes on from the last checkpoint.")

    def _take_colours(self) -> None:
        session, shown = self.session, self.session.object
        if self.watch is None or shown is None or shown.atoms is None or shown.trained:
            return
        atoms = self.watch.newer(shown.atoms)
        if atoms is not None:
            session.object = replace(shown, atoms=atoms)
            session.colours += 1
            same = atoms.interior.means is shown.atoms.interior.means
            if not same or atoms.surface.sh.shape != shown.atoms.surface.sh.shape:
                session.geometry += 1
