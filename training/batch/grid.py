"""A grid of tasks from the side that wants the results: in order, each retried once, none in the way of the others."""

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
"""A task that fails, or whose worker dies, is tried once more."""

POLL_SECONDS = 0.25
"""Seconds between two looks at the user's wish to stop and at workers that came or went."""

MAX_IDLE_SECONDS = 300.0
"""Seconds without any worker after which nobody will come."""

Status = Literal["waiting", "running", "done", "kept", "failed", "stopped"]
"""`load_facts`: done by an earlier run."""


@dataclass
class Outcome:
    """How a task stands."""

    task: Task
    status: Status = "waiting"
    attempts: int = 0
    """Times it was sent to a worker."""
    seconds: float = 0.0
    """Of the last attempt."""
    facts: dict[str, Any] = field(default_factory=dict)
    error: str = ""
    """One line, of the last attempt that failed."""


OnChange = Callable[[Outcome, dict[str, Any]], None]
"""Called for each change of a task's status, with no line, and for each line that it says."""


def run_grid(
    tasks: Sequence[Task],
    on_change: OnChange,
    stop: Callable[[], bool],
    *,
    scheduler: str | None = None,
    count: int | None = None,
    gigabytes: float = 1.0,
) -> list[Outcome]:
    """Does all tasks that are not done yet; returns how each ended, in the order given.

    Without the address of a `scheduler` they run on this machine, in `count` workers, or in as many as there are cores
    and memory for `gigabytes` each. Once `stop` says yes, running tasks are asked to keep what they have and nothing
    new begins. Raises InputError where the scheduler does not answer, is lost, or has no workers; what was done stays.
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
    """The state of a grid while it runs."""

    def __init__(
        self, client: Client, on_change: OnChange, outcomes: dict[str, Outcome], pending: Sequence[Outcome]
    ) -> None:
        self.client = client
        self.on_change = on_change
        self.outcomes = outcomes
        self.topic = f"fruitninja-{uuid.uuid4().hex[:12]}"  # two grids on one cluster do not hear each other
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
            # No more tasks than workers: what waits in a worker's own queue would go down with it.
            worker_count = len(self.client.nthreads())
            seen = time.monotonic() if worker_count else seen
            if time.monotonic() - seen > MAX_IDLE_SECONDS:
                raise InputError("no worker is left; start some and run the same command again")
            while self.pending and len(self.running) < worker_count:
                self.submit(self.pending.popleft())
            self.handle_event()

    def submit(self, outcome: Outcome) -> None:
        """Sends a task on its way."""
        outcome.attempts += 1
        key = f"{self.topic}-{outcome.task.name}-{outcome.attempts}"
        future = self.client.submit(run_task, outcome.task, self.topic, key=key, pure=False)
        self.running[key] = (outcome, future, time.monotonic())
        future.add_done_callback(self.inbox.put)
        self.set_status(outcome, "running")

    def handle_event(self) -> None:
        """Takes in what has happened, waiting a tick for it."""
        try:
            item = self.inbox.get(timeout=POLL_SECONDS)
        except queue.Empty:
            return
        if isinstance(item, Future):
            self.handle_end(item)
            return
        outcome = self.outcomes[item["task"]]
        if outcome.status == "running":  # the last lines may come after the result
            self.on_change(outcome, item["line"])

    def handle_end(self, future: Future) -> None:
        """A task returned, failed, or went down with its worker."""
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
        """A new status, told to whoever listens."""
        outcome.status = status
        if facts is not None:
            outcome.facts, outcome.error = facts, ""
        self.on_change(outcome, {})

    def close(self) -> None:
        """Whatever still runs is asked to stop: nobody waits for it."""
        if self.running:
            self.stop_event.set()
        self.client.unsubscribe_topic(self.topic)
