"""Training jobs that an earlier session left behind: which there are, and the work that they belong to."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from app.document import Document, Training
from app.job import Job
from app.session import Session
from engine.errors import InputError

__all__ = ["document_of", "forget_job", "left_jobs", "words_of"]


def left_jobs(session: Session) -> list[Job]:
    """Jobs that were running when a window was closed, and belong to nothing that is shown."""
    found = []
    for name in session.settings.jobs:
        job = Job.find(Path(name))
        if job is None or job.scene is None or not job.scene.is_file():
            continue
        if session.desk.job is not None and session.desk.job.out == job.out:
            continue
        while job.poll():
            pass
        found.append(job)
    return found


def words_of(job: Job) -> str:
    """What became of it, in a sentence."""
    name = job.scene.stem if job.scene else job.out.name
    how = {"running": "is still running", "paused": "is paused", "done": "has finished"}
    return f"Training of {name} {how.get(job.phase, 'ended early')}."


def forget_job(session: Session, job: Job) -> None:
    """It is not told of again, unless it still runs."""
    if job.ended:
        session.remember(session.settings.without_job(job.out))


def document_of(job: Job) -> Document:
    """What the job was started from, as far as its command tells: the scene, its families and how it trains.

    Pictures that are no longer there are left out with their families.
    """
    from training.cli import parse_axis, parse_families  # loads the trainer: only where there is a job

    words = job.command
    given: dict[str, list[str]] = {}
    for option, value in pairwise(words):
        if option.startswith("--"):
            given.setdefault(option, []).append(value)

    def last(option: str) -> str | None:
        return given[option][-1] if option in given else None

    model, iterations = last("--model"), last("--iterations")
    training = Training(
        detail=last("--detail") or "standard",  # type: ignore[arg-type]
        prior=last("--prior") or "exemplar",
        seed=int(last("--seed") or 0),
        iterations=None if iterations is None else int(iterations),
        out=job.out,
        model=None if model is None else Path(model),
        thing=last("--object") or "",
    )
    up = last("--up")
    document = Document(scene=job.scene, up=None if up is None else parse_axis(up, "--up"), training=training)
    try:
        families = parse_families(
            given.get("--exemplar", []), given.get("--family", []), given.get("--prompt", []), pictures_needed=False
        )
    except InputError:
        return document
    for family in families:
        document = document.with_family(family)
    return document
