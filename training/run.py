"""The main job: from a hollow capture to a solid with an inside (DESIGN section 4), stage by stage.

Each stage that takes long leaves a checkpoint; a run that was stopped goes on from there with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from engine.atoms import Atoms, InteriorAtoms
from engine.errors import InputError
from engine.files import sweep
from engine.fill import fill
from engine.gaussians import Gaussians
from engine.load import load
from engine.orient import detect_up
from engine.reshape import reshape
from engine.solidify import enclosed, solidify
from engine.surface_fit import SurfaceView, refit, surface_views
from training.checkpoint import Checkpoint
from training.events import Reporter, Stage
from training.fit import train
from training.labels import label, make_prior
from training.outcome import save
from training.prior import Denoises, Solves
from training.request import Geometry, Interrupted, Request
from training.sds import Form
from training.smoothing import Smoothing, smooth
from training.trainer import Trainer
from training.views import ENTRIES, sections, slices, surface_cameras

__all__ = ["Parts", "prepare", "refitted", "run"]


SHAPE_VIEWS, SHAPE_SIZE = 24, 256
"""Views in which sizes are fitted: coarser pixels would not tell them apart."""


@dataclass(frozen=True)
class Parts:
    """What a run is put together from. An evaluation swaps a part to see what it is good for; users never do."""

    prior: Callable[[Request], Denoises | Solves] = make_prior
    """Makes the prior that draws the labels."""
    trainer: type[Trainer] = Trainer
    refines: bool = True
    """Whether sections that disagree with their labels get new ones."""
    fill: Callable[..., InteriorAtoms] = fill
    """Makes the interior atoms from the labels' colours, as engine.fill.fill does."""
    form: Form = "x0"
    """How the labels follow a prior that only denoises (training.sds)."""
    smoothing: Smoothing = smooth
    """Colours the atoms that no label shows."""


def run(
    request: Request,
    out: Path,
    reporter: Reporter,
    resume: bool,
    stopped: Callable[[], bool],
    parts: Parts = Parts(),
) -> Path:
    """Does the whole job; returns the trained scene's path. Bit-equal for a request, resumed or not.

    `stopped` is asked now and then; once it says yes the run keeps what it has and raises Interrupted. Raises
    InputError for whatever the user can mend.
    """
    checkpoint = Checkpoint(out / "checkpoint", request.fingerprint())
    sweep(out)
    if not resume:
        checkpoint.clear()
    torch.set_num_threads(1)  # the kernels use the cores; torch's own threads would only wait for each other

    def check() -> None:
        if stopped():
            raise Interrupted("before training began")

    prior = parts.prior(request)
    fineness = request.fineness
    geometry, facts = prepare(request, reporter, check)
    with reporter.stage("labels") as stage:
        watch = watched(stage, check, 0.0, 1.0)
        cuts = slices(geometry.body, geometry.up, request.families, fineness.label)
        asked = sum(len(family.custom) or family.count for family in request.families)
        if not cuts:
            raise InputError(f"{request.scene.name}: none of the {asked} planes meets the object; give others")
        if len(cuts) < asked:
            reporter.warn(f"{request.scene.name}: {asked - len(cuts)} of {asked} planes miss the object, left out")
        labels, atoms, cells = label(
            request, geometry, cuts, prior, checkpoint, watch, parts.fill, parts.form, parts.smoothing
        )
        if cells < fineness.fine:
            reporter.warn(
                f"{request.scene.name}: the pictures are good for an inside {cells} atoms across, not {fineness.fine}; "
                "larger or sharper ones would make it finer"
            )
        geometry = replace(geometry, atoms=atoms)
        facts |= {"interior_atoms": len(atoms.interior), "exposed_atoms": atoms.interior.exposed, "cells": cells}
    with reporter.stage("refit") as stage:
        watches = [watched(stage, check, *part) for part in pairwise((0.0, 0.3, 0.6, 0.8, 1.0))]
        cameras = surface_cameras(geometry.body, geometry.up, fineness.surface_views, fineness.surface)
        surfaces = surface_views(geometry.atoms, geometry.gaussians, cameras, ENTRIES, watches[0])
        atoms, held_out = refitted(geometry.atoms, surfaces, checkpoint, watches[1])
        if fineness.reshape:
            atoms = reshaped(replace(geometry, atoms=atoms), request, checkpoint, watches[2])
            surfaces = surface_views(atoms, geometry.gaussians, cameras, ENTRIES, watches[3])
        facts |= {"sh_degree": atoms.surface.sh_degree, "refit_held_out_psnr_db": held_out}
    with reporter.stage("views") as stage:
        faces = sections(atoms, cuts, watched(stage, check, 0.0, 1.0))
    geometry = replace(geometry, atoms=atoms)
    trainer = parts.trainer(atoms, faces, surfaces, request.seed, parts.smoothing)
    history = train(request, trainer, prior if parts.refines else None, labels, out, reporter, checkpoint, stopped)
    return save(request, geometry, trainer, facts, history, out, reporter)


