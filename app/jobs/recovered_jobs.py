"""Training jobs that an earlier session left behind: which there are, and the work that they belong to."""

from __future__ import annotations

from pathlib import Path

from app.jobs.training_job import Job
from app.session.session import Session

__all__ = ["forget_job", "left_jobs", "words_of"]


def left_jobs(session: Session) -> list[Job]:
    """Jobs that were running when a window was closed, and belong to nothing that is shown."""
    found = []
    for name in session.settings.jobs:
        job = Job.find(Path(name))
        if job is None or not job.scene.is_file():
            continue
        if session.desk.job is not None and session.desk.job.out == job.out:
            continue
        while job.poll():
            pass
        found.append(job)
    return found


def words_of(job: Job) -> str:
    """What became of it, in a sentence."""
    name = job.scene.stem
    how = {"running": "is still running", "paused": "is paused", "done": "has finished"}
    return f"Training of {name} {how.get(job.phase, 'ended early')}."


def forget_job(session: Session, job: Job) -> None:
    """It is not told of again, unless it still runs."""
    if job.ended:
        session.remember(session.settings.without_job(job.out))
