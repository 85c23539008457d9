"""A task of a grid, and how a worker runs it."""

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
from engine.io.files import read_file, remove, write_json
from engine.threads import use_cores

__all__ = ["RESULT_LIMIT", "Task", "TaskStopped", "report", "run_task", "should_stop"]

POLL_SECONDS = 1.0
"""Interval at which the scheduler is polled for a stop: each poll is a message, perhaps to another machine."""

REPORT_SECONDS = 0.25
"""Shortest interval between two reports of a task: a display shows no more."""


RESULT_LIMIT = 1 << 24
"""Largest accepted result file in bytes; real ones have a few KB."""


class TaskStopped(Exception):
    """Raised by a task that was asked to stop, after it has saved its state."""


@dataclass(frozen=True)
class Task:
    """A function call whose result is stored in a file."""

    name: str
    """Name for displays and summaries; unique in its grid."""
    function: Callable[..., dict[str, Any]]
    """Module-level, importable on every worker; returns JSON facts."""
    arguments: dict[str, Any]
    result: Path
    """JSON file written atomically when the task is done. Absolute, and valid on every worker."""
    fingerprint: str
    """Equal for equal results; a result file with this fingerprint is not computed again."""
    files: tuple[Path, ...] = ()
    """Other files that the function writes; without them the task is not done."""

    def load_facts(self) -> dict[str, Any] | None:
        """The facts of a finished task, None if it is still to be done."""
        try:
            record = json.loads(read_file(self.result, RESULT_LIMIT))
        except (OSError, ValueError, RecursionError):
            return None
        if not isinstance(record, dict) or record.get("fingerprint") != self.fingerprint:
            return None
        facts = record.get("facts")
        return facts if isinstance(facts, dict) and all(path.is_file() for path in self.files) else None

    def save_facts(self, facts: dict[str, Any]) -> None:
        """Writes the result file. Raises InputError if that fails."""
        write_json(self.result, {"fingerprint": self.fingerprint, "facts": facts})


@dataclass
class _Job:
    """The task that a worker's thread is running."""

    name: str
    topic: str
    last_poll: float = 0.0
    last_report: float = 0.0
    stop: bool = False


_thread = threading.local()


def should_stop() -> bool:
    """Whether the task running in this thread should save its state and raise `TaskStopped`."""
    job: _Job | None = getattr(_thread, "job", None)
    if job is None:
        return False
    now = time.monotonic()
    if not job.stop and now - job.last_poll >= POLL_SECONDS:
        job.last_poll = now
        job.stop = Event(f"{job.topic}-stop").is_set()
    return job.stop


def report(line: dict[str, Any]) -> None:
    """Sends JSON facts about the task running in this thread to `run_grid`; frequent ones are dropped."""
    job: _Job | None = getattr(_thread, "job", None)
    now = time.monotonic()
    if job is not None and now - job.last_report >= REPORT_SECONDS:
        job.last_report = now
        get_worker().log_event(job.topic, {"task": job.name, "line": line})


def run_task(task: Task, topic: str) -> dict[str, Any]:
    """Runs a task on a worker, with its share of the machine's cores; stores and returns the facts."""
    if (facts := task.load_facts()) is not None:  # finished by a worker that seemed lost
        return facts
    remove(task.result)  # of other settings: its files are about to be replaced
    use_cores(share_of_cores())
    _thread.job = _Job(task.name, topic)
    try:
        facts = task.function(**task.arguments)
    finally:
        del _thread.job
    task.save_facts(facts)
    return facts


def share_of_cores() -> int:
    """Cores of this machine over the workers on it, at least 1, so that their threads do not compete."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    host = urlsplit(get_worker().address).hostname
    on_this_host = sum(urlsplit(address).hostname == host for address in get_client().nthreads())
    return max(1, cores // max(1, on_this_host))


def describe_error(error: BaseException) -> str:
    """An error in one line: an InputError's message, or type, message and location of any other."""
    if isinstance(error, InputError):
        return str(error)
    frame, location = error.__traceback__, ""
    while frame is not None:
        location = f" ({Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno})"
        frame = frame.tb_next
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}{location}"
