"""Training jobs that were running when an earlier session was closed."""

from __future__ import annotations

from pathlib import Path

from app.jobs.training_job import Job
from app.session.session import Session
from app.translation import _

__all__ = ["describe_job", "dismiss_job", "recovered_jobs"]


def recovered_jobs(session: Session) -> list[Job]:
    """The jobs in the settings whose scene still exists, except those that this session follows already."""
    jobs = []
    for name in session.settings.jobs:
        job = Job.find(Path(name))
        if job is None or not job.scene.is_file():
            continue
        if any(known.out == job.out for known in session.training.jobs):
            continue
        while job.poll():
            pass
        jobs.append(job)
    return jobs


def describe_job(job: Job) -> str:
    """How the job stands, in a sentence for the user."""
    name = job.scene.stem
    states = {
        "running": _("is still running"),
        "paused": _("is paused"),
        "stopping": _("is stopping"),
        "done": _("has finished"),
    }
    return _("Training of {name} {state}.").format(name=name, state=states.get(job.phase, _("ended early")))


def dismiss_job(session: Session, job: Job) -> None:
    """Forgets the job, so that it is not mentioned again, unless it is still running."""
    if job.ended:
        session.change_settings(session.settings.without_job(job.out))
