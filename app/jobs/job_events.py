"""What the trainer's event lines add up to: where the job is and what it has shown so far."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from engine.errors import one_line

__all__ = ["Progress", "read_line"]

# Parts of the whole time that the stages take, for one bar over all of them; measured at standard detail.
WEIGHTS = {
    "load": 0.01,
    "body": 0.03,
    "atomise": 0.03,
    "labels": 0.36,
    "refit": 0.3,
    "views": 0.07,
    "train": 0.12,
    "save": 0.08,
}


MOST = 1000
"""Warnings, and pictures of one line, that are kept; a real job has a few."""


@dataclass
class Progress:
    """Grows with each line. Lines come from a file in a folder, so they may be anybody's: texts are made plain, and
    only files of that folder are named."""

    folder: Path = Path()
    """Where the job's results are."""
    stage: str = ""
    title: str = "Starting"
    """Name of the stage for people."""
    part: float = 0.0
    """Of the stage. Range [0, 1]."""
    whole: float = 0.0
    """Of the run. Range [0, 1]; never falls."""
    seconds: float = 0.0
    """Since the run began."""
    left: float | None = None
    """Seconds to the end, as far as can be told."""
    iteration: int = 0
    iterations: int = 0
    section: list[float] = field(default_factory=list)
    """Loss of the cut faces, one number per iteration; NaN where it was not told."""
    surface: list[float] = field(default_factory=list)
    previews: tuple[Path, ...] = ()
    """Pictures of labels, each beside what the object shows there."""
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None
    """The finished scene."""
    report: Path | None = None
    lines: int = 0
    """Lines read, broken ones included."""

    def again(self) -> Progress:
        """For a run that goes on from a checkpoint: curves and pictures stay, the rest begins anew."""
        return Progress(
            folder=self.folder,
            section=self.section,
            surface=self.surface,
            previews=self.previews,
            whole=self.whole,
            lines=self.lines,
        )


def read_line(progress: Progress, line: bytes) -> None:
    """Adds one event. A line that is no event (cut short by a crash, or of a later version) changes nothing."""
    progress.lines += 1
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return
    if not isinstance(event, dict):
        return
    progress.seconds = _number(event.get("seconds"), progress.seconds)
    kind = event.get("event")
    if kind == "stage" and isinstance(event.get("stage"), str):
        progress.stage = event["stage"]
        progress.title = one_line(str(event.get("title") or progress.stage))
        progress.part = 0.0
        _advance(progress, None)
    elif kind == "progress":
        progress.part = min(1.0, max(0.0, _number(event.get("part"), progress.part)))
        _advance(progress, event.get("eta"))
        _losses(progress, event)
    elif kind == "previews" and isinstance(event.get("paths"), list):
        paths = [_own(progress, path) for path in event["paths"][:MOST]]
        progress.previews = tuple(path for path in paths if path is not None)
    elif kind == "warning" and len(progress.warnings) < MOST:
        progress.warnings.append(one_line(str(event.get("message", ""))))
    elif kind == "done" and (result := _own(progress, event.get("scene"))) is not None:
        progress.result, progress.report = result, _own(progress, event.get("report"))
        progress.whole, progress.left = 1.0, 0.0


def _advance(progress: Progress, eta: Any) -> None:
    """The bar over all stages, and the time that is left by what was done so far."""
    names = list(WEIGHTS)
    if progress.stage not in WEIGHTS:
        return
    before = sum(WEIGHTS[name] for name in names[: names.index(progress.stage)])
    progress.whole = max(progress.whole, before + WEIGHTS[progress.stage] * progress.part)
    stage_left = _number(eta, math.nan)
    after = 1 - before - WEIGHTS[progress.stage]
    if math.isfinite(stage_left):
        # The stages to come take their part of the time as this one does.
        total = stage_left / max(1 - progress.part, 1e-3)
        progress.left = stage_left + total * after / WEIGHTS[progress.stage]


def _losses(progress: Progress, event: dict[str, Any]) -> None:
    """One iteration's losses; after a resume some iterations come again and take the place of the first."""
    losses, iteration = event.get("losses"), event.get("iteration")
    if not isinstance(losses, dict) or type(iteration) is not int or not 0 < iteration <= 10_000_000:
        return
    progress.iteration = iteration
    if type(event.get("iterations")) is int:
        progress.iterations = event["iterations"]
    for curve, name in ((progress.section, "section"), (progress.surface, "surface")):
        del curve[iteration - 1 :]
        if iteration - 1 - len(curve) > 100_000:
            return
        curve.extend([math.nan] * (iteration - 1 - len(curve)))
        curve.append(_number(losses.get(name), math.nan))


def _own(progress: Progress, name: Any) -> Path | None:
    """The file of this name, if it stands in the job's folder."""
    if not isinstance(name, str) or "\0" in name:
        return None
    path = Path(os.path.normpath(progress.folder / name))
    return path if path.is_relative_to(progress.folder) else None


def _number(value: Any, fallback: float) -> float:
    """The value if it is a finite number."""
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:  # false for NaN
        return float(value)
    return fallback
