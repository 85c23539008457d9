"""The grid of an evaluation: independent cells, each with its own result file."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.processes import safe_imports
from training.batch.cluster import deferred_signals
from training.batch.grid import Outcome, run_grid
from training.batch.task import Task
from training.evaluate.measure import fingerprint, measure
from training.settings import DETAILS, Detail, DetailName

__all__ = ["Cell", "cells", "run_cell", "run_locally", "run_on_cluster"]


@dataclass(frozen=True)
class Cell:
    """One method on one scene: a call of `measure` whose facts are stored in a JSON file."""

    scene: str
    method: str
    seed: int
    detail: DetailName
    cuts: int
    clip: Path | None
    out: Path

    @property
    def name(self) -> str:
        """Name for displays; unique in its grid."""
        return f"{self.scene}/{self.method}" + (f"-{self.seed}" if self.seed else "")

    @property
    def result(self) -> Path:
        """The result file."""
        return self.out / "results" / self.scene / f"{self.method}-{self.seed}.json"

    @property
    def fingerprint(self) -> str:
        """Equal for equal figures."""
        return fingerprint(self.scene, self.method, self.seed, self.detail, self.cuts, self.clip)

    @property
    def task(self) -> Task:
        """The call and its result file."""
        arguments = {field.name: getattr(self, field.name) for field in fields(self)}
        return Task(self.name, measure, arguments, self.result, self.fingerprint)

    def load_facts(self) -> dict[str, Any] | None:
        """The facts of an earlier evaluation with the same settings, None without any."""
        return self.task.load_facts()


def cells(
    scenes: Sequence[str],
    methods: Sequence[str],
    seeds: Sequence[int],
    detail: DetailName,
    cuts: int,
    clip: Path | None,
    out: Path,
) -> list[Cell]:
    """All cells of a grid, method by method, so that the first methods are measured on every scene first."""
    return [
        Cell(scene, method, seed, detail, cuts, clip, out) for method in methods for scene in scenes for seed in seeds
    ]


def run_cell(cell: Cell, numbers: Detail) -> dict[str, Any]:
    """Measures one cell and stores its facts; `numbers` is its level of detail, set in this process."""
    DETAILS[cell.detail] = numbers
    facts = measure(cell.scene, cell.method, cell.seed, cell.detail, cell.cuts, cell.clip, cell.out)
    cell.task.save_facts(facts)
    return facts


def run_locally(grid: Sequence[Cell], on_change: Callable[[Cell, str], None]) -> dict[Cell, str]:
    """Runs unfinished cells one after another; returns the error of each that failed.

    Each has a process of its own, so that its peak memory can be measured.
    """
    failed = {}
    for cell in grid:
        if cell.load_facts() is not None:
            on_change(cell, "kept")
            continue
        on_change(cell, "begins")
        with safe_imports(), ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
            try:
                with deferred_signals(signal.SIGINT, signal.SIGTERM):
                    done = pool.submit(run_cell, cell, DETAILS[cell.detail])
                done.result()
            except InputError as error:
                failed[cell] = str(error)
            except BrokenProcessPool:
                failed[cell] = "its process died (out of memory, or killed)"
            except BaseException:  # interrupted: the cell resumes from its checkpoint next time
                for child in multiprocessing.active_children():
                    child.kill()
                raise
        on_change(cell, f"failed: {failed[cell]}" if cell in failed else "done")
    return failed


def run_on_cluster(scheduler: str, grid: Sequence[Cell], on_change: Callable[[Cell, str], None]) -> dict[Cell, str]:
    """Runs unfinished cells on a Dask cluster whose workers share the files; returns the error of each that failed.

    Peak memory is then that of a worker over several cells. Raises InputError if there is no cluster.
    """
    named = {cell.name: cell for cell in grid}

    def report(outcome: Outcome, line: dict[str, Any]) -> None:
        if not line:
            on_change(named[outcome.task.name], outcome.status)

    outcomes = run_grid([cell.task for cell in grid], report, lambda: False, scheduler=scheduler)
    return {named[outcome.task.name]: outcome.error for outcome in outcomes if outcome.status == "failed"}
