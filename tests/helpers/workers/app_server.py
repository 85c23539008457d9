"""A process that has imported the window and its scripts and loaded the kernels, which takes seconds, and runs each
script in a fork of itself. The scenes that a script opens are made solid in forks too.

tests/app/test_window.py writes a line of JSON for each script: its module in tests/helpers, its name, its folder, and
the file for what it prints. The answer is a line with the fork's pid, and later one with the status that it ended with.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from importlib import import_module

from app.jobs import scene_worker
from app.jobs.warmup import load_kernels
from tests.helpers.workers import quick_scene_worker
from tests.helpers.workers.forks import Forks

SCRIPTS = ("app_film_steps", "app_isolate_steps", "app_scripts", "app_steps", "hard_use.steps")


def main() -> None:
    """Runs scripts until there are no more lines."""
    modules = {name: import_module(f"tests.helpers.{name}") for name in SCRIPTS}
    load_kernels()
    vars(scene_worker)["warm_up"] = lambda: None
    gc.freeze()  # a fork that ends need not look through all that was imported
    for line in sys.stdin:
        script, name, folder, said = json.loads(line)
        child = os.fork()
        if not child:
            os.setsid()  # to be ended with all that it starts
            os.chdir(folder)
            for stream, path, flags in ((0, os.devnull, os.O_RDONLY), (1, said, os.O_WRONLY | os.O_CREAT)):
                os.dup2(os.open(path, flags), stream)
            os.dup2(1, 2)
            sys.argv = [script, name, folder]
            quick_scene_worker.start = Forks(quick_scene_worker.main).start
            modules[script].main()
            return  # and ends as any process does
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    main()
