"""`fruitninja-batch`: the main job for all scenes of a manifest."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from engine.command import FAILED, REFUSED, Stop, Stopped, print_result, run_command
from engine.errors import InputError
from engine.io.files import locked_folder, write_json
from training.batch.grid import Outcome, run_grid
from training.batch.manifest import ManifestErrors, read_manifest
from training.batch.scene import scene_task
from training.batch.task import Task
from training.settings import DetailName

__all__ = ["main"]

GIGABYTES_PER_RUN: dict[DetailName, float] = {"draft": 1.2, "standard": 2.3, "high": 3.2}
"""Memory of one run with a margin: scans peak at 0.9 in draft, 1.9 in standard and 2.4 in high. It limits how many
run on this machine at once."""


def batch(
    manifest: Annotated[Path, typer.Argument(help="Scenes and their options in TOML.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results, one folder for each scene.")],
    scheduler: Annotated[
        str | None, typer.Option(help="A running Dask cluster, as tcp://host:8786. Its workers share these files.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Scenes at once on this machine; chosen if not given.")
    ] = None,
) -> None:
    """Give every capture of a manifest an inside. Run again, the same command resumes where this one ended."""
    stop = Stop()
    if scheduler is not None and workers is not None:
        raise InputError("--workers is for this machine; a cluster at --scheduler has its own, leave one of them out")
    try:
        scenes = read_manifest(manifest)
    except ManifestErrors as errors:
        print(errors, file=sys.stderr)
        raise typer.Exit(REFUSED) from errors
    out = out.absolute()
    tasks = [scene_task(scene.name, scene.request, out / scene.name) for scene in scenes]
    gigabytes = max(GIGABYTES_PER_RUN[scene.request.detail] for scene in scenes)
    summary = Summary(out / "batch.json", manifest)
    stop.listen()
    with locked_folder(out), ProgressDisplay(tasks) as display:
        summary.write(())  # fails now, rather than after hours, if it cannot be written
        outcomes_by_name = {task.name: Outcome(task) for task in tasks}

        def on_change(outcome: Outcome, event: dict[str, Any]) -> None:
            outcomes_by_name[outcome.task.name] = outcome
            display.update(outcome, event)
            if not event:
                summary.write(outcomes_by_name.values())

        outcomes = run_grid(tasks, on_change, stop.requested, scheduler=scheduler, count=workers, gigabytes=gigabytes)
    for outcome in outcomes:
        if outcome.status == "failed":
            print(f"fruitninja-batch: {outcome.task.name}: {outcome.error}", file=sys.stderr)
    print_result(str(out / "batch.json"))
    if any(outcome.status == "stopped" for outcome in outcomes):
        raise Stopped(stop.number, "stopped; the same command goes on")
    if any(outcome.status == "failed" for outcome in outcomes):
        raise typer.Exit(FAILED)


class Summary:
    """The file with the outcome of every scene of a batch."""

    def __init__(self, path: Path, manifest: Path) -> None:
        self.path = path
        self.manifest = manifest
        self.begun = time.monotonic()

    def write(self, outcomes: Iterable[Outcome]) -> None:
        """Writes the file atomically. Raises InputError if that fails."""
        outcomes = list(outcomes)
        statuses = [outcome.status for outcome in outcomes]
        record = {
            "manifest": str(self.manifest),
            "seconds": round(time.monotonic() - self.begun, 1),
            "counts": {status: statuses.count(status) for status in dict.fromkeys(statuses)},
            "scenes": [
                {
                    "name": outcome.task.name,
                    "status": outcome.status,
                    "attempts": outcome.attempts,
                    "seconds": round(outcome.seconds, 1),
                    "result": str(outcome.task.files[0]) if outcome.status in ("done", "kept") else None,
                    "warnings": outcome.facts.get("warnings", []),
                    "error": outcome.error or None,
                }
                for outcome in outcomes
            ],
        }
        write_json(self.path, record)


class ProgressDisplay:
    """Progress bars for the batch and each running scene; plain lines without a terminal."""

    def __init__(self, tasks: list[Task]) -> None:
        self.console = Console(stderr=True)
        self.total = len(tasks)
        self.ended = 0
        self.bars: dict[str, TaskID] = {}
        self.titles: dict[str, str] = {}
        self.progress = Progress(
            TextColumn("{task.description:<24}"),
            BarColumn(),
            TextColumn("{task.fields[detail]}"),
            TimeElapsedColumn(),
            console=self.console,
            disable=not self.console.is_terminal,
        )

    def __enter__(self) -> ProgressDisplay:
        self.progress.start()
        self.all = self.progress.add_task("All scenes", total=self.total, detail=f"0 of {self.total}")
        return self

    def __exit__(self, *_: object) -> None:
        self.progress.stop()

    def update(self, outcome: Outcome, event: dict[str, Any]) -> None:
        """Shows a new status, or an event of a running scene."""
        name = outcome.task.name
        if event:
            self.titles[name] = event.get("title") or self.titles.get(name, "")
            self.progress.update(self.bars[name], completed=event.get("part", 0.0), detail=self.titles[name])
            return
        if outcome.status == "running":
            self.bars[name] = self.progress.add_task(name, total=1.0, detail="Starting")
            return
        if name in self.bars:
            self.progress.remove_task(self.bars.pop(name))
        if outcome.status == "waiting":
            self.print_line(f"{name}: {outcome.error}; trying once more")
            return
        self.ended += 1
        self.progress.update(self.all, completed=self.ended, detail=f"{self.ended} of {self.total}")
        words = {
            "done": f"done in {outcome.seconds:.0f} s",
            "kept": "done before",
            "failed": f"failed: {outcome.error}",
        }
        self.print_line(f"{name}: {words.get(outcome.status, outcome.status)} ({self.ended} of {self.total})")

    def print_line(self, text: str) -> None:
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)


def main() -> None:
    """Entry point: status 2 and one clear line for each mistake in the manifest, 1 if a scene failed, 130 or 143
    if the user stopped it."""
    run_command("fruitninja-batch", batch)


if __name__ == "__main__":
    main()
