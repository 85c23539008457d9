"""The main job: from a hollow capture to a solid with an inside (DESIGN section 4), stage by stage.

Each stage that takes long leaves a checkpoint; a run that was stopped goes on from there with the same result.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from engine import classic, opaque
from engine.atomise import atomise
from engine.atoms import Atoms
from engine.body import Body
from engine.errors import InputError
from engine.files import atomic
from engine.fill import fill, find_body
from engine.gaussians import Gaussians
from engine.load import load
from engine.orient import detect_up
from engine.trained import Meta, save_trained
from training.checkpoint import Checkpoint
from training.contact_sheet import save_picture, save_sheet
from training.deblur import deblurred
from training.events import Reporter, Stage
from training.exemplar import ExemplarPrior
from training.families import Family
from training.losses import psnr
from training.prior import Denoises, Progress, Solves
from training.sds import distill
from training.settings import DETAILS, DetailName
from training.trainer import Losses, Trainer
from training.views import BACKGROUND, Section, sections, surface_cameras, surface_views

__all__ = ["Interrupted", "PriorName", "Request", "run"]

# A run is checkpointed this often, in seconds: a kill loses at most so much of training.
CHECKPOINT_SECONDS = 15.0

# A section agrees with its label under this loss (0.3 MSE + 0.7 (1 - SSIM)): the atoms' own blur at standard detail
# stays below it, two labels that disagree about a seed do not. The paper leaves its threshold open.
AGREEMENT = 0.12

WHITE = np.float32(1.0)

# Training has settled when a whole turn of all sections improves the mean loss by less than this part.
SETTLED = 0.01

BODY_CELLS = 128
"""Cells along the longest side of the grid on which the body is found; its depth is exact to a part of a cell."""

HELD_OUT_VIEWS = 8
"""Surface views that training never sees, for the surface figure of the report."""


PriorName = Literal["exemplar", "stable-diffusion"]


class Interrupted(Exception):
    """The user stopped the run; what was done is kept."""


@dataclass(frozen=True)
class Request:
    """Everything that decides the result of a run."""

    scene: Path
    families: tuple[Family, ...]
    detail: DetailName = "standard"
    up: tuple[float, float, float] | None = None
    """None: detected."""
    seed: int = 0
    iterations: int | None = None
    """Most iterations; None: as the detail says."""
    prior: PriorName = "exemplar"
    model: Path | None = None
    """Folder of the model that `stable-diffusion` asks."""
    midas: Path | None = None
    """Folder of a depth estimator, to be heard beside the exact depth."""
    thing: str | None = None
    """What the object is called in prompts; None: as the scene's file."""

    def fingerprint(self) -> str:
        """A name for input and settings: the same for the same result."""
        digest = hashlib.sha256()
        for path in [self.scene, *(p for family in self.families for p in family.exemplars)]:
            digest.update(path.read_bytes())
        for folder in filter(None, (self.model, self.midas)):
            for path in sorted(folder.rglob("*.safetensors")):  # gigabytes: size and time must do for their content
                digest.update(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
        digest.update(json.dumps(asdict(self), sort_keys=True, default=str).encode())
        return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Geometry:
    """What is fixed once the atoms stand."""

    gaussians: Gaussians
    atoms: Atoms
    body: Body
    up: NDArray[np.float64]


def run(request: Request, out: Path, reporter: Reporter, resume: bool, stopped: Callable[[], bool]) -> Path:
    """Does the whole job; returns the trained scene's path. Bit-equal for a request, resumed or not.

    `stopped` is asked now and then; once it says yes the run keeps what it has and raises Interrupted. Raises
    InputError for whatever the user can mend.
    """
    checkpoint = Checkpoint(out / "checkpoint", request.fingerprint())
    if not resume:
        checkpoint.clear()
    torch.set_num_threads(1)  # the kernels use the cores; torch's own threads would only wait for each other

    def check() -> None:
        if stopped():
            raise Interrupted

    prior = make_prior(request)
    detail = DETAILS[request.detail]
    geometry, counts = prepare(request, reporter, checkpoint, check)
    with reporter.stage("views") as stage:
        cuts = sections(
            geometry.atoms,
            geometry.body,
            geometry.up,
            request.families,
            detail.label,
            watched(stage, check, 0.0, 0.5),
        )
        cameras = surface_cameras(geometry.body, geometry.up, detail.surface_views, detail.surface)
        surfaces = surface_views(geometry.atoms, geometry.gaussians, cameras, watched(stage, check, 0.5, 1.0))
    labels, atoms = label(request, geometry, cuts, prior, reporter, checkpoint, check)
    trainer = Trainer(atoms, cuts, surfaces, request.seed)
    history = train(request, trainer, prior, labels, out, reporter, checkpoint, stopped)
    return save(request, geometry, trainer, counts, history, out, reporter)


def make_prior(request: Request) -> Denoises | Solves:
    """The prior that was asked for. Raises InputError where its model or its packages are missing."""
    if request.prior == "exemplar":
        return ExemplarPrior()
    if request.model is None:
        raise InputError("--prior stable-diffusion needs a model; give its local folder with --model")
    from training.diffusion import StableDiffusionPrior  # an extra, and slow to import

    return StableDiffusionPrior(request.model, request.thing or request.scene.stem, midas=request.midas)


def watched(stage: Stage, check: Callable[[], None], start: float, end: float) -> Callable[[float], None]:
    """Progress of a part of a stage, which also notices that the user wants to stop."""

    def progress(part: float) -> None:
        check()
        stage.progress(start + (end - start) * part)

    return progress


def prepare(
    request: Request, reporter: Reporter, checkpoint: Checkpoint, check: Callable[[], None]
) -> tuple[Geometry, dict[str, Any]]:
    """Reads the scene, finds the body, makes the atoms. Returns them with what the report says of them."""
    detail = DETAILS[request.detail]
    with reporter.stage("load"):
        loaded = load(request.scene, request.seed)
        for warning in loaded.warnings:
            reporter.warn(warning)
    gaussians = loaded.gaussians
    check()
    with reporter.stage("body") as stage:
        found = find_body(gaussians, max(BODY_CELLS, detail.cells), request.scene.name)
        for note in found.notes:
            reporter.warn(f"{request.scene.name}: {note}")
        up, reason = upward(request, gaussians)
        stage.progress(1.0, reason, up=up.tolist(), reason=reason)
    check()
    low, high = found.body.bounds()
    pitch = float((high - low).max()) / detail.cells
    with reporter.stage("atomise"):
        made = atomise(gaussians, pitch, found.body)
        atoms = Atoms(made.atoms, fill(found.body, pitch, request.seed, made.atoms), pitch)
    counts = {
        "gaussians": len(gaussians),
        "surface_atoms": len(atoms.surface),
        "interior_atoms": len(atoms.interior),
        "exposed_atoms": atoms.interior.exposed,
        "volume": found.body.volume,
        "pitch": pitch,
        "up": up.tolist(),
    }
    return Geometry(gaussians, atoms, found.body, up), counts


def upward(request: Request, gaussians: Gaussians) -> tuple[NDArray[np.float64], str]:
    """The unit up axis as given, or as the capture suggests, and why."""
    if request.up is not None:
        axis = np.asarray(request.up, np.float64)
        return axis / np.linalg.norm(axis), "as given"
    return detect_up(gaussians)


def label(
    request: Request,
    geometry: Geometry,
    cuts: Sequence[Section],
    prior: Denoises | Solves,
    reporter: Reporter,
    checkpoint: Checkpoint,
    check: Callable[[], None],
) -> tuple[list[Tensor], Atoms]:
    """A label for every cut, and the atoms with colours to start from."""
    atoms = geometry.atoms
    with reporter.stage("labels") as stage:
        kept = checkpoint.load("labels")
        if kept is None:
            watch = watched(stage, check, 0.0, 1.0)
            arrays = (
                solved(request, geometry, cuts, prior, watch)
                if isinstance(prior, Solves)
                else distilled(request, geometry, cuts, prior, watch)
            )
            checkpoint.save("labels", arrays, {})
        else:
            arrays = kept[0]
        stage.progress(1.0)
    interior = replace(atoms.interior, rgb=np.clip(arrays["rgb"], 0, 1))
    labels = [torch.from_numpy(picture.copy()) for picture in arrays["labels"]]
    return labels, Atoms(atoms.surface, interior, atoms.pitch)


def solved(
    request: Request, geometry: Geometry, cuts: Sequence[Section], prior: Solves, progress: Progress
) -> dict[str, NDArray[np.float32]]:
    """Labels that agree in space, because they are cuts through one volume; atoms start from its colours."""
    voxels = DETAILS[request.detail].voxels
    volume = prior.solve(geometry.body, geometry.up, request.families, voxels, request.seed, progress)
    pictures = [np.where(cut.condition.inside[..., None], volume.at(cut.points), WHITE) for cut in cuts]
    return {"labels": np.stack(pictures), "rgb": deblurred(geometry.atoms, volume)}


def distilled(
    request: Request, geometry: Geometry, cuts: Sequence[Section], prior: Denoises, progress: Progress
) -> dict[str, NDArray[np.float32]]:
    """Labels made plane by plane by score distillation, from an even grey; atoms start grey too (paper, stage one)."""
    pictures = []
    for index, cut in enumerate(cuts):
        start = np.where(cut.condition.inside[..., None], cut.condition.render, WHITE)
        rng = np.random.default_rng([request.seed, index])
        pictures.append(distill(start, prior, cut.condition, rng))
        progress((index + 1) / len(cuts))
    return {"labels": np.stack(pictures), "rgb": geometry.atoms.interior.rgb}


def train(
    request: Request,
    trainer: Trainer,
    prior: Denoises | Solves,
    labels: list[Tensor],
    out: Path,
    reporter: Reporter,
    checkpoint: Checkpoint,
    stopped: Callable[[], bool],
) -> dict[str, Any]:
    """Iterations and refinement rounds until every section agrees with its label (paper, section 3.3).

    A round ends when the loss has settled; sections that still disagree with their labels get labels refined from
    what they show, and the next round begins. Returns the history for the report.
    """
    most = DETAILS[request.detail].iterations if request.iterations is None else request.iterations
    history: dict[str, Any] = {"section": [], "surface": [], "rounds": 0, "ended": "all iterations done"}
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
        while trainer.iteration < most and history["ended"] == "all iterations done":
            if stopped():
                keep()
                raise Interrupted(f"after {trainer.iteration} iterations")
            losses = trainer.step(labels)
            history["section"].append(losses.section)
            history["surface"].append(losses.surface)
            announce(stage, trainer, losses, most)
            if settled(history["section"], trainer.turns, trainer.round_start):
                disagreeing = np.flatnonzero(trainer.section_losses(labels) > AGREEMENT)
                if not len(disagreeing) or not isinstance(prior, Denoises):
                    history["ended"] = "every section agrees with its label"
                else:
                    refine(request, trainer, prior, labels, disagreeing.tolist(), history["rounds"])
                    history["rounds"] += 1
                    trainer.round_start = trainer.iteration
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                previews(trainer, labels, out, reporter)
                keep()
                saved = time.perf_counter()
        trainer.smooth()
        previews(trainer, labels, out, reporter)
    keep()
    return history


def refine(
    request: Request, trainer: Trainer, prior: Denoises, labels: list[Tensor], which: Sequence[int], round_: int
) -> None:
    """New labels for the sections that disagree, a few steps from what they show now."""
    for index in which:
        section = trainer.sections[index]
        shown = trainer.render(section)
        rng = np.random.default_rng([request.seed, 2, round_, index])
        better = distill(shown, prior, replace(section.condition, render=shown), rng, refine=True)
        labels[index] = torch.from_numpy(better)


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


def save(
    request: Request,
    geometry: Geometry,
    trainer: Trainer,
    counts: dict[str, Any],
    history: dict[str, Any],
    out: Path,
    reporter: Reporter,
) -> Path:
    """Writes the solid, the sheet of untrained cuts and the report."""
    atoms = trainer.result()
    path = out / f"{request.scene.stem}.ply"
    with reporter.stage("save") as stage:
        families = tuple(
            {"kind": family.kind, "count": family.count, "prompt": family.prompt, "axis": family.axis}
            for family in request.families
        )
        up = (float(geometry.up[0]), float(geometry.up[1]), float(geometry.up[2]))
        save_trained(path, atoms, Meta(up, families, request.seed, request.prior, request.scene.name))
        stage.progress(0.3)
        save_sheet(out / "cuts.png", atoms, geometry.body, geometry.up)
        stage.progress(0.7)
        before, after = surface_psnr(geometry, atoms)
    report = {
        **counts,
        "sh_degree": atoms.surface.sh_degree,
        "views": {
            kind: sum(view.family.kind == kind for view in trainer.sections)
            for kind in dict.fromkeys(view.family.kind for view in trainer.sections)
        },
        "iterations": trainer.iteration,
        "rounds": history["rounds"],
        "ended": history["ended"],
        "surface_psnr_db": after,
        "surface_psnr_before_training_db": before,
        "losses": {"section": history["section"], "surface": history["surface"]},
        "seconds": {name: round(spent, 2) for name, spent in reporter.timings.items()},
    }
    with atomic(out / "report.json") as temporary:
        temporary.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    reporter.emit("done", scene=path, sheet=out / "cuts.png", report=out / "report.json")
    return path


def surface_psnr(geometry: Geometry, atoms: Atoms) -> tuple[float, float]:
    """PSNR in dB of the opaque object against the input 3DGS, before and after training, on views never trained.

    Both pictures stand on white and are whole: haze that was dropped and edges that are crisper count as errors.
    """
    size = DETAILS["standard"].surface
    before: list[float] = []
    after: list[float] = []
    for camera in surface_cameras(geometry.body, geometry.up, HELD_OUT_VIEWS, size, turn=61.0):
        target = np.clip(classic.render(geometry.gaussians, camera, BACKGROUND).rgb, 0, 1)
        for solid, figures in ((geometry.atoms, before), (atoms, after)):
            picture = opaque.render(solid, camera, background=BACKGROUND).rgb
            figures.append(psnr(np.clip(picture, 0, 1), target))
    return float(np.mean(before)), float(np.mean(after))
