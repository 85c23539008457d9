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
    """What a method left."""

    atoms: Atoms
    path: Path
    facts: dict[str, Any]
    """Plain figures of its run."""
    show: Callable[[int, Cut], Float]
    """(H, W, 3). A cut face, over white; the number seeds whatever is random in it."""


@dataclass(frozen=True)
class Method:
    """One row of the tables."""

    title: str
    what: str
    """One sentence for the reader."""
    run: Callable[[EvaluationScene, CustomRequest, Path], MethodResult]
    competes: bool = True
    """Whether it may be best; not the bounds."""


def run_pipeline(request: CustomRequest, out: Path, pipeline: type[Pipeline] = Pipeline) -> MethodResult:
    """A run of the main job, some of its steps swapped."""
    path = pipeline(request, out, Reporter(), lambda: False).run(resume=True)
    atoms, _ = load_trained(path)
    report = json.loads(read_file(out / "report.json", RESULT_LIMIT))
    facts = {key: report[key] for key in ("surface_psnr_db", "iterations", "refinement_rounds", "ended")}
    turns = report["losses"]["section"][-3:]
    facts["section_loss"] = float(np.mean(turns)) if turns else None
    return MethodResult(atoms, path, facts, cut_renderer(atoms))


def with_pipeline(pipeline: type[Pipeline]) -> Callable[[EvaluationScene, CustomRequest, Path], MethodResult]:
    """A method that is the main job with some of its steps swapped."""
    return lambda scene, request, out: run_pipeline(request, out, pipeline)


def cut_renderer(atoms: Atoms) -> Callable[[int, Cut], Float]:
    """Cut faces as the product shows them."""
    field = KernelField(atoms)

    def show(_: int, cut: Cut) -> Float:
        return np.clip(render(atoms, cut.camera, [cut.plane], BACKGROUND, field=field).rgb, 0, 1)

    return show
