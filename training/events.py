"""Progress of a run: JSON lines for programs, a terminal display for people."""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from engine.errors import InputError
from engine.io.files import LineWriter, reason

__all__ = ["Reporter", "to_json"]


def N_(text: str) -> str:
    """Marks text that a window translates into its user's language; here it stays English. The name is gettext's."""
    return text


STAGES = {
    "load": N_("Reading the scene"),
    "body": N_("Finding the body"),
    "atomise": N_("Making atoms"),
    "labels": N_("Drawing the inside"),
    "refit": N_("Matching the skin"),
    "views": N_("Placing views"),
    "train": N_("Training"),
    "save": N_("Saving"),
    "cuts": N_("Drawing the cuts"),
    "measure": N_("Measuring the skin"),
    "finetune": N_("Learning the pictures"),
}
"""Title of each stage in displays, by its identifier in events."""


@dataclass
class Reporter:
    """Reports events to a stream of JSON lines, a terminal display, both or neither."""

    events: TextIO | LineWriter | None = None
    """Stream for JSON lines; None: no events."""
    display: Progress | None = None
    started: float = field(default_factory=time.perf_counter)
    timings: dict[str, float] = field(default_factory=dict)
    """Seconds spent in each stage so far."""

    @staticmethod
    def open(events: str | None, quiet: bool = False) -> Reporter:
        """Events to a path, or to standard output for '-'; a display on standard error if that is a terminal.

        Raises InputError if the events cannot be written.
        """
        stream: TextIO | LineWriter | None = None
        if events == "-":
            stream = sys.stdout
            if stream is None:  # as Python sets it if the parent process closed it
                raise InputError("--events -: standard output is closed; give a file")
        elif events is not None:
            stream = LineWriter(events)
        console = Console(stderr=True, highlight=False, markup=False, emoji=False)  # names are printed as they are
        display = Progress(
            TextColumn("{task.description:<20}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%"),
            TextColumn("{task.fields[detail]}", markup=False),
            TimeRemainingColumn(),
            console=console,
            disable=quiet or not console.is_terminal,
        )
        return Reporter(stream, display)

    def __enter__(self) -> Reporter:
        if self.display is not None:
            self.display.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.display is not None:
            self.display.stop()
        if self.events is not None and self.events is not sys.stdout:
            self.events.close()

    def emit(self, event: str, **facts: Any) -> None:
        """Writes one line: the event's name, seconds since the start, and its facts; non-finite numbers become null.

        If the reader has closed the pipe, the run continues without events. If they cannot be written, as on a full
        disk, raises InputError: otherwise the run would seem to hang to whoever follows the events.
        """
        if self.events is None:
            return
        line = {"event": event, "seconds": round(time.perf_counter() - self.started, 3), **facts}
        text = json.dumps(to_json(line), allow_nan=False) + "\n"
        try:
            self.events.write(text)
            if not isinstance(self.events, LineWriter):
                self.events.flush()
        except BrokenPipeError:
            self.events = None
        except OSError as error:
            self.events = None
            raise InputError(f"standard output: cannot be written ({reason(error)})") from error

    def stage(self, name: str) -> Stage:
        """A context manager that announces a stage, shows its progress bar and measures its time."""
        return Stage(self, name)

    def warn(self, message: str) -> None:
        """Reports a one-line warning."""
        self.emit("warning", message=message)
        if self.display is not None:
            self.display.console.print(f"warning: {message}", style="yellow", soft_wrap=True)


class Stage:
    """A running stage."""

    def __init__(self, reporter: Reporter, name: str) -> None:
        self.reporter = reporter
        self.name = name
        self.last = 0.0

    def __enter__(self) -> Stage:
        self.begin = time.perf_counter()
        self.reporter.emit("stage", stage=self.name, title=STAGES[self.name])
        if self.reporter.display is not None:
            self.task = self.reporter.display.add_task(STAGES[self.name], total=1.0, detail="")
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        seconds = time.perf_counter() - self.begin
        self.reporter.timings[self.name] = self.reporter.timings.get(self.name, 0.0) + seconds
        if self.reporter.display is not None and kind is None:
            self.reporter.display.update(self.task, completed=1.0)

    def progress(self, part: float, detail: str = "", **facts: Any) -> None:
        """Reports the completed part, range [0, 1]; without facts, at most ten events a second are written."""
        now = time.perf_counter()
        if self.reporter.display is not None:
            self.reporter.display.update(self.task, completed=part, detail=detail)
        if now - self.last < 0.1 and part < 1 and not facts:
            return
        self.last = now
        self.reporter.emit("progress", stage=self.name, part=round(part, 4), **facts)


def to_json(value: Any) -> Any:
    """A JSON-serialisable copy: infinities and NaN become None, paths become strings."""
    if isinstance(value, dict):
        return {key: to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value
