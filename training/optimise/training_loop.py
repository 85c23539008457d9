"""Alternates training and label refinement until every section agrees with its label (paper, section 3.3)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from engine.io.picture_file import save_png
from training.checkpoint import CHECKPOINT_SECONDS, Checkpoint
from training.events import Reporter, Stage
from training.labels import refine_labels
from training.optimise.trainer import Losses, Trainer
from training.priors.prior import Denoiser, VolumeSolver
from training.request import Interrupted, Request
from training.views import Slice

__all__ = ["previewed", "save_previews", "train"]

# Loss (0.3 MSE + 0.7 (1 - SSIM)) below which a section agrees with its label: the blur of atoms at standard detail
# stays below it, two labels that disagree about a seed do not. The paper gives no threshold.
MAX_SECTION_LOSS = 0.12

# Training has settled when an epoch (every section once) improves the mean loss by less than this share.
MIN_IMPROVEMENT = 0.01

ALL_DONE = "all iterations done"


def train(
    request: Request,
    trainer: Trainer,
    prior: Denoiser | VolumeSolver | None,
    labels: list[Tensor],
    out: Path,
    reporter: Reporter,
    checkpoint: Checkpoint,
    stopped: Callable[[], bool],
) -> dict[str, Any]:
    """Trains in rounds, refining `labels` in place between them; returns the history of losses for the report.

    A round ends when the loss has settled. Sections that still disagree with their labels then get labels refined from
    their render, and the next round begins. There is only one round without a denoising prior, and with one that
    solves a volume. Raises Interrupted, after saving a checkpoint, once `stopped` returns True.
    """
    limit = request.fineness.iterations if request.iterations is None else request.iterations
    history: dict[str, Any] = {"section": [], "surface": [], "disagreeing": [], "ended": ALL_DONE}
    loaded = checkpoint.load("training")
    if loaded is not None:
        arrays, history = loaded
        labels[:] = [torch.from_numpy(picture) for picture in arrays.pop("labels")]
        trainer.restore(arrays, len(history["section"]), history.pop("round_start"))
    last_save = time.perf_counter()

    def save_checkpoint() -> None:
        stacked = np.stack([picture.numpy() for picture in labels]) if labels else np.zeros((0, 1, 1, 3), np.float32)
        checkpoint.save(
            "training", trainer.state() | {"labels": stacked}, history | {"round_start": trainer.round_start}
        )

    with reporter.stage("train") as stage:
        while trainer.iteration < limit and history["ended"] == ALL_DONE:
            if stopped():
                save_checkpoint()
                raise Interrupted(f"after {trainer.iteration} iterations")
            losses = trainer.step(labels)
            history["section"].append(losses.section)
            history["surface"].append(losses.surface)
            report_step(stage, trainer, losses, limit)
            if has_settled(history["section"], trainer.steps_per_epoch, trainer.round_start):
                disagreeing = np.flatnonzero(trainer.section_losses(labels) > MAX_SECTION_LOSS).tolist()
                if not disagreeing:
                    history["ended"] = "every section agrees with its label"
                elif not isinstance(prior, Denoiser) or isinstance(prior, VolumeSolver):
                    # Labels from one volume are consistent: finer atoms would help, other labels would not.
                    history["ended"] = f"settled; {len(disagreeing)} sections disagree with their labels"
                elif history["disagreeing"] and len(disagreeing) >= history["disagreeing"][-1]:
                    history["ended"] = (
                        f"agreement no longer grows; {len(disagreeing)} sections disagree with their labels"
                    )
                else:
                    refine_labels(request, trainer, prior, labels, disagreeing, len(history["disagreeing"]))
                    history["disagreeing"].append(len(disagreeing))
                    trainer.round_start = trainer.iteration
            if time.perf_counter() - last_save > CHECKPOINT_SECONDS:
                save_previews(trainer, labels, out, reporter)
                save_checkpoint()
                last_save = time.perf_counter()
        trainer.smooth()
        save_previews(trainer, labels, out, reporter)
    save_checkpoint()
    return history


def has_settled(losses: Sequence[float], epoch: int, start: int) -> bool:
    """Whether the last epoch improved the mean loss by less than MIN_IMPROVEMENT over the one before.

    True at the end of an epoch only, and not before the second epoch of the round that began at iteration `start`.
    """
    done = len(losses) - start
    if done < 2 * epoch or done % epoch:
        return False
    last, before = np.mean(losses[-epoch:]), np.mean(losses[-2 * epoch : -epoch])
    return bool(last > (1 - MIN_IMPROVEMENT) * before)


def report_step(stage: Stage, trainer: Trainer, losses: Losses, limit: int) -> None:
    """Reports one iteration."""
    stage.progress(
        trainer.iteration / limit,
        f"{trainer.iteration}/{limit}  sections {losses.section:.4f}  surface {losses.surface:.4f}",
        iteration=trainer.iteration,
        iterations=limit,
        losses={"section": losses.section, "surface": losses.surface},
    )


def previewed(views: Sequence[Slice]) -> list[int]:
    """Numbers of the views that previews show: two of each family."""
    shown = []
    for kind in dict.fromkeys(view.family.kind for view in views):
        indices = [index for index, view in enumerate(views) if view.family.kind == kind]
        shown += sorted({indices[len(indices) // 4], indices[len(indices) // 2]})
    return shown


def save_previews(trainer: Trainer, labels: Sequence[Tensor], out: Path, reporter: Reporter) -> None:
    """Writes labels beside their renders."""
    paths = []
    for index in previewed(trainer.sections):
        section = trainer.sections[index]
        pair = np.concatenate([labels[index].numpy(), trainer.render(section)], axis=1)
        path = out / "previews" / f"{section.family.kind}_{index:03d}.png"
        save_png(path, pair)
        paths.append(path)
    reporter.emit("previews", paths=paths)
