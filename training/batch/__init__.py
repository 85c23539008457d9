"""Runs many tasks on many workers: `fruitninja-batch`, and an interface for any other grid of tasks.

A grid is a list of `Task`s: a module-level function, its arguments, and the JSON file for its return value. `run_grid`
runs them on workers of this machine or of a running Dask cluster, and skips finished ones.
Long tasks poll `should_stop()` and report progress with `report()`; outside a worker these return False and do nothing.
"""

from training.batch.grid import Outcome, run_grid
from training.batch.task import Task, TaskStopped, report, should_stop

__all__ = ["Outcome", "Task", "TaskStopped", "report", "run_grid", "should_stop"]
