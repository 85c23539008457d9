"""Training of one scene: from a hollow capture to a solid with an inside, stage by stage.

Every long stage leaves a checkpoint; an interrupted run resumes from it with a bit-equal result.
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
from engine.fit.sh_fit import SurfaceView, fit_sh, surface_views, views_after
from engine.io.file_axes import FileAxes
from engine.io.files import remove_leftovers
from engine.io.load import load
from engine.io.trained import is_trained
from engine.isolate.bodies import find_bodies
from engine.isolate.selection import isolated, without_surroundings
from engine.isolate.surroundings import object_ball
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.inside import Inside
from engine.solid.fill import Colours, fill
from engine.solid.solidify import atomise_surface, find_enclosure
from engine.solid.up_axis.detect import UpAxis, detect_up
from engine.solid.visible_skin import out_to_front
from training.checkpoint import Checkpoint
from training.events import Reporter, Stage
from training.labels import (
    back_project,
    blank_label,
    label_from_volume,
    make_prior,
    nearest_atom_colours,
    solve_volume,
)
from training.optimise.deblur import deblur
from training.optimise.smoothing import smooth
from training.optimise.trainer import Trainer
from training.optimise.training_loop import previewed, save_previews, train
from training.priors.inside_file import restore_inside
from training.priors.prior import Denoiser, Progress, VolumeSolver
from training.priors.sds import distill
from training.request import Geometry, Interrupted, Request
from training.results import save_results
from training.skin import fit_geometry
from training.views import ENTRIES, Section, Slice, sections, slices, surface_cameras

__all__ = ["Pipeline", "prepare", "refit_surface", "run"]

ALL_KNOWN = "the inside is known everywhere; nothing to train"

INSIDE = "inside."
"""Prefix of the names of the inside's arrays in the checkpoint of the labels."""


def run(request: Request, out: Path, reporter: Reporter, resume: bool, stopped: Callable[[], bool]) -> Path:
    """Trains one scene and returns the path of the result. Bit-equal for a request, resumed or not.

    `stopped` is polled; once it returns True the run saves its state and raises Interrupted. Raises InputError for
    everything the user can correct.
    """
    return Pipeline(request, out, reporter, stopped).run(resume)


