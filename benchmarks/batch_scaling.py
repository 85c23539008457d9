"""Scenes per hour against the number of `fruitninja-batch` workers, and what bounds them.

    python -m benchmarks.batch_scaling [--quick] [--scenes 4] [--workers 1,2] [--preload FILE] [-o docs/charts]

Trains the same small scenes (the sample orange with several seeds, one iteration at draft detail) with each of the
numbers of workers, each time from nothing, and at least one scene for each worker. The cluster's start-up is reported
apart from the training, as are the seconds that scenes wait while nobody works on them. With --preload every worker
runs a file first: tests/helpers/workers/batch_worker.py makes runs of a second or two, which show what the workers
themselves cost. Writes batch_scaling.json, which has the numbers, and batch_scaling.png anew after each batch.
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import dask
import psutil

from benchmarks.support.charts import ACCENT, QUIET, plt, save_chart
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import write_json
from engine.threads import one_thread_for_blas
from training.batch import Outcome, run_grid
from training.batch.scene import scene_task
from training.families import Family
from training.request import Request

ORANGE = ROOT / "sample_scenes/orange"
SMALL_RUNS = ROOT / "tests/helpers/workers/batch_worker.py"
"""The file that a worker runs first in the tests."""


def requests(count: int) -> list[Request]:
    """Runs that differ only in their seeds, so that each costs the same."""
    families = (
        Family("horizontal", 12, (ORANGE / "horizontal_1.png",)),
        Family("radial", 10, (ORANGE / "radial_1.png",)),
    )
    return [Request(ORANGE / "orange.ply", families, "draft", (0, 0, 1), seed, 1) for seed in range(count)]


def processor_seconds() -> float:
    """Seconds of processor time of all descendants of this process that run now."""
    total = 0.0
    for child in psutil.Process().children(recursive=True):
        try:
            times = child.cpu_times()
        except psutil.NoSuchProcess:
            continue
        total += times.user + times.system
    return total


def measure(workers: int, count: int) -> dict[str, Any]:
    """One batch from nothing: seconds to the first scene's start, seconds to the end, and processor time."""
    begun = time.perf_counter()
    first = started = 0.0

    def on_change(outcome: Outcome, line: dict[str, Any]) -> None:
        nonlocal first, started
        if line and not first:
            first, started = time.perf_counter() - begun, processor_seconds()

    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryDirectory() as folder:
        tasks = [scene_task(f"s{i}", request, Path(folder) / f"s{i}") for i, request in enumerate(requests(count))]
        outcomes = run_grid(tasks, on_change, lambda: False, count=workers)
        assert all(outcome.status == "done" for outcome in outcomes), [outcome.error for outcome in outcomes]
    seconds = time.perf_counter() - begun
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime - started
    return {
        "workers": workers,
        "scenes": count,
        "seconds": round(seconds, 1),
        "start_seconds": round(first, 1),
        "scenes_per_hour": round(3600 * count / (seconds - first), 1),
        "seconds_per_scene_on_a_worker": round(sum(outcome.seconds for outcome in outcomes) / count, 1),
        "processor_seconds_per_scene": round(busy / count, 1),
        "load": round(os.getloadavg()[0], 1),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measures and draws the chart."""
    parser = parser_of(__doc__, "two of the tests' small scenes")
    parser.add_argument("--scenes", type=int, default=4, help="scenes of a batch")
    parser.add_argument("--workers", default="1,2", help="numbers of workers, with commas")
    parser.add_argument("--preload", help="a file that every worker runs first")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    count, preload = (2, str(SMALL_RUNS)) if options.quick else (options.scenes, options.preload)
    one_thread_for_blas()  # as `fruitninja-batch` does, for its workers too
    if preload:
        dask.config.set({"distributed.worker.preload": [preload]})
    rows: list[dict[str, Any]] = []
    for workers in map(int, options.workers.split(",")):
        rows.append(measure(workers, max(count, workers)))
        print(rows[-1], flush=True)
        if folder:
            figures = summary(rows, preload)
            write_json(folder / "batch_scaling.json", figures)
            draw(figures, folder / "batch_scaling.png")


def summary(rows: list[dict[str, Any]], preload: str | None) -> dict[str, Any]:
    """The rows, the machine, and the bound that its cores set."""
    cores = os.cpu_count() or 1
    bound = 3600 * cores / min(row["processor_seconds_per_scene"] for row in rows)
    return {
        "cores": cores,
        "preload": preload and Path(preload).name,
        "memory_gb": round(psutil.virtual_memory().total / 2**30),
        "most_memory_of_a_process_gb": round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20, 2),
        "bound_scenes_per_hour_of_all_cores": round(bound, 1),
        "rows": rows,
        "bound": "Scenes share nothing but the disk: a machine is bound by processor time, cores x 3600 s over the "
        "processor seconds of a scene; then by memory, and the last scenes of a batch leave workers idle for at most "
        "one scene's time. `load` says what else the machine was doing: its cores are shared when it is above workers.",
    }


def draw(figures: dict[str, Any], path: Path) -> None:
    """Scenes per hour, and the bound that the cores set."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axis = plt.subplots(figsize=(5, 3.4), layout="constrained")
    workers = [row["workers"] for row in figures["rows"]]
    rate = [row["scenes_per_hour"] for row in figures["rows"]]
    axis.plot(workers, rate, "o-", color=ACCENT, label="measured")
    axis.plot(workers, [rate[0] * n / workers[0] for n in workers], "--", color=QUIET, label="in proportion")
    axis.axhline(figures["bound_scenes_per_hour_of_all_cores"], color=QUIET, linewidth=0.8)
    axis.annotate(f"all {figures['cores']} cores busy", (1, figures["bound_scenes_per_hour_of_all_cores"]), (0, 4),
                  textcoords="offset points", color=QUIET)  # fmt: skip
    axis.set(xlabel="workers", ylabel="scenes per hour", xticks=workers, title="fruitninja-batch")
    axis.set_ylim(bottom=0)
    axis.legend(frameon=False, loc="lower right")
    save_chart(figure, path)


if __name__ == "__main__":
    main()
