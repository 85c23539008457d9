"""The main job: from a hollow capture to a solid with an inside (DESIGN section 4), stage by stage.

Each stage that takes long leaves a checkpoint; a run that was stopped goes on from there with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from engine.errors import InputError
from engine.fit.scale_fit import fit_scales
from engine.fit.sh_fit import SurfaceView, fit_sh, surface_views
from engine.io.files import remove_leftovers
from engine.io.load import load
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.gaussians import Gaussians
from engine.solid.fill import Colours, fill
from engine.solid.solidify import atomise_surface, find_enclosure
from engine.solid.up_axis import detect_up
from training.checkpoint import Checkpoint
from training.events import Reporter, Stage
from training.labels import draw_each, make_prior, nearest_colours, solved, written_back
from training.optimise.deblur import deblurred
from training.optimise.rounds import train
from training.optimise.smoothing import smooth
from training.optimise.trainer import Trainer
from training.outcome import save
from training.priors.prior import Denoises, Progress, Solves
from training.priors.sds import distill
from training.request import Geometry, Interrupted, Request
from training.views import ENTRIES, Section, Slice, sections, slices, surface_cameras

__all__ = ["Pipeline", "prepare", "refitted", "run"]


SHAPE_VIEWS, SHAPE_SIZE = 24, 256
"""Views in which sizes are fitted: coarser pixels would not tell them apart."""


def run(request: Request, out: Path, reporter: Reporter, resume: bool, stopped: Callable[[], bool]) -> Path:
    """Does the whole job; returns the trained scene's path. Bit-equal for a request, resumed or not.

    `stopped` is asked now and then; once it says yes the run keeps what it has and raises Interrupted. Raises
    InputError for whatever the user can mend.
    """
    return Pipeline(request, out, reporter, stopped).run(resume)


class Pipeline:
    """The stages of one run, in order. An evaluation overrides a step to see what it is good for."""

    refines = True
    """Whether sections that disagree with their labels get new ones."""

    def __init__(self, request: Request, out: Path, reporter: Reporter, stopped: Callable[[], bool]) -> None:
        self.request = request
        self.out = out
        self.reporter = reporter
        self.stopped = stopped
        self.checkpoint = Checkpoint(out / "checkpoint", request.fingerprint())

    def run(self, resume: bool) -> Path:
        """All of it, from the last checkpoint if it is to `resume`."""
        for name in ("checkpoint", "previews"):
            if (self.out / name).is_symlink():  # files are removed and written there: a stranger may have laid the link
                raise InputError(f"{self.out / name}: leads out of the result's folder; remove this link")
        remove_leftovers(self.out)
        if not resume:
            self.checkpoint.clear()
        torch.set_num_threads(1)  # the kernels use the cores; torch's own threads would only wait for each other
        prior = self.prior()
        geometry, facts = prepare(self.request, self.reporter, self.check)
        cuts, labels, atoms = self.label(geometry, prior, facts)
        atoms, surfaces = self.fit_skin(atoms, geometry, facts)
        with self.reporter.stage("views") as stage:
            faces = sections(atoms, cuts, self.watched(stage, 0.0, 1.0))
        trainer = self.trainer(atoms, faces, surfaces)
        history = train(
            self.request,
            trainer,
            prior if self.refines else None,
            labels,
            self.out,
            self.reporter,
            self.checkpoint,
            self.stopped,
        )
        return save(self.request, geometry, atoms, trainer, facts, history, self.out, self.reporter)

    # Steps

    def prior(self) -> Denoises | Solves:
        """What draws the labels."""
        return make_prior(self.request)

    def fill(self, geometry: Geometry, pitch: float, colours: Colours) -> InteriorAtoms:
        """Atoms for the inside, no finer than the pitch, with these colours."""
        return fill(geometry.body, pitch, self.request.seed, geometry.skin, colours)

    def first_label(
        self, start: NDArray[np.float32], prior: Denoises, cut: Slice, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """(H, W, 3). The label of one plane by score distillation, from an even grey (paper, stage one)."""
        return distill(start, prior, cut.condition, rng)

    def smooth(
        self, geometry: Geometry, interior: InteriorAtoms, rgb: NDArray[np.float32], shown: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(I, 3). Colours of atoms that labels were written back to; those that no label shows follow the others."""
        return smooth(interior.means, interior.rgb, rgb, shown)

    def trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """What moves the colours towards the labels."""
        return Trainer(atoms, faces, surfaces, self.request.seed)

    # Stages

    def check(self) -> None:
        """Raises Interrupted once the user wants to stop."""
        if self.stopped():
            raise Interrupted("before training began")

    def watched(self, stage: Stage, start: float, end: float) -> Progress:
        """Progress of a part of a stage, which also notices that the user wants to stop."""

        def progress(part: float) -> None:
            self.check()
            stage.progress(start + (end - start) * part)

        return progress

    def label(
        self, geometry: Geometry, prior: Denoises | Solves, facts: dict[str, Any]
    ) -> tuple[list[Slice], list[Tensor], Atoms]:
        """The cuts, a label (H, W, 3) for each, and atoms as fine as the labels need, with colours to start from."""
        request, fineness, name = self.request, self.request.fineness, self.request.scene.name
        with self.reporter.stage("labels") as stage:
            cuts = slices(geometry.body, geometry.up, request.families, fineness.label)
            asked = sum(len(family.custom) or family.count for family in request.families)
            if not cuts:
                raise InputError(f"{name}: none of the {asked} planes meets the object; give others")
            if len(cuts) < asked:
                self.reporter.warn(f"{name}: {asked - len(cuts)} of {asked} planes miss the object, left out")
            arrays, found = self.checkpoint.made("labels", lambda: self.drawn(geometry, cuts, prior, stage))
            if found["cells"] < fineness.fine:
                self.reporter.warn(
                    f"{name}: the pictures are good for an inside {found['cells']} atoms across, not {fineness.fine}; "
                    "larger or sharper ones would make it finer"
                )
        interior = InteriorAtoms(arrays["means"], arrays["sigmas"], arrays["rgb"], found["exposed"])
        facts |= {"interior_atoms": len(interior), "exposed_atoms": interior.exposed, "cells": found["cells"]}
        return cuts, [torch.from_numpy(picture.copy()) for picture in arrays["labels"]], geometry.filled(interior)

    def drawn(
        self, geometry: Geometry, cuts: Sequence[Slice], prior: Denoises | Solves, stage: Stage
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Labels and atoms as they are kept; and how many of the finest atoms the longest side would take: fewer than
        asked where the prior knows no more."""
        request, progress = self.request, self.watched(stage, 0.0, 1.0)
        cells: float = request.fineness.fine
        if isinstance(prior, Solves):
            pictures, colours, coarser = solved(request, geometry, cuts, prior, progress)
            cells /= coarser
        else:
            pictures, colours = self.distilled(geometry, cuts, prior, progress)
        interior = self.fill(geometry, geometry.pitch * request.fineness.cells / cells, colours)
        rgb = deblurred(geometry.filled(interior), interior.rgb)
        arrays = {"labels": np.stack(pictures), "means": interior.means, "sigmas": interior.sigmas, "rgb": rgb}
        return arrays, {"exposed": interior.exposed, "cells": round(cells)}

    def distilled(
        self, geometry: Geometry, cuts: Sequence[Slice], prior: Denoises, progress: Progress
    ) -> tuple[list[NDArray[np.float32]], Colours]:
        """Labels made plane by plane, and their colours: written back to an even fill, at each point the nearest's."""

        def draw(index: int, cut: Slice, start: NDArray[np.float32]) -> NDArray[np.float32]:
            return self.first_label(start, prior, cut, np.random.default_rng([self.request.seed, index]))

        pictures = draw_each(cuts, draw, progress)
        interior = fill(geometry.body, geometry.pitch, self.request.seed, geometry.skin)
        atoms = geometry.filled(interior)
        rgb, shown = written_back(atoms, sections(atoms, cuts, lambda _: None), pictures)
        return pictures, nearest_colours(interior.means, self.smooth(geometry, interior, rgb, shown))

    def fit_skin(self, atoms: Atoms, geometry: Geometry, facts: dict[str, Any]) -> tuple[Atoms, list[SurfaceView]]:
        """The atoms with a skin that looks like the capture, and the views of it that training follows."""
        request, fineness = self.request, self.request.fineness
        with self.reporter.stage("refit") as stage:
            watches = [self.watched(stage, *part) for part in pairwise((0.0, 0.3, 0.6, 0.8, 1.0))]
            cameras = surface_cameras(geometry.body, geometry.up, fineness.surface_views, fineness.surface)
            surfaces = surface_views(atoms, geometry.gaussians, cameras, ENTRIES, watches[0])
            atoms, held_out = refitted(atoms, surfaces, self.checkpoint, watches[1])
            if fineness.reshape:
                atoms = reshaped(atoms, geometry, request, self.checkpoint, watches[2])
                surfaces = surface_views(atoms, geometry.gaussians, cameras, ENTRIES, watches[3])
        facts |= {"sh_degree": atoms.surface.sh_degree, "refit_held_out_psnr_db": held_out}
        return atoms, surfaces


def prepare(request: Request, reporter: Reporter, check: Callable[[], None]) -> tuple[Geometry, dict[str, Any]]:
    """Reads the scene, finds the body, makes the skin's atoms. Returns them with what the report says of them."""
    with reporter.stage("load"):
        loaded = load(request.scene, request.seed)
        for warning in loaded.warnings:
            reporter.warn(warning)
    gaussians = loaded.gaussians
    check()
    with reporter.stage("body") as stage:
        enclosure = find_enclosure(gaussians, request.fineness.cells, request.scene.name)
        for note in enclosure.notes:
            reporter.warn(f"{request.scene.name}: {note}")
        up, reason = upward(request, gaussians)
        stage.progress(1.0, reason, up=up.tolist(), reason=reason)
    check()
    with reporter.stage("atomise"):
        skin, pitch = atomise_surface(gaussians, enclosure, request.fineness.cells)
    facts = {
        "gaussians": len(gaussians),
        "gaussians_dropped": skin.dropped,
        "gaussians_split": skin.split,
        "surface_atoms": len(skin.atoms),
        "volume": enclosure.body.volume,
        "pitch": pitch,
        "up": up.tolist(),
    }
    return Geometry(gaussians, skin.atoms, pitch, enclosure.body, up), facts


def upward(request: Request, gaussians: Gaussians) -> tuple[NDArray[np.float64], str]:
    """The unit up axis as given, or as the capture suggests, and why."""
    if request.up is not None:
        axis = np.asarray(request.up, np.float64)
        return axis / np.linalg.norm(axis), "as given"
    return detect_up(gaussians)


def refitted(
    atoms: Atoms, views: Sequence[SurfaceView], checkpoint: Checkpoint, progress: Progress
) -> tuple[Atoms, list[float]]:
    """The atoms with surface colours fitted to the input, and PSNR in dB of held-out views before and after."""

    def fitted() -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        result = fit_sh(atoms, views, progress)
        return {"sh": result.atoms.surface.sh}, {"held_out": list(result.held_out)}

    arrays, facts = checkpoint.made("surface", fitted)
    return replace(atoms, surface=replace(atoms.surface, sh=arrays["sh"])), facts["held_out"]


def reshaped(atoms: Atoms, geometry: Geometry, request: Request, checkpoint: Checkpoint, progress: Progress) -> Atoms:
    """The atoms with sizes and colours of the skin fitted once more, through the full picture."""

    def fitted() -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        cameras = surface_cameras(geometry.body, geometry.up, SHAPE_VIEWS, SHAPE_SIZE)
        better = fit_scales(
            atoms, geometry.gaussians, cameras, request.fineness.reshape, request.seed, progress
        ).surface
        return {"sh": better.sh, "scales": better.scales}, {}

    arrays, _ = checkpoint.made("shape", fitted)
    return replace(atoms, surface=replace(atoms.surface, **arrays))
