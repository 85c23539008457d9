"""What the evaluation compares: a method, its result on a scene, and runs of the training pipeline as methods."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.io.files import read_file
from engine.io.trained import load_trained
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render
from engine.scene.atoms import Atoms
from training.batch.task import RESULT_LIMIT
from training.evaluate.cuts import Cut
from training.evaluate.scenes import CustomRequest, EvaluationScene
from training.events import Reporter
from training.pipeline import Pipeline
from training.views import BACKGROUND

__all__ = ["Method", "MethodResult", "cut_renderer", "run_pipeline", "with_pipeline"]

Float = NDArray[np.float32]


@dataclass(frozen=True)
class MethodResult:
    """The result of a method on a scene."""

    atoms: Atoms
    path: Path
    facts: dict[str, Any]
    """JSON facts of its run."""
    show: Callable[[int, Cut], Float]
    """Renders a cut face (H, W, 3) over white; the number seeds any randomness."""


@dataclass(frozen=True)
class Method:
    """A method that is compared: one row of the tables."""

    title: str
    what: str
    """One sentence for the reader."""
    run: Callable[[EvaluationScene, CustomRequest, Path], MethodResult]
    competes: bool = True
    """Whether it is ranked; upper bounds are not."""


def run_pipeline(request: CustomRequest, out: Path, pipeline: type[Pipeline] = Pipeline) -> MethodResult:
    """Trains with a pipeline, resuming an earlier run."""
    path = pipeline(request, out, Reporter(), lambda: False).run(resume=True)
    atoms, _ = load_trained(path)
    report = json.loads(read_file(out / "report.json", RESULT_LIMIT))
    facts = {key: report[key] for key in ("surface_psnr_db", "iterations", "refinement_rounds", "ended")}
    last_losses = report["losses"]["section"][-3:]
    facts["section_loss"] = float(np.mean(last_losses)) if last_losses else None
    return MethodResult(atoms, path, facts, cut_renderer(atoms))


def with_pipeline(pipeline: type[Pipeline]) -> Callable[[EvaluationScene, CustomRequest, Path], MethodResult]:
    """A method that trains with a pipeline."""
    return lambda scene, request, out: run_pipeline(request, out, pipeline)


def cut_renderer(atoms: Atoms) -> Callable[[int, Cut], Float]:
    """A function for `MethodResult.show` that renders cut faces as the product does."""
    field = KernelField(atoms)

    def show(_: int, cut: Cut) -> Float:
        return np.clip(render(atoms, cut.camera, [cut.plane], BACKGROUND, field=field).rgb, 0, 1)

    return show