def watched(stage: Stage, check: Callable[[], None], start: float, end: float) -> Callable[[float], None]:
    """Progress of a part of a stage, which also notices that the user wants to stop."""

    def progress(part: float) -> None:
        check()
        stage.progress(start + (end - start) * part)

    return progress


def prepare(request: Request, reporter: Reporter, check: Callable[[], None]) -> tuple[Geometry, dict[str, Any]]:
    """Reads the scene, finds the body, makes the atoms. Returns them with what the report says of them."""
    with reporter.stage("load"):
        loaded = load(request.scene, request.seed)
        for warning in loaded.warnings:
            reporter.warn(warning)
    gaussians = loaded.gaussians
    check()
    with reporter.stage("body") as stage:
        found = enclosed(gaussians, request.fineness.cells, request.scene.name)
        for note in found.notes:
            reporter.warn(f"{request.scene.name}: {note}")
        up, reason = upward(request, gaussians)
        stage.progress(1.0, reason, up=up.tolist(), reason=reason)
    check()
    with reporter.stage("atomise"):
        solid = solidify(gaussians, found.body, request.fineness.cells, request.seed)
        atoms = solid.atoms
    facts = {
        "gaussians": len(gaussians),
        "gaussians_dropped": solid.skin.dropped,
        "gaussians_split": solid.skin.split,
        "surface_atoms": len(atoms.surface),
        "volume": found.body.volume,
        "pitch": atoms.pitch,
        "up": up.tolist(),
    }
    return Geometry(gaussians, atoms, found.body, up), facts


def upward(request: Request, gaussians: Gaussians) -> tuple[NDArray[np.float64], str]:
    """The unit up axis as given, or as the capture suggests, and why."""
    if request.up is not None:
        axis = np.asarray(request.up, np.float64)
        return axis / np.linalg.norm(axis), "as given"
    return detect_up(gaussians)


def refitted(
    atoms: Atoms, views: Sequence[SurfaceView], checkpoint: Checkpoint, progress: Callable[[float], None]
) -> tuple[Atoms, list[float]]:
    """The atoms with surface colours fitted to the input, and PSNR in dB of held-out views before and after."""
    kept = checkpoint.load("surface")
    if kept is None:
        result = refit(atoms, views, progress)
        facts = {"held_out": list(result.held_out)}
        checkpoint.save("surface", {"sh": result.atoms.surface.sh}, facts)
        return result.atoms, facts["held_out"]
    arrays, facts = kept
    return replace(atoms, surface=replace(atoms.surface, sh=arrays["sh"])), facts["held_out"]


def reshaped(geometry: Geometry, request: Request, checkpoint: Checkpoint, progress: Callable[[float], None]) -> Atoms:
    """The atoms with sizes and colours of the skin fitted once more, through the full picture."""
    atoms, steps = geometry.atoms, request.fineness.reshape
    kept = checkpoint.load("shape")
    if kept is None:
        cameras = surface_cameras(geometry.body, geometry.up, SHAPE_VIEWS, SHAPE_SIZE)
        atoms = reshape(atoms, geometry.gaussians, cameras, steps, request.seed, progress)
        checkpoint.save("shape", {"sh": atoms.surface.sh, "scales": atoms.surface.scales}, {})
        return atoms
    return replace(atoms, surface=replace(atoms.surface, **kept[0]))
