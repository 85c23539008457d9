"""Many tasks on many workers: `fruitninja-batch`, and the door that any other grid of tasks may take.

A grid is a list of `Task`s: a plain module-level function, its arguments, and the JSON file for what it returns.
`run_grid` does them on workers of this machine or of a running Dask cluster, and skips what is done. Long ones ask
`stopped()` now and then and tells how far it is with `say()`; outside of a worker the one is False, the other silent.
"""

from training.batch.grid import Outcome, run_grid
from training.batch.task import Task, TaskStopped, report, should_stop

__all__ = ["Outcome", "Task", "TaskStopped", "report", "run_grid", "should_stop"]
