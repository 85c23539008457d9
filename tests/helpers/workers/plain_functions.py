"""Tasks of a grid, in a module of their own: a worker that imported a test would import all that trains."""

from __future__ import annotations

import time
from pathlib import Path

from training.batch import TaskStopped, report, should_stop


def double(value: int) -> dict[str, int]:
    report({"event": "progress", "part": 0.5})
    return {"twice": 2 * value}


def fail_at_first(mark: Path) -> dict[str, int]:
    if not mark.exists():
        mark.touch()
        raise KeyError("first")
    return {}


def fail() -> dict[str, int]:
    raise ZeroDivisionError("always\nso")


def wait_until_stopped() -> dict[str, int]:
    for _ in range(600):
        if should_stop():
            raise TaskStopped
        time.sleep(0.05)
    return {}
