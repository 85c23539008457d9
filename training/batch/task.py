"""One task of a grid: what it is, and how a worker does it."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from distributed import Event, get_client, get_worker

from engine.errors import InputError
from engine.io.files import atomic, read_file
from engine.threads import use_cores

__all__ = ["RESULT_LIMIT", "Stopped", "Task", "perform", "say", "stopped"]

ASK_SECONDS = 1.0
"""Between two questions to the scheduler whether to stop: each is a message to another process, perhaps machine."""

SAY_SECONDS = 0.25
"""Between two lines of one task, as many as a display can show."""


RESULT_LIMIT = 1 << 24
"""Bytes of the largest result that is read; a real one has a few KB."""


class Stopped(Exception):
    """A task that was asked to stop has kept what it had and ended."""


@dataclass(frozen=True)
class Task:
    """A function call whose result is kept in a file."""

    name: str
    """Names the task for people and in summaries; unique in its grid."""
    function: Callable[..., dict[str, Any]]
    """Module-level, importable on every worker; returns JSON facts."""
    arguments: dict[str, Any]
    result: Path
    """JSON file that appears, whole, when the task is done. Absolute; every worker sees it under this path."""
    fingerprint: str
    """The same for the same result. A result file that carries it is not made again."""
    files: tuple[Path, ...] = ()
    """What else the function leaves; where one is missing, the task is not done."""

    def kept(self) -> dict[str, Any] | None:
        """The facts of a task that was done before, None where it is still to be done."""
        try:
            record = json.loads(read_file(self.result, RESULT_LIMIT))
        except (OSError, ValueError, RecursionError):
            return None
        if not isinstance(record, dict) or record.get("fingerprint") != self.fingerprint:
            return None
        facts = record.get("facts")
        return facts if isinstance(facts, dict) and all(path.is_file() for path in self.files) else None

    def keep(self, facts: dict[str, Any]) -> None:
        """Writes the result file. Raises InputError where that fails."""
        text = json.dumps({"fingerprint": self.fingerprint, "facts": facts}, indent=1, allow_nan=False)
        with atomic(self.result) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")


@dataclass
class _Job:
    """The task that a worker's thread is doing."""

    name: str
    topic: str
    asked: float = 0.0
    told: float = 0.0
    stop: bool = False


_here = threading.local()


def stopped() -> bool:
    """Whether the task that is being done here should end, by raising `Stopped` once it has kept what it has."""
    job: _Job | None = getattr(_here, "job", None)
    if job is None:
        return False
    now = time.monotonic()
    if not job.stop and now - job.asked >= ASK_SECONDS:
        job.asked = now
        job.stop = Event(f"{job.topic}-stop").is_set()
    return job.stop


def say(line: dict[str, Any]) -> None:
    """Tells whoever runs the grid a few JSON facts about the task that is being done here; lines may be dropped."""
    job: _Job | None = getattr(_here, "job", None)
    now = time.monotonic()
    if job is not None and now - job.told >= SAY_SECONDS:
        job.told = now
        get_worker().log_event(job.topic, {"task": job.name, "line": line})


def perform(task: Task, topic: str) -> dict[str, Any]:
    """Does a task on a worker, with this worker's share of the machine's cores. Returns and keeps its facts."""
    if (facts := task.kept()) is not None:  # done by a worker that was thought to be lost
        return facts
    use_cores(share_of_cores())
    _here.job = _Job(task.name, topic)
    try:
        facts = task.function(**task.arguments)
    finally:
        del _here.job
    task.keep(facts)
    return facts


def share_of_cores() -> int:
    """Cores of this machine over the workers on it, at least 1: so many threads that they do not fight."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    own = urlsplit(get_worker().address).hostname
    beside = sum(urlsplit(address).hostname == own for address in get_client().nthreads())
    return max(1, cores // max(1, beside))


def said(error: BaseException) -> str:
    """An error in one line: the message that a user is meant to see, or what happened and where."""
    if isinstance(error, InputError):
        return str(error)
    last, at = error.__traceback__, ""
    while last is not None:
        at = f" ({Path(last.tb_frame.f_code.co_filename).name}:{last.tb_lineno})"
        last = last.tb_next
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}{at}"
