"""A scene as a task: what `fruitninja-train` does, on a worker."""

from __future__ import annotations

import io
import json
import os
import platform
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.files import Lines, claimed
from training.batch.task import Task, TaskStopped, report, should_stop
from training.checkpoint import Checkpoint
from training.events import Reporter
from training.pipeline import run
from training.request import Interrupted, Request

__all__ = ["scene_task", "train_scene"]


def scene_task(name: str, request: Request, out: Path) -> Task:
    """The task that trains a scene into the folder `out`, which every worker sees under this path."""
    fingerprint = request.fingerprint()
    arguments = {"request": request, "out": out, "fingerprint": fingerprint}
    files = (out / f"{request.scene.stem}.ply", out / "cuts.png", out / "report.json")
    return Task(name, train_scene, arguments, out / "batch.json", fingerprint, files)


def train_scene(request: Request, out: Path, fingerprint: str) -> dict[str, Any]:
    """One run, from its checkpoint where that is whole. Returns the warnings it gave; its events are kept beside it."""
    if request.fingerprint() != fingerprint:
        raise InputError(f"{request.scene}: this worker sees other files under these paths; share one folder with all")
    checkpoint = Checkpoint(out / "checkpoint", fingerprint)
    with claimed(out), closing(Lines(out / "events.jsonl")) as file:
        events = _EventStream(file)
        with Reporter(events) as reporter:
            reporter.emit("started", host=platform.node(), pid=os.getpid())
            try:
                run(request, out, reporter, is_intact(checkpoint), should_stop)
            except Interrupted as interrupted:
                raise TaskStopped(str(interrupted)) from interrupted
            except Exception as error:
                with suppress(InputError):  # what failed first is what must be known
                    reporter.emit("failed", message=str(error))
                raise
    checkpoint.clear()  # a hundred megabytes a scene; the result is what is wanted
    return {"warnings": events.warnings}


def is_intact(checkpoint: Checkpoint) -> bool:
    """Whether every stage that is kept can be gone on with: none is broken, none is another run's."""
    try:
        for path in checkpoint.folder.glob("[!.]*.safetensors"):  # a killed writer's part of a file has a dot in front
            checkpoint.load(path.stem)
    except InputError:
        return False
    return True


class _EventStream(io.StringIO):
    """Where a run's lines go: to a file that stays, and to whoever runs the grid."""

    def __init__(self, file: Lines) -> None:
        super().__init__()
        self.file = file
        self.warnings: list[str] = []

    def write(self, text: str) -> int:
        self.file.write(text)
        if text.strip():
            line = json.loads(text)
            if line["event"] == "warning":
                self.warnings.append(line["message"])
            report(line)
        return len(text)