class Pipeline:
    """The stages of one run, in order. Evaluations subclass it and override steps for ablations and comparisons."""

    refines = True
    """Whether sections that disagree with their labels get refined labels."""

    def __init__(self, request: Request, out: Path, reporter: Reporter, stopped: Callable[[], bool]) -> None:
        self.request = request
        self.out = out
        self.reporter = reporter
        self.stopped = stopped
        self.checkpoint = Checkpoint(out / "checkpoint", request.fingerprint())
        self.facts: dict[str, Any] = {}
        """Facts for the report, collected so far."""
        self.inside: Inside | None = None
        """The inside as a function, if the prior finds one."""

    def run(self, resume: bool) -> Path:
        """Runs all stages, from the last checkpoint if `resume`; returns the path of the trained scene."""
        for name in ("checkpoint", "previews"):
            if (self.out / name).is_symlink():  # files are removed and written there: a stranger may have made the link
                raise InputError(f"{self.out / name}: leads out of the result's folder; remove this link")
        result = self.out / self.request.result_name
        if result.exists() and result.samefile(self.request.scene):
            raise InputError(f"{result}: the result would replace the capture itself; give another folder")
        if result.exists() and not is_trained(result):
            raise InputError(f"{result}: is in the way, and no result of an earlier run; give another folder")
        remove_leftovers(self.out, self.out / "checkpoint", self.out / "previews")
        if not resume:
            self.checkpoint.clear()
        torch.set_num_threads(1)  # the kernels use all cores; torch's own threads would compete with them
        prior = self.make_prior()
        geometry, self.facts = prepare(self.request, self.reporter, self.raise_if_stopped)
        cuts, labels, atoms = self.label_cuts(geometry, prior)
        atoms, surfaces = self.fit_skin(atoms, geometry)
        with self.reporter.stage("views") as stage:
            faces = sections(atoms, cuts, self.track_progress(stage, 0.0, 1.0))
        trainer = self.make_trainer(atoms, faces, surfaces)
        if self.trains:
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
        else:
            history = {"section": [], "surface": [], "disagreeing": [], "ended": ALL_KNOWN}
            save_previews(trainer, labels, self.out, self.reporter)
        return save_results(
            self.request, geometry, atoms, trainer, self.facts, history, self.out, self.reporter, self.inside
        )

    # Steps that an evaluation may override

    @property
    def trains(self) -> bool:
        """Whether colours are trained. Unless iterations are asked for, they are not where the inside is known as a
        function: atoms that are set to it in closed form (`deblur`) are as close to it as trained ones. Random cuts of
        an orange, an apple and a pomegranate from photographs differ from it by 0.1 to 0.5 dB more, blurred by three
        pixels by 0.1 dB more to 2 dB less, and the skin from the capture by 0.1 dB less."""
        return self.inside is None or self.request.iterations is not None

    def make_prior(self) -> Denoiser | VolumeSolver:
        """The prior that draws the labels."""
        return make_prior(self.request)

    def fill_interior(self, geometry: Geometry, pitch: float, colours: Colours) -> InteriorAtoms:
        """Interior atoms in these colours, on lattices no finer than `pitch` (world units)."""
        return fill(geometry.body, pitch, self.request.seed, colours)

    def draw_label(self, prior: Denoiser, cut: Slice, rng: np.random.Generator) -> NDArray[np.float32]:
        """(H, W, 3). The first label of one plane, by score distillation from even grey (paper, section 3.2)."""
        return distill(blank_label(cut.condition), prior, cut.condition, rng)

    def smooth_interior(
        self, interior: InteriorAtoms, rgb: NDArray[np.float32], covered: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """(I, 3). Back-projected colours `rgb` (I, 3), extended to the atoms that no label covers (I,)."""
        return smooth(interior.means, interior.rgb, rgb, covered)

    def make_trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """The trainer that fits the colours to the labels."""
        return Trainer(atoms, faces, surfaces, self.request.seed)

    # Stages

    def raise_if_stopped(self) -> None:
        """Raises Interrupted if the user has asked to stop."""
        if self.stopped():
            raise Interrupted("before training began")

    def track_progress(self, stage: Stage, start: float, end: float) -> Progress:
        """A progress callback for the part of a stage from `start` to `end`, which also raises Interrupted on
        request."""

        def progress(part: float) -> None:
            self.raise_if_stopped()
            stage.progress(start + (end - start) * part)

        return progress

    def label_cuts(self, geometry: Geometry, prior: Denoiser | VolumeSolver) -> tuple[list[Slice], list[Tensor], Atoms]:
        """The labelled cuts, their labels (H, W, 3), and atoms with initial colours, as fine as the labels resolve.

        Raises InputError if no plane meets the body.
        """
        request, fineness, name = self.request, self.request.fineness, self.request.scene.name
        with self.reporter.stage("labels") as stage:
            cuts = slices(geometry.body, geometry.up, request.families, fineness.label)
            requested = sum(len(family.custom) or family.count for family in request.families)
            if not cuts:
                raise InputError(f"{name}: none of the {requested} planes meets the object; give others")
            if len(cuts) < requested:
                self.reporter.warn(f"{name}: {requested - len(cuts)} of {requested} planes miss the object, left out")
            arrays, made = self.checkpoint.load_or_make(
                "labels", lambda: self.make_labels(geometry, cuts, prior, stage)
            )
            for note in made["notes"]:
                self.reporter.warn(note)
            if self.inside is None and "inside" in made:  # from an interrupted run
                record = {name.removeprefix(INSIDE): a for name, a in arrays.items() if name.startswith(INSIDE)}
                self.inside = restore_inside((record, made["inside"]))
            if made["cells"] < fineness.fine:
                self.reporter.warn(
                    f"{name}: the pictures are good for an inside {made['cells']} atoms across, not {fineness.fine}; "
                    "larger or sharper ones would make it finer"
                )
        interior = InteriorAtoms(arrays["means"], arrays["sigmas"], arrays["rgb"])
        kinds = [cut.family.kind for cut in cuts]
        self.facts |= {"interior_atoms": len(interior), "cells": made["cells"]}
        self.facts["views"] = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
        return (
            self.labelled(cuts),
            [torch.from_numpy(label.copy()) for label in arrays["labels"]],
            geometry.filled(interior),
        )

    def labelled(self, cuts: list[Slice]) -> list[Slice]:
        """The cuts that need labels: where nothing is trained, only those that previews show."""
        return cuts if self.trains else [cuts[index] for index in previewed(cuts)]

    def make_labels(
        self, geometry: Geometry, cuts: list[Slice], prior: Denoiser | VolumeSolver, stage: Stage
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Labels and interior atoms as arrays for the checkpoint, and facts about them.

        `notes` are what the user should check in the pictures; `cells` is the number of the finest atoms along the
        body's longest side, fewer than requested if the prior resolves less.
        """
        request, progress = self.request, self.track_progress(stage, 0.0, 1.0)
        cells: float = request.fineness.fine
        notes: list[str] = []
        colours: Colours
        if isinstance(prior, VolumeSolver):
            volume, coarsening = solve_volume(request, geometry, prior, progress)
            self.inside, notes, cells = volume.inside, list(volume.notes), cells / coarsening
            labels, colours = [label_from_volume(volume, cut) for cut in self.labelled(cuts)], volume.at_cubic
        else:
            labels, colours = self.distill_labels(geometry, cuts, prior, progress)
        interior = self.fill_interior(geometry, geometry.pitch * request.fineness.cells / cells, colours)
        rgb = deblur(geometry.filled(interior), interior.rgb)
        arrays = {"labels": np.stack(labels), "means": interior.means, "sigmas": interior.sigmas, "rgb": rgb}
        made = {"cells": round(cells), "notes": notes}
        if self.inside is None:
            return arrays, made
        record, facts = self.inside.record()
        return arrays | {INSIDE + name: array for name, array in record.items()}, made | {"inside": facts}

    def distill_labels(
        self, geometry: Geometry, cuts: Sequence[Slice], prior: Denoiser, progress: Progress
    ) -> tuple[list[NDArray[np.float32]], Colours]:
        """A label (H, W, 3) for each plane, drawn on its own, and a colour field: that of the nearest back-projected
        atom."""
        labels = []
        for index, cut in enumerate(cuts):
            labels.append(self.draw_label(prior, cut, np.random.default_rng([self.request.seed, index])))
            progress((index + 1) / len(cuts))
        # A plain fill at the skin's pitch: without colours nothing says yet where finer atoms are needed.
        interior = fill(geometry.body, geometry.pitch, self.request.seed)
        atoms = geometry.filled(interior)
        rgb, covered = back_project(atoms, sections(atoms, cuts, lambda _: None), labels)
        return labels, nearest_atom_colours(interior.means, self.smooth_interior(interior, rgb, covered))

    def fit_skin(self, atoms: Atoms, geometry: Geometry) -> tuple[Atoms, list[SurfaceView]]:
        """The atoms with the skin fitted to the capture, and views of the capture if there is training."""
        fineness = self.request.fineness
        with self.reporter.stage("refit") as stage:
            progress = [self.track_progress(stage, *part) for part in pairwise((0.0, 0.1, 0.2, 0.9, 1.0))]
            cameras = surface_cameras(geometry.gaussians, geometry.up, fineness.surface_views, fineness.surface)
            surfaces = surface_views(atoms, geometry.gaussians, cameras, ENTRIES, progress[0])
            atoms, held_out = refit_surface(atoms, surfaces, self.checkpoint, progress[1])
            fitted = fit_geometry(atoms, geometry, self.request, self.checkpoint, progress[2])
            surfaces = views_after(atoms, fitted, surfaces, ENTRIES, progress[3]) if self.trains else []
        self.facts |= {"sh_degree": atoms.surface.sh_degree, "refit_held_out_psnr_db": held_out}
        return fitted, surfaces


def prepare(
    request: Request, reporter: Reporter, raise_if_stopped: Callable[[], None]
) -> tuple[Geometry, dict[str, Any]]:
    """Reads the scene, finds the body and makes the skin's atoms; returns them with facts for the report.

    `raise_if_stopped` is called between stages and may raise to stop the run.
    """
    with reporter.stage("load"):
        loaded = load(request.scene, request.seed)
        for warning in loaded.warnings:
            reporter.warn(warning)
        gaussians, notes = isolated(loaded.gaussians, request.isolation, request.scene.name)
        for note in notes:
            reporter.warn(f"{request.scene.name}: {note}")
        seen = without_surroundings(loaded.gaussians)
        if seen is not loaded.gaussians and object_ball(gaussians) is not None:
            reporter.warn(f"{request.scene.name}: it shows what is around the object; --no-surroundings leaves it out")
        bodies = len(find_bodies(gaussians).points)
        if bodies > 1:
            reporter.warn(f"{request.scene.name}: {bodies} separate bodies are taken for one; --body tells them apart")
    raise_if_stopped()
    with reporter.stage("body") as stage:
        enclosure = find_enclosure(gaussians, request.fineness.cells, request.scene.name)
        for note in enclosure.notes:
            reporter.warn(f"{request.scene.name}: {note}")
        up = find_up(request, seen, loaded.file_axes)
        stage.progress(1.0, up.reason, up=up.axis.tolist(), reason=up.reason)
        if up.certainty < 0.5:
            reporter.warn(f"{request.scene.name}: up is {up.reason}: a guess; give --up if it is wrong")
    raise_if_stopped()
    with reporter.stage("atomise"):
        skin, pitch = atomise_surface(enclosure, request.fineness.cells, request.fineness.tolerance)
        body = out_to_front(enclosure.body, skin.atoms, pitch)
    facts = {
        "gaussians": len(gaussians),
        "gaussians_left_out": len(loaded.gaussians) - len(gaussians),
        "gaussians_dropped": len(gaussians) - len(enclosure.shell) + skin.dropped,
        "gaussians_split": skin.split,
        "surface_atoms": len(skin.atoms),
        "volume": body.volume,
        "pitch": pitch,
        "up": up.axis.tolist(),
    }
    return Geometry(enclosure.shell, skin.atoms, pitch, enclosure.body, body, up.axis), facts


def find_up(request: Request, seen: Gaussians, file_axes: FileAxes) -> UpAxis:
    """The up axis, as given or as detected from the object and its floor."""
    if request.up is not None:
        axis = np.asarray(request.up, np.float64)
        return UpAxis(axis / np.linalg.norm(axis), "as given", 1.0)
    return detect_up(seen, file_axes)


def refit_surface(
    atoms: Atoms, views: Sequence[SurfaceView], checkpoint: Checkpoint, progress: Progress
) -> tuple[Atoms, list[float]]:
    """The atoms with surface colours fitted to the capture, and PSNR in dB of held-out views before and after."""

    def fit() -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        result = fit_sh(atoms, views, progress)
        return {"sh": result.atoms.surface.sh}, {"held_out": list(result.held_out)}

    arrays, facts = checkpoint.load_or_make("surface", fit)
    return replace(atoms, surface=replace(atoms.surface, sh=arrays["sh"])), facts["held_out"]
