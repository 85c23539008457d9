"""Training of a scene as a task for a worker."""

from __future__ import annotations

import io
import json
import os
import platform
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.files import LineWriter, locked_folder
from training.batch.task import Task, TaskStopped, report, should_stop
from training.checkpoint import Checkpoint
from training.events import Reporter
from training.request import Interrupted, Request

__all__ = ["scene_task", "train_scene"]


def scene_task(name: str, request: Request, out: Path) -> Task:
    """The task that trains a scene into the folder `out`, a path valid on every worker."""
    fingerprint = request.fingerprint()
    arguments = {"request": request, "out": out, "fingerprint": fingerprint}
    files = (out / request.result_name, out / "cuts.png", out / "report.json")
    return Task(name, train_scene, arguments, out / "batch.json", fingerprint, files)


def train_scene(request: Request, out: Path, fingerprint: str) -> dict[str, Any]:
    """Trains a scene, from its checkpoint if that is intact; returns its warnings and writes its events beside it."""
    from training.pipeline import run  # takes seconds, which the command that only hands out scenes need not wait for

    if request.fingerprint() != fingerprint:
        raise InputError(f"{request.scene}: this worker sees other files under these paths; share one folder with all")
    checkpoint = Checkpoint(out / "checkpoint", fingerprint)
    with locked_folder(out), closing(LineWriter(out / "events.jsonl")) as file:
        events = _EventStream(file)
        with Reporter(events) as reporter:
            reporter.emit("started", host=platform.node(), pid=os.getpid())
            try:
                run(request, out, reporter, is_intact(checkpoint), should_stop)
            except Interrupted as interrupted:
                raise TaskStopped(str(interrupted)) from interrupted
            except Exception as error:
                with suppress(InputError):  # the first error is the one to report
                    reporter.emit("failed", message=str(error))
                raise
    checkpoint.clear()  # a hundred megabytes per scene, of no use once it is done
    return {"warnings": events.warnings}


def is_intact(checkpoint: Checkpoint) -> bool:
    """Whether the run can resume: no stage is damaged or belongs to another run."""
    try:
        for path in checkpoint.folder.glob("[!.]*.safetensors"):  # partial files of a killed writer start with a dot
            checkpoint.load(path.stem)
    except InputError:
        return False
    return True


class _EventStream(io.StringIO):
    """A text stream that passes events to a file and to `run_grid`, and collects warnings."""

    def __init__(self, file: LineWriter) -> None:
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
