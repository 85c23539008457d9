"""Labels for every cut: from one volume where the prior can solve for it, else plane by plane (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from engine.atoms import Atoms, InteriorAtoms
from engine.errors import InputError
from engine.fill import Colours, fill
from training.checkpoint import Checkpoint
from training.deblur import deblurred
from training.exemplar import ExemplarPrior
from training.prior import Denoises, Progress, Solves
from training.request import Geometry, Request
from training.sds import Form, distill
from training.smoothing import Smoothing, smooth
from training.trainer import Trainer
from training.views import Section, Slice, sections

__all__ = ["label", "make_prior", "refine"]


def make_prior(request: Request) -> Denoises | Solves:
    """The prior that was asked for. Raises InputError where its model or its packages are missing."""
    if request.prior == "exemplar":
        return ExemplarPrior()
    if request.model is None:
        raise InputError("--prior stable-diffusion needs a model; give its local folder with --model")
    from training.diffusion import StableDiffusionPrior  # an extra, and slow to import

    return StableDiffusionPrior(request.model, request.thing or request.scene.stem, midas=request.midas)


def label(
    request: Request,
    geometry: Geometry,
    cuts: Sequence[Slice],
    prior: Denoises | Solves,
    checkpoint: Checkpoint,
    progress: Progress,
    filler: Callable[..., InteriorAtoms] = fill,
    form: Form = "x0",
    smoothing: Smoothing = smooth,
) -> tuple[list[Tensor], Atoms, int]:
    """A label for every cut, and atoms as fine as the labels need, with colours to start from.

    And how many of the finest atoms the longest side would take: fewer than asked where the prior knows no more.

    `filler` makes them, as engine.fill.fill does; `form` is how a prior that only denoises is followed, and `smoothing`
    colours what none of its labels shows.
    """
    kept = checkpoint.load("labels")
    if kept is None:
        side = geometry.atoms.pitch * request.fineness.cells
        cells: float = request.fineness.fine
        if isinstance(prior, Solves):
            pictures, colours, coarser = solved(request, geometry, cuts, prior, progress)
            cells /= coarser
        else:
            pictures, colours = distilled(request, geometry, cuts, prior, progress, form, smoothing)
        interior = filler(geometry.body, side / cells, request.seed, geometry.atoms.surface, colours)
        rgb = deblurred(replace(geometry.atoms, interior=interior), interior.rgb)
        arrays = {"labels": np.stack(pictures), "means": interior.means, "sigmas": interior.sigmas, "rgb": rgb}
        checkpoint.save("labels", arrays, {"exposed": interior.exposed, "cells": round(cells)})
    else:
        arrays, facts = kept
        cells = facts["cells"]
        interior = InteriorAtoms(arrays["means"], arrays["sigmas"], arrays["rgb"], facts["exposed"])
    labels = [torch.from_numpy(picture.copy()) for picture in arrays["labels"]]
    return labels, replace(geometry.atoms, interior=replace(interior, rgb=arrays["rgb"])), round(cells)


def solved(
    request: Request, geometry: Geometry, cuts: Sequence[Slice], prior: Solves, progress: Progress
) -> tuple[list[NDArray[np.float32]], Colours, float]:
    """Labels that agree in space, because they are cuts through one volume; and its colours, for atoms.

    And how many times coarser it is than was asked, because the prior knows no more: so may the atoms be.
    """
    detail = request.fineness
    volume = prior.solve(geometry.body, geometry.up, request.families, detail.voxels, request.seed, progress)
    pictures = [np.where(cut.condition.inside[..., None], volume.at(cut.points), np.float32(1.0)) for cut in cuts]
    asked = geometry.atoms.pitch * detail.cells / detail.voxels
    return pictures, volume.crisp, 1.0 if np.isclose(volume.body.cell, asked) else volume.body.cell / asked


def distilled(
    request: Request,
    geometry: Geometry,
    cuts: Sequence[Slice],
    prior: Denoises,
    progress: Progress,
    form: Form,
    smoothing: Smoothing,
) -> tuple[list[NDArray[np.float32]], Colours]:
    """Labels made plane by plane by score distillation, from an even grey (paper, stage one); and their colours.

    The colours are written back to the uniform fill first: there each point's are those of the nearest atom.
    """
    pictures = []
    for index, cut in enumerate(cuts):
        start = np.where(cut.condition.inside[..., None], cut.condition.render, np.float32(1.0))
        rng = np.random.default_rng([request.seed, index])
        pictures.append(distill(start, prior, cut.condition, rng, form))
        progress((index + 1) / len(cuts))
    rgb = written_back(geometry.atoms, sections(geometry.atoms, cuts, lambda _: None), pictures, smoothing)
    tree = cKDTree(geometry.atoms.interior.means)

    def colours(points: NDArray[np.floating]) -> NDArray[np.float32]:
        return np.clip(rgb[tree.query(points, workers=-1)[1]], 0, 1)

    return pictures, colours


def written_back(
    atoms: Atoms, cuts: Sequence[Section], pictures: Sequence[NDArray[np.float32]], smoothing: Smoothing
) -> NDArray[np.float32]:
    """(I, 3). Each interior atom's mean over the label pixels that show it; the others take their neighbours'."""
    start = len(atoms.surface)
    total = np.zeros((len(atoms.interior), 4), np.float64)
    for cut, picture in zip(cuts, pictures, strict=True):
        ones = np.ones(picture.shape, np.float32)
        rows = np.s_[start : start + len(total)]
        total[:, :3] += cut.weights.apply_transposed(picture)[rows]
        total[:, 3] += cut.weights.apply_transposed(ones)[rows, 0]
    shown = total[:, 3] > 0
    rgb = atoms.interior.rgb.copy()
    rgb[shown] = total[shown, :3] / total[shown, 3:]
    return smoothing(atoms.interior.means, atoms.interior.rgb, rgb, shown)


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
