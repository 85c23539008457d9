"""The state of a training job, gathered from the event lines that the trainer writes."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from app.translation import _
from engine.errors import one_line

__all__ = ["STAGE_WEIGHTS", "Progress", "read_line"]

# Fraction of a run's time that each stage takes, for one progress bar over all stages: means of 8 runs at standard
# detail, of scanned fruit with photographs. These train nothing; with a diffusion model labels take nearly all.
STAGE_WEIGHTS = {
    "load": 0.01,
    "body": 0.03,
    "atomise": 0.05,
    "labels": 0.56,
    "refit": 0.24,
    "views": 0.005,
    "train": 0.005,
    "save": 0.02,
    "cuts": 0.06,
    "measure": 0.02,
}

MOST = 1000
"""Most warnings of a job, and most pictures of one event, that are read; a real job has a few."""

LAST_ITERATION = 10_000_000
"""Largest iteration number that is accepted; a real run has hundreds."""

LEAST_DONE = 0.05
"""Part of a run from whose time that of the rest is estimated."""

LONGEST_GAP = 100_000
"""Most missing iterations that a curve is padded for: a file that skips further would fill the memory."""


@dataclass
class Progress:
    """How far a job has come. `read_line` updates it.

    Event files may come from anybody: control characters are removed from texts, and only files inside the job's folder
    are accepted.
    """

    folder: Path = Path()
    """The job's result folder."""
    stage: str = ""
    """Name of the stage in the events."""
    title: str = field(default_factory=lambda: _("Starting"))
    """Name of the stage, in the user's language."""
    stage_fraction: float = 0.0
    """Part of the stage that is done. Range [0, 1]."""
    fraction: float = 0.0
    """Part of the run that is done. Range [0, 1]; never falls."""
    begun: float = 0.0
    """Part that was done when the process began: more than nothing if it goes on with an earlier run."""
    seconds: float = 0.0
    """Seconds since the process began."""
    paused: float = 0.0
    """Seconds of these in which it was suspended."""
    remaining: float | None = None
    """Estimated seconds to the end; None while there is no estimate."""
    iteration: int = 0
    iterations: int = 0
    section: list[float] = field(default_factory=list)
    """Loss of the cut faces, one number per iteration; NaN for iterations without one."""
    surface: list[float] = field(default_factory=list)
    """Loss of the surface, likewise."""
    previews: tuple[Path, ...] = ()
    """Pictures, each of a label beside the object's cut face in the same plane."""
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None
    """The finished scene."""
    report: Path | None = None

    def resumed(self) -> Progress:
        """The progress that a run resumed from a checkpoint starts with: curves and pictures stay."""
        return Progress(
            folder=self.folder,
            section=self.section,
            surface=self.surface,
            previews=self.previews,
            fraction=self.fraction,
            begun=self.fraction,
        )


def read_line(progress: Progress, line: bytes) -> None:
    """Applies one event. A line that is not an event (cut short by a crash, or from a later version) is ignored."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return
    if not isinstance(event, dict):
        return
    seconds = _number(event.get("seconds"), progress.seconds)
    if seconds < progress.seconds:  # a process that goes on where an earlier one was stopped
        progress.begun, progress.paused, progress.remaining = progress.fraction, 0.0, None
    progress.seconds = seconds
    kind = event.get("event")
    if kind == "stage" and isinstance(event.get("stage"), str):
        progress.stage = event["stage"]
        title = one_line(str(event.get("title") or progress.stage))
        progress.title = _(title) if title else title  # for an empty text gettext returns the catalogue's header
        progress.stage_fraction = 0.0
        _advance(progress)
    elif kind == "progress":
        progress.stage_fraction = min(1.0, max(0.0, _number(event.get("part"), progress.stage_fraction)))
        _advance(progress)
        _losses(progress, event)
    elif kind == "previews" and isinstance(event.get("paths"), list):
        paths = [_file_of(progress, path) for path in event["paths"][:MOST]]
        progress.previews = tuple(path for path in paths if path is not None)
    elif kind == "warning" and len(progress.warnings) < MOST:
        progress.warnings.append(one_line(str(event.get("message", ""))))
    elif kind == "done" and (result := _file_of(progress, event.get("scene"))) is not None:
        progress.result, progress.report = result, _file_of(progress, event.get("report"))
        progress.fraction, progress.remaining = 1.0, 0.0


def _advance(progress: Progress) -> None:
    """Updates the fraction of the run and the time that remains: as much for each part as the parts before it took."""
    names = list(STAGE_WEIGHTS)
    if progress.stage not in STAGE_WEIGHTS:
        return
    before = sum(STAGE_WEIGHTS[name] for name in names[: names.index(progress.stage)])
    progress.fraction = max(progress.fraction, before + STAGE_WEIGHTS[progress.stage] * progress.stage_fraction)
    done = progress.fraction - progress.begun
    if done >= LEAST_DONE:
        progress.remaining = max(progress.seconds - progress.paused, 0) * (1 - progress.fraction) / done


def _losses(progress: Progress, event: dict[str, Any]) -> None:
    """Adds one iteration's losses; iterations that are repeated after a resume replace earlier ones."""
    losses, iteration = event.get("losses"), event.get("iteration")
    if not isinstance(losses, dict) or type(iteration) is not int or not 0 < iteration <= LAST_ITERATION:
        return
    progress.iteration = iteration
    if type(event.get("iterations")) is int:
        progress.iterations = event["iterations"]
    for curve, name in ((progress.section, "section"), (progress.surface, "surface")):
        del curve[iteration - 1 :]
        if iteration - 1 - len(curve) > LONGEST_GAP:
            return
        curve.extend([math.nan] * (iteration - 1 - len(curve)))
        curve.append(_number(losses.get(name), math.nan))


def _file_of(progress: Progress, name: Any) -> Path | None:
    """The path of this name; None if it leads out of the job's folder."""
    if not isinstance(name, str) or "\0" in name:
        return None
    path = Path(os.path.normpath(progress.folder / name))
    return path if path.is_relative_to(progress.folder) else None


def _number(value: Any, fallback: float) -> float:
    """The value if it is a finite number, else the fallback."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:  # false for NaN
        return float(value)
    return fallback
