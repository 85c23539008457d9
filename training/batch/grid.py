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
from training.batch.cluster import workers
from training.batch.task import Stopped, Task, perform, said

__all__ = ["Outcome", "Status", "run_grid"]

ATTEMPTS = 2
"""A task that fails, or whose worker dies, is tried once more."""

TICK = 0.25
"""Seconds between two looks at the user's wish to stop and at workers that came or went."""

PATIENCE = 300.0
"""Seconds without any worker after which nobody will come."""

Status = Literal["waiting", "running", "done", "kept", "failed", "stopped"]
"""`kept`: done by an earlier run."""


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


Told = Callable[[Outcome, dict[str, Any]], None]
"""Called for each change of a task's status, with no line, and for each line that it says."""


def run_grid(
    tasks: Sequence[Task],
    told: Told,
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
    waiting = []
    for outcome in outcomes.values():
        facts = outcome.task.kept()
        if facts is None:
            waiting.append(outcome)
        else:
            outcome.status, outcome.facts = "kept", facts
            told(outcome, {})
    if waiting:
        with workers(scheduler, min(count, len(waiting)) if count else None, len(waiting), gigabytes) as client:
            grid = _Grid(client, told, outcomes, waiting)
            try:
                grid.run(stop)
            finally:
                grid.leave()
    return list(outcomes.values())


class _Grid:
    """The state of a grid while it runs."""

    def __init__(self, client: Client, told: Told, outcomes: dict[str, Outcome], waiting: Sequence[Outcome]) -> None:
        self.client = client
        self.told = told
        self.outcomes = outcomes
        self.topic = f"fruitninja-{uuid.uuid4().hex[:12]}"  # two grids on one cluster do not hear each other
        self.stop_event = Event(f"{self.topic}-stop", client=client)
        self.inbox: queue.SimpleQueue[Future | dict[str, Any]] = queue.SimpleQueue()
        self.waiting = deque(waiting)
        self.running: dict[str, tuple[Outcome, Future, float]] = {}
        self.stopping = False
        client.subscribe_topic(self.topic, lambda event: self.inbox.put(event[1]))

    def run(self, stop: Callable[[], bool]) -> None:
        seen = time.monotonic()
        while self.waiting or self.running:
            if stop() and not self.stopping:
                self.stopping = True
                self.stop_event.set()
                while self.waiting:
                    self.becomes(self.waiting.popleft(), "stopped")
            # No more tasks than workers: what waits in a worker's own queue would go down with it.
            workers = len(self.client.nthreads())
            seen = time.monotonic() if workers else seen
            if time.monotonic() - seen > PATIENCE:
                raise InputError("no worker is left; start some and run the same command again")
            while self.waiting and len(self.running) < workers:
                self.submit(self.waiting.popleft())
            self.listen()

    def submit(self, outcome: Outcome) -> None:
        """Sends a task on its way."""
        outcome.attempts += 1
        key = f"{self.topic}-{outcome.task.name}-{outcome.attempts}"
        future = self.client.submit(perform, outcome.task, self.topic, key=key, pure=False)
        self.running[key] = (outcome, future, time.monotonic())
        future.add_done_callback(self.inbox.put)
        self.becomes(outcome, "running")

    def listen(self) -> None:
        """Takes in what has happened, waiting a tick for it."""
        try:
            item = self.inbox.get(timeout=TICK)
        except queue.Empty:
            return
        if isinstance(item, Future):
            self.ended(item)
            return
        outcome = self.outcomes[item["task"]]
        if outcome.status == "running":  # the last lines may come after the result
            self.told(outcome, item["line"])

    def ended(self, future: Future) -> None:
        """A task returned, failed, or went down with its worker."""
        outcome, _, begun = self.running.pop(str(future.key))
        outcome.seconds = time.monotonic() - begun
        if future.status == "finished":
            self.becomes(outcome, "done", facts=future.result())
            return
        error = future.exception() if future.status == "error" else None
        if error is None:
            raise InputError("the scheduler was lost; run the same command again to go on")
        if isinstance(error, KilledWorker):
            outcome.error = "its worker died (out of memory, or killed)"
        elif not isinstance(error, Stopped):
            outcome.error = said(error.with_traceback(future.traceback()))
        if self.stopping:
            self.becomes(outcome, "stopped")
        elif outcome.attempts < ATTEMPTS:
            self.becomes(outcome, "waiting")
            self.waiting.append(outcome)
        else:
            self.becomes(outcome, "failed")

    def becomes(self, outcome: Outcome, status: Status, facts: dict[str, Any] | None = None) -> None:
        """A new status, told to whoever listens."""
        outcome.status = status
        if facts is not None:
            outcome.facts, outcome.error = facts, ""
        self.told(outcome, {})

    def leave(self) -> None:
        """Whatever still runs is asked to stop: nobody waits for it."""
        if self.running:
            self.stop_event.set()
        self.client.unsubscribe_topic(self.topic)
