"""Rounds of training and refinement, down to a stated criterion (paper, section 3.3)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from training.checkpoint import Checkpoint
from training.contact_sheet import save_picture
from training.events import Reporter, Stage
from training.labels import refine
from training.optimise.trainer import Losses, Trainer
from training.priors.prior import Denoises, Solves
from training.request import Interrupted, Request

__all__ = ["train"]

# A run is checkpointed this often, in seconds: a kill loses at most so much of training.
CHECKPOINT_SECONDS = 15.0

# A section agrees with its label under this loss (0.3 MSE + 0.7 (1 - SSIM)): the atoms' own blur at standard detail
# stays below it, two labels that disagree about a seed do not. The paper leaves its threshold open.
AGREEMENT = 0.12

# Training has settled when a whole turn of all sections improves the mean loss by less than this part.
SETTLED = 0.01

DONE = "all iterations done"


def train(
    request: Request,
    trainer: Trainer,
    prior: Denoises | Solves | None,
    labels: list[Tensor],
    out: Path,
    reporter: Reporter,
    checkpoint: Checkpoint,
    stopped: Callable[[], bool],
) -> dict[str, Any]:
    """Iterations and refinement rounds until every section agrees with its label (paper, section 3.3).

    A round ends when the loss has settled; sections that still disagree with their labels get labels refined from
    what they show, and the next round begins; none begins without a prior that denoises, nor after one that solved.
    Returns the history for the report.
    """
    most = request.fineness.iterations if request.iterations is None else request.iterations
    history: dict[str, Any] = {"section": [], "surface": [], "disagreeing": [], "ended": DONE}
    kept = checkpoint.load("training")
    if kept is not None:
        arrays, history = kept
        labels[:] = [torch.from_numpy(picture) for picture in arrays.pop("labels")]
        trainer.restore(arrays, len(history["section"]), history.pop("round_start"))
    saved = time.perf_counter()

    def keep() -> None:
        stacked = np.stack([picture.numpy() for picture in labels]) if labels else np.zeros((0, 1, 1, 3), np.float32)
        checkpoint.save(
            "training", trainer.state() | {"labels": stacked}, history | {"round_start": trainer.round_start}
        )

    with reporter.stage("train") as stage:
        while trainer.iteration < most and history["ended"] == DONE:
            if stopped():
                keep()
                raise Interrupted(f"after {trainer.iteration} iterations")
            losses = trainer.step(labels)
            history["section"].append(losses.section)
            history["surface"].append(losses.surface)
            announce(stage, trainer, losses, most)
            if settled(history["section"], trainer.turns, trainer.round_start):
                wrong = np.flatnonzero(trainer.section_losses(labels) > AGREEMENT).tolist()
                if not wrong:
                    history["ended"] = "every section agrees with its label"
                elif not isinstance(prior, Denoises) or isinstance(prior, Solves):
                    # Labels from one volume agree as they are: what is missing is finer atoms, not other labels.
                    history["ended"] = f"settled; {len(wrong)} sections disagree with their labels"
                elif history["disagreeing"] and len(wrong) >= history["disagreeing"][-1]:
                    history["ended"] = f"agreement no longer grows; {len(wrong)} sections disagree with their labels"
                else:
                    refine(request, trainer, prior, labels, wrong, len(history["disagreeing"]))
                    history["disagreeing"].append(len(wrong))
                    trainer.round_start = trainer.iteration
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                previews(trainer, labels, out, reporter)
                keep()
                saved = time.perf_counter()
        trainer.smooth()
        previews(trainer, labels, out, reporter)
    keep()
    return history


def settled(losses: Sequence[float], turn: int, start: int) -> bool:
    """Whether the last turn of all sections improved the mean loss by less than a hundredth over the one before.

    Asked at the end of a turn only, and not before the round that began at `start` has had two.
    """
    done = len(losses) - start
    if done < 2 * turn or done % turn:
        return False
    last, before = np.mean(losses[-turn:]), np.mean(losses[-2 * turn : -turn])
    return bool(last > (1 - SETTLED) * before)


def announce(stage: Stage, trainer: Trainer, losses: Losses, most: int) -> None:
    """One iteration's line."""
    stage.progress(
        trainer.iteration / most,
        f"{trainer.iteration}/{most}  sections {losses.section:.4f}  surface {losses.surface:.4f}",
        iteration=trainer.iteration,
        iterations=most,
        losses={"section": losses.section, "surface": losses.surface},
    )


def previews(trainer: Trainer, labels: Sequence[Tensor], out: Path, reporter: Reporter) -> None:
    """A label and what the atoms show of it, for the first, middle and last plane of each family."""
    paths = []
    for kind in dict.fromkeys(view.family.kind for view in trainer.sections):
        mine = [index for index, view in enumerate(trainer.sections) if view.family.kind == kind]
        for index in sorted({mine[len(mine) // 4], mine[len(mine) // 2]}):
            both = np.concatenate([labels[index].numpy(), trainer.render(trainer.sections[index])], axis=1)
            path = out / "previews" / f"{kind}_{index:03d}.png"
            save_picture(path, both)
            paths.append(path)
    reporter.emit("previews", paths=paths)
