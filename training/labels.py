"""Labels for every cut, from one solved volume or plane by plane (paper, section 3.2), and their colours on atoms."""

from __future__ import annotations

from collections.abc import Sequence
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
from training.priors.prior import Condition, Denoiser, Progress, Volume, VolumeSolver
from training.priors.sds import distill
from training.request import Geometry, Request
from training.views import Section, Slice

__all__ = [
    "back_project",
    "blank_label",
    "label_from_volume",
    "make_prior",
    "nearest_atom_colours",
    "refine_labels",
    "solve_volume",
]

Float = NDArray[np.float32]


def make_prior(request: Request) -> Denoiser | VolumeSolver:
    """The prior of a request. Raises InputError if its model or its packages are missing."""
    if request.prior == "exemplar":
        return ExemplarPrior(request.same)
    if request.model is None:
        raise InputError("--prior stable-diffusion needs a model; give its local folder with --model")
    from training.priors.diffusion import StableDiffusionPrior  # an extra, and slow to import

    return StableDiffusionPrior(request.model, request.thing or request.scene.stem, midas=request.midas)


def solve_volume(request: Request, geometry: Geometry, prior: VolumeSolver, progress: Progress) -> tuple[Volume, float]:
    """The volume of a prior that solves for one, and its coarsening.

    The coarsening is the ratio of the volume's cell to the requested one: more than 1 if the pictures resolve less; the
    atoms may then be coarser too.
    """
    detail = request.fineness
    volume = prior.solve(geometry.body, geometry.up, request.families, detail.voxels, request.seed, progress)
    requested_cell = geometry.pitch * detail.cells / detail.voxels
    cell = volume.body.grid.cell
    return volume, 1.0 if np.isclose(cell, requested_cell) else cell / requested_cell


def label_from_volume(volume: Volume, cut: Slice) -> Float:
    """(H, W, 3). A label as a cut through a volume, so that those of all planes are consistent in space."""
    return np.where(cut.inside[..., None], volume.at(cut.points), np.float32(1.0))


def blank_label(condition: Condition) -> Float:
    """(H, W, 3). A label before anything is drawn: the condition's render inside the silhouette, white outside."""
    return np.where(condition.inside[..., None], condition.render, np.float32(1.0))


def back_project(atoms: Atoms, cuts: Sequence[Section], pictures: Sequence[Float]) -> tuple[Float, NDArray[np.bool_]]:
    """(I, 3), (I,). Each interior atom's weighted mean over the label pixels that show it; whether any pixel does.

    Atoms that no label covers keep their colour.
    """
    start = len(atoms.surface)
    total = np.zeros((len(atoms.interior), 4), np.float64)
    for cut, picture in zip(cuts, pictures, strict=True):
        ones = np.ones(picture.shape, np.float32)
        rows = np.s_[start : start + len(total)]
        total[:, :3] += cut.weights.apply_transposed(picture)[rows]
        total[:, 3] += cut.weights.apply_transposed(ones)[rows, 0]
    covered = total[:, 3] > 0
    rgb = atoms.interior.rgb.copy()
    rgb[covered] = total[covered, :3] / total[covered, 3:]
    return rgb, covered


def nearest_atom_colours(means: Float, rgb: Float) -> Colours:
    """A colour field: at every point the colour (I, 3) of the nearest of the atoms at `means` (I, 3)."""
    tree = cKDTree(means)
    return lambda points: np.clip(rgb[tree.query(points, workers=-1)[1]], 0, 1)


def refine_labels(
    request: Request, trainer: Trainer, prior: Denoiser, labels: list[Tensor], indices: Sequence[int], round_number: int
) -> None:
    """Replaces the labels of some sections, in place, by a few distillation steps from their current render."""
    for index in indices:
        section = trainer.sections[index]
        covered = trainer.render(section)
        rng = np.random.default_rng([request.seed, 2, round_number, index])
        label = distill(covered, prior, replace(section.condition, render=covered), rng, refine=True)
        labels[index] = torch.from_numpy(label)
