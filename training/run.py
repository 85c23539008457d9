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
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.body import Body
from engine.fill import fill, find_body
from engine.gaussians import Gaussians
from engine.load import load
from engine.trained import Meta, save_trained
from training.checkpoint import Checkpoint
from training.contact_sheet import save_picture, save_sheet
from training.events import Reporter, Stage
from training.exemplar import ExemplarPrior
from training.families import Family
from training.losses import psnr
from training.prior import Condition
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

# Training has settled when a whole turn of all sections improves the mean loss by less than this part.
SETTLED = 0.01

HELD_OUT_VIEWS = 8
"""Surface views that training never sees, for the surface figure of the report."""


PriorName = Literal["exemplar"]


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

    def fingerprint(self) -> str:
        """A name for input and settings: the same for the same result."""
        digest = hashlib.sha256()
        for path in [self.scene, *(p for family in self.families for p in family.exemplars)]:
            digest.update(path.read_bytes())
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
    torch.manual_seed(request.seed)

    def check() -> None:
        if stopped():
            raise Interrupted

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
    prior = ExemplarPrior()
    labels, atoms = label(request, geometry, cuts, prior, reporter, checkpoint, check)
    trainer = Trainer(atoms, cuts, surfaces, request.seed)
    history = train(request, trainer, prior, labels, out, reporter, checkpoint, stopped)
    return save(request, geometry, trainer, cuts, counts, history, out, reporter)


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
        found = find_body(gaussians, cells=detail.cells)
        for warning in found.warnings:
            reporter.warn(f"{request.scene}: {warning}")
        up, reason = upward(request, gaussians)
        stage.progress(1.0, reason, up=up.tolist(), reason=reason)
    check()
    low, high = found.body.bounds()
    pitch = float((high - low).max()) / detail.cells
    with reporter.stage("atomise"):
        made = atomise(gaussians, pitch, found.body)
        atoms = Atoms(made.atoms, fill(found.body, pitch, request.seed), pitch)
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
    prior: ExemplarPrior,
    reporter: Reporter,
    checkpoint: Checkpoint,
    check: Callable[[], None],
) -> tuple[list[Tensor], Atoms]:
    """A label for every cut, and the atoms with colours to start from."""
    atoms = geometry.atoms
    with reporter.stage("labels") as stage:
        kept = checkpoint.load("labels")
        if kept is None:
            volume = prior.solve(
                geometry.body,
                geometry.up,
                request.families,
                DETAILS[request.detail].voxels,
                request.seed,
                watched(stage, check, 0.0, 1.0),
            )
            pictures = [
                np.where(cut.condition.inside[..., None], volume.at(cut.points), np.float32(1.0)) for cut in cuts
            ]
            arrays = {"labels": np.stack(pictures), "rgb": volume.at(atoms.interior.means)}
            checkpoint.save("labels", arrays, {})
        else:
            arrays = kept[0]
        stage.progress(1.0)
    interior = replace(atoms.interior, rgb=np.clip(arrays["rgb"], 0, 1))
    labels = [torch.from_numpy(picture.copy()) for picture in arrays["labels"]]
    return labels, Atoms(atoms.surface, interior, atoms.pitch)
