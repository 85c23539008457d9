"""Labels for every cut: from one volume where the prior can solve for it, else plane by plane (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from engine.errors import InputError
from engine.scene.atoms import Atoms
from engine.solid.fill import Colours
from training.optimise.trainer import Trainer
from training.priors.exemplar import ExemplarPrior
from training.priors.prior import Denoises, Progress, Solves
from training.priors.sds import distill
from training.request import Geometry, Request
from training.views import Section, Slice

__all__ = ["draw_each", "make_prior", "nearest_colours", "refine", "solved", "written_back"]

Float = NDArray[np.float32]


def make_prior(request: Request) -> Denoises | Solves:
    """The prior that was asked for. Raises InputError where its model or its packages are missing."""
    if request.prior == "exemplar":
        return ExemplarPrior()
    if request.model is None:
        raise InputError("--prior stable-diffusion needs a model; give its local folder with --model")
    from training.priors.diffusion import StableDiffusionPrior  # an extra, and slow to import

    return StableDiffusionPrior(request.model, request.thing or request.scene.stem, midas=request.midas)


def solved(
    request: Request, geometry: Geometry, cuts: Sequence[Slice], prior: Solves, progress: Progress
) -> tuple[list[Float], Colours, float]:
    """Labels that agree in space, because they are cuts through one volume; and its colours, for atoms.

    And how many times coarser it is than was asked, because the prior knows no more: so may the atoms be.
    """
    detail = request.fineness
    volume = prior.solve(geometry.body, geometry.up, request.families, detail.voxels, request.seed, progress)
    pictures = [np.where(cut.condition.inside[..., None], volume.at(cut.points), np.float32(1.0)) for cut in cuts]
    asked = geometry.pitch * detail.cells / detail.voxels
    return pictures, volume.crisp, 1.0 if np.isclose(volume.body.grid.cell, asked) else volume.body.grid.cell / asked


def draw_each(
    cuts: Sequence[Slice],
    draw: Callable[[int, Slice, Float], Float],
    progress: Progress,
) -> list[Float]:
    """A label (H, W, 3) for each plane by itself: `draw` makes it from its number, its cut and an even grey start."""
    pictures = []
    for index, cut in enumerate(cuts):
        start = np.where(cut.condition.inside[..., None], cut.condition.render, np.float32(1.0))
        pictures.append(draw(index, cut, start))
        progress((index + 1) / len(cuts))
    return pictures


def written_back(atoms: Atoms, cuts: Sequence[Section], pictures: Sequence[Float]) -> tuple[Float, NDArray[np.bool_]]:
    """(I, 3). Each interior atom's mean over the label pixels that show it; and which atoms (I,) are shown at all."""
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
    return rgb, shown


def nearest_colours(means: Float, rgb: Float) -> Colours:
    """Colours at any point: those (I, 3) of the nearest of some atoms (I, 3)."""
    tree = cKDTree(means)
    return lambda points: np.clip(rgb[tree.query(points, workers=-1)[1]], 0, 1)


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
