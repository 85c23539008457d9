"""The training pipeline without each of its parts in turn, and with labels plane by plane as in the paper's loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from engine.fit.sh_fit import SurfaceView
from engine.fit.view_weights import ViewWeights
from engine.render.classic.differentiable import rasterize
from engine.render.cpu.kernel_field import KernelField
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.camera import Camera
from engine.scene.plane import Plane
from engine.solid.fill import Colours, fill
from training.evaluate.cuts import Cut
from training.evaluate.methods.method import MethodResult, run_pipeline
from training.evaluate.methods.patch_denoiser import PatchDenoiser
from training.evaluate.scenes import CustomRequest, EvaluationScene
from training.labels import blank_label, make_prior
from training.optimise.trainer import Trainer
from training.pipeline import Pipeline
from training.priors.prior import Denoiser
from training.priors.sds import distill
from training.request import Geometry, Request
from training.views import BACKGROUND, Section, Slice

__all__ = [
    "CAP_FACTOR",
    "Independent",
    "IndependentByNoise",
    "Looped",
    "LoopedWithoutSmoothing",
    "UniformFill",
    "UnsmoothedTrainer",
    "WithoutOpacification",
    "WithoutRefinement",
    "WithoutSmoothing",
    "make_denoiser",
    "without_clipping",
    "without_opacification",
]

Float = NDArray[np.float32]

NOISE_STEP = 0.5
"""Step of the noise-prediction form in units of sigma^2; a step of 1 reaches the denoised picture."""

CAP_FACTOR = 4
"""Factor on the scale cap that stands for no cap: the smallest atom is then larger than a seed."""


class WithoutRefinement(Pipeline):
    """Labels are never refined."""

    refines = False


class UniformFill(Pipeline):
    """Atoms are as fine everywhere as ours are where colours vary."""

    def fill_interior(self, geometry: Geometry, pitch: float, colours: Colours) -> InteriorAtoms:
        """One atom for every cell of the finest lattice."""
        interior = fill(geometry.body, pitch, self.request.seed)
        return replace(interior, rgb=colours(interior.means).astype(np.float32))


class UnsmoothedTrainer(Trainer):
    """A trainer whose atoms keep their initial colour if no view shows them."""

    def smooth(self) -> None:
        """Does nothing."""


class WithoutSmoothing(Pipeline):
    """No voxel smoothing."""

    def smooth_interior(self, interior: InteriorAtoms, rgb: Float, covered: NDArray[np.bool_]) -> Float:
        """The colours as they are."""
        return rgb

    def make_trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """A trainer that does not smooth."""
        return UnsmoothedTrainer(atoms, faces, surfaces, self.request.seed)


def make_denoiser(request: Request) -> Denoiser:
    """A denoising prior: the request's own, or for exemplars the denoiser of their patches."""
    prior = PatchDenoiser() if request.prior == "exemplar" else make_prior(request)
    assert isinstance(prior, Denoiser), prior
    return prior


class Looped(Pipeline):
    """A label for each plane on its own, refined from the render: the paper's own loop."""

    def make_prior(self) -> Denoiser:
        """A denoiser instead of a prior that solves a volume."""
        return make_denoiser(self.request)


class LoopedWithoutSmoothing(Looped, WithoutSmoothing):
    """The paper's loop without voxel smoothing."""


class Independent(Looped):
    """A label for each plane on its own, drawn once."""

    refines = False


class IndependentByNoise(Independent):
    """A label for each plane on its own, down the gradient of the paper's eq. 5."""

    def draw_label(self, prior: Denoiser, cut: Slice, rng: np.random.Generator) -> Float:
        """Distills in steps of half the length."""
        return distill(blank_label(cut.condition), prior, cut.condition, rng, step=NOISE_STEP)


def without_clipping(scene: EvaluationScene, request: CustomRequest, out: Path) -> MethodResult:
    """The same pipeline with a scale cap that no Gaussian of the capture reaches."""
    numbers = request.numbers
    wide = replace(numbers, cells=max(8, numbers.cells // CAP_FACTOR), fine=max(8, numbers.fine // CAP_FACTOR))
    return run_pipeline(replace(request, numbers=wide), out)


@dataclass(frozen=True)
class Composited(ViewWeights):
    """A cut face as 3DGS renders it: atoms behind the plane, alpha-blended by depth."""

    rows: NDArray[np.intp]
    arrays: tuple[Tensor, Tensor, Tensor, Tensor]
    """Means, scales, quaternions and opacities of the rows."""
    camera: Camera

    def picture(self, coefficients: Tensor, rgb: Tensor, background: Sequence[float] | Tensor = BACKGROUND) -> Tensor:
        """(H, W, 3). The picture, differentiable in both kinds of colours."""
        skin = (0.5 + sh.C0 * coefficients[:, 0]).clamp(min=0)
        colours = torch.cat([skin, rgb])[torch.from_numpy(self.rows)]
        return rasterize(*self.arrays, colours, self.camera, tuple(float(b) for b in background))[0]


SLAB = 8
"""Depth behind the plane that is blended, in pitches: less than a hundredth passes through more."""


def composited(atoms: Atoms, section: ViewWeights, plane: Plane, camera: Camera) -> Composited:
    """The view of a plane with opacities of atoms drawn uniformly from 0 to 1."""
    gaussians = atoms.as_gaussians(1.0)
    opacities = np.random.default_rng(11).uniform(0, 1, len(gaussians)).astype(np.float32)
    distance = plane.distance(gaussians.means)
    rows = np.flatnonzero((distance <= 0) & (distance > -SLAB * atoms.pitch))
    values = (gaussians.means, gaussians.scales, gaussians.quats, opacities)
    known: dict[str, Any] = {field.name: getattr(section, field.name) for field in fields(ViewWeights)}
    means, scales, quats, opacity = (torch.from_numpy(np.ascontiguousarray(a[rows])) for a in values)
    return Composited(**known, rows=rows, arrays=(means, scales, quats, opacity), camera=camera)


class Translucent(Trainer):
    """Trains on cut faces that 3DGS blends."""

    def __init__(self, *of: Any) -> None:
        super().__init__(*of)
        self.sections = [
            replace(cut, weights=composited(self.atoms, cut.weights, cut.plane, cut.camera)) for cut in self.sections
        ]


class WithoutOpacification(Pipeline):
    """Translucent atoms in training."""

    trains = True

    def make_trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """A trainer whose cut faces are alpha-blended."""
        return Translucent(atoms, faces, surfaces, self.request.seed)


def without_opacification(scene: EvaluationScene, request: CustomRequest, out: Path) -> MethodResult:
    """Translucent atoms, in training and in the rendered cuts."""
    made = run_pipeline(request, out, WithoutOpacification)
    field = KernelField(made.atoms)
    sh_, rgb = (torch.from_numpy(a) for a in (made.atoms.surface.sh, made.atoms.interior.rgb))

    def show(_: int, cut: Cut) -> Float:
        known = ViewWeights.section(made.atoms, cut.plane, cut.camera, field)
        view = composited(made.atoms, known, cut.plane, cut.camera)
        with torch.no_grad():
            return np.clip(view.picture(sh_, rgb).numpy(), 0, 1)

    return replace(made, show=show)
