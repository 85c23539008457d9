"""Runs a grid of tasks: results in order, failures retried once, no failure affecting other tasks."""

from __future__ import annotations

import queue
import time
import uuid
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from distributed import Client, Event, Future, KilledWorker

from engine.errors import InputError
from training.batch.cluster import cluster_client
from training.batch.task import Task, TaskStopped, describe_error, run_task

__all__ = ["Outcome", "Status", "run_grid"]

ATTEMPTS = 2
"""Attempts for a task that fails or whose worker dies."""

POLL_SECONDS = 0.25
"""Seconds between checks for a stop request and for changes of the workers."""

MAX_IDLE_SECONDS = 300.0
"""Seconds without any worker after which the grid gives up."""

Status = Literal["waiting", "running", "done", "kept", "failed", "stopped"]
"""`kept`: finished by an earlier run."""


@dataclass
class Outcome:
    """The state of a task."""

    task: Task
    status: Status = "waiting"
    attempts: int = 0
    """Number of times it was submitted to a worker."""
    seconds: float = 0.0
    """Duration of the last attempt."""
    facts: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    """Error of the last attempt that failed, in one line."""


OnChange = Callable[[Outcome, dict[str, Any]], None]
"""Called with an empty dict on each change of a task's status, and with each of its reports."""


def run_grid(
    tasks: Sequence[Task],
    on_change: OnChange,
    stop: Callable[[], bool],
    *,
    scheduler: str | None = None,
    count: int | None = None,
    gigabytes: float = 1.0,
) -> list[Outcome]:
    """Runs all unfinished tasks; returns the outcome of each, in the order given.

    Without the address of a `scheduler` they run on this machine, in `count` workers, or in as many as cores and memory
    (`gigabytes` each) allow. Once `stop` returns True, running tasks are asked to save their state and no others start.
    Raises InputError if the scheduler does not answer, is lost, or has no workers; finished results are kept.
    """
    outcomes = {task.name: Outcome(task) for task in tasks}
    assert len(outcomes) == len(tasks), "two tasks of one name"
    pending = []
    for outcome in outcomes.values():
        facts = outcome.task.load_facts()
        if facts is None:
            pending.append(outcome)
        else:
            outcome.status, outcome.facts = "kept", facts
            on_change(outcome, {})
    if pending:
        with cluster_client(scheduler, min(count, len(pending)) if count else None, len(pending), gigabytes) as client:
            grid = _Grid(client, on_change, outcomes, pending)
            try:
                grid.run(stop)
            finally:
                grid.close()
    return list(outcomes.values())


class _Grid:
    """A running grid."""

    def __init__(
        self, client: Client, on_change: OnChange, outcomes: dict[str, Outcome], pending: Sequence[Outcome]
    ) -> None:
        self.client = client
        self.on_change = on_change
        self.outcomes = outcomes
        self.topic = f"fruitninja-{uuid.uuid4().hex[:12]}"  # separates the messages of grids on one cluster
        self.stop_event = Event(f"{self.topic}-stop", client=client)
        self.inbox: queue.SimpleQueue[Future | dict[str, Any]] = queue.SimpleQueue()
        self.pending = deque(pending)
        self.running: dict[str, tuple[Outcome, Future, float]] = {}
        self.stopping = False
        client.subscribe_topic(self.topic, lambda event: self.inbox.put(event[1]))

    def run(self, stop: Callable[[], bool]) -> None:
        seen = time.monotonic()
        while self.pending or self.running:
            if stop() and not self.stopping:
                self.stopping = True
                self.stop_event.set()
                while self.pending:
                    self.set_status(self.pending.popleft(), "stopped")
            # No more tasks than workers: tasks queued on a worker would be lost with it.
            worker_count = len(self.client.nthreads())
            seen = time.monotonic() if worker_count else seen
            if time.monotonic() - seen > MAX_IDLE_SECONDS:
                raise InputError("no worker is left; start some and run the same command again")
            while self.pending and len(self.running) < worker_count:
                self.submit(self.pending.popleft())
            self.handle_event()

    def submit(self, outcome: Outcome) -> None:
        """Submits a task to the cluster."""
        outcome.attempts += 1
        key = f"{self.topic}-{outcome.task.name}-{outcome.attempts}"
        future = self.client.submit(run_task, outcome.task, self.topic, key=key, pure=False)
        self.running[key] = (outcome, future, time.monotonic())
        future.add_done_callback(self.inbox.put)
        self.set_status(outcome, "running")

    def handle_event(self) -> None:
        """Handles the next event, waiting up to POLL_SECONDS for it."""
        try:
            item = self.inbox.get(timeout=POLL_SECONDS)
        except queue.Empty:
            return
        if isinstance(item, Future):
            self.handle_end(item)
            return
        outcome = self.outcomes[item["task"]]
        if outcome.status == "running":  # the last reports may arrive after the result
            self.on_change(outcome, item["line"])

    def handle_end(self, future: Future) -> None:
        """Handles the end of a task: success, failure, or the death of its worker."""
        outcome, _, begun = self.running.pop(str(future.key))
        outcome.seconds = time.monotonic() - begun
        if future.status == "finished":
            self.set_status(outcome, "done", facts=future.result())
            return
        error = future.exception() if future.status == "error" else None
        if error is None:
            raise InputError("the scheduler was lost; run the same command again to go on")
        if isinstance(error, KilledWorker):
            outcome.error = "its worker died (out of memory, or killed)"
        elif not isinstance(error, TaskStopped):
            outcome.error = describe_error(error.with_traceback(future.traceback()))
        if self.stopping:
            self.set_status(outcome, "stopped")
        elif outcome.attempts < ATTEMPTS:
            self.set_status(outcome, "waiting")
            self.pending.append(outcome)
        else:
            self.set_status(outcome, "failed")

    def set_status(self, outcome: Outcome, status: Status, facts: dict[str, Any] | None = None) -> None:
        """Sets a status and reports the change."""
        outcome.status = status
        if facts is not None:
            outcome.facts, outcome.error = facts, ""
        self.on_change(outcome, {})

    def close(self) -> None:
        """Asks running tasks to stop, without waiting for them."""
        if self.running:
            self.stop_event.set()
        self.client.unsubscribe_topic(self.topic)
