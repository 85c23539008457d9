"""Joint training of cut faces and surface (paper, sections 3.2 and 3.3). Geometry is frozen: only colours move.

With geometry frozen a picture is linear in the colours (`engine.fit.view_weights`), so a step is two sparse products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from engine.fit.adam import Adam
from engine.fit.sh_fit import SurfaceView
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.sh import C0
from training.optimise.losses import reconstruction
from training.optimise.smoothing import smooth
from training.views import BACKGROUND, Section

__all__ = ["Losses", "Trainer"]

# The paper's alpha for each kind of view: labels are trusted for structure, surface views to the pixel.
SECTION_ALPHA = 0.3
SURFACE_ALPHA = 0.6

# Views per step. The paper takes all sections and 10-20 surface views; a third of the sections, in turns, reaches the
# same loss in a third of the time.
SECTIONS_PER_STEP = 24
SURFACE_VIEWS_PER_STEP = 10

# Learning rates in colour units. The surface starts from the fitted capture and must not drift, so its rate is lower,
# and that of its view-dependent bands lower again (3DGS: a twentieth).
INTERIOR_RATE = 0.005
SURFACE_RATE = 0.001
BANDS_RATE = SURFACE_RATE / 20

# Half-life of the learning rates in epochs (every section once). Adam's steps are as long as the rate however small the
# residual, so colours would end as noise of that size at a constant rate. A refinement round starts afresh.
HALF_LIFE_EPOCHS = 3

# The paper smooths every 30 to 40 iterations.
SMOOTH_EVERY = 30

# Bound on SH coefficients unless the capture exceeds it: far beyond black and white, so that it only keeps divergent
# steps finite.
MAX_SH = 10.0

# Decay rates of Adam's moments (Kingma and Ba 2015); the second forgets faster than their 0.999, as a run has 40 to 200
# steps.
BETAS = (0.9, 0.99)


@dataclass(frozen=True)
class Losses:
    """Mean reconstruction loss of the views of one iteration."""

    section: float
    surface: float


class Trainer:
    """Optimises interior and surface colours towards the labels and the capture."""

    def __init__(
        self,
        atoms: Atoms,
        sections: Sequence[Section],
        surfaces: Sequence[SurfaceView],
        seed: int,
    ) -> None:
        self.atoms = atoms
        self.sections = sections
        self.surfaces = surfaces
        self.seed = seed
        self.iteration = 0
        self.round_start = 0
        """Iteration at which the labels last changed."""
        self.initial = atoms.interior.rgb
        sh = torch.from_numpy(atoms.surface.sh)
        self.parameters = {
            "rgb": torch.from_numpy(atoms.interior.rgb.copy()),
            "sh0": sh[:, :1].clone(),
            "bands": sh[:, 1:].clone(),
        }
        """Interior colours (I, 3), SH coefficients of degree 0 (S, 1, 3) and of the higher bands (S, K - 1, 3)."""
        rates = {"rgb": INTERIOR_RATE, "sh0": SURFACE_RATE / C0, "bands": BANDS_RATE}
        self.adam = Adam(self.parameters, rates, BETAS)
        self.max_sh = max(MAX_SH, float(np.abs(atoms.surface.sh).max(initial=0)))
        # An interior atom is trained if some section shows it.
        self.trained: NDArray[np.bool_] = np.zeros(len(atoms.interior), bool)
        for view in sections:
            columns = view.weights.used - len(atoms.surface)
            self.trained[columns[(columns >= 0) & (columns < len(self.trained))]] = True

    @property
    def steps_per_epoch(self) -> int:
        """Number of steps in an epoch, in which every section is used once."""
        return max(1, -(-len(self.sections) // SECTIONS_PER_STEP))

    @property
    def rgb(self) -> Tensor:
        """(I, 3). The current interior colours, without gradient."""
        return self.parameters["rgb"].detach()

    @property
    def sh(self) -> Tensor:
        """(S, K, 3). The current SH coefficients of the surface, without gradient."""
        return torch.cat([self.parameters["sh0"], self.parameters["bands"]], dim=1).detach()

    def state(self) -> dict[str, NDArray[np.float32]]:
        """All state that changes while training, for a checkpoint: parameters and Adam's moments."""
        return self.adam.state()

    def restore(self, state: dict[str, NDArray[np.float32]], iteration: int, round_start: int) -> None:
        """Restores the state of a checkpoint."""
        self.iteration, self.round_start = iteration, round_start
        self.adam.restore(state, iteration)

    def result(self) -> Atoms:
        """The atoms with their current colours."""
        s, i = self.atoms.surface, self.atoms.interior
        return Atoms(
            SurfaceAtoms(s.means, s.scales, s.quats, self.sh.numpy().copy()),
            InteriorAtoms(i.means, i.sigmas, self.rgb.numpy().copy()),
            self.atoms.pitch,
        )

    def step(self, labels: Sequence[Tensor]) -> Losses:
        """One Adam step on a share of the sections, against their labels (H, W, 3), and some surface views."""
        rng = np.random.default_rng([self.seed, self.iteration])
        order = np.random.default_rng([self.seed, 1, self.iteration // self.steps_per_epoch]).permutation(
            len(self.sections)
        )
        position = self.iteration % self.steps_per_epoch
        chosen = order[position * SECTIONS_PER_STEP : (position + 1) * SECTIONS_PER_STEP]
        views = rng.choice(len(self.surfaces), min(SURFACE_VIEWS_PER_STEP, len(self.surfaces)), replace=False)

        rgb = self.parameters["rgb"]
        sh = torch.cat([self.parameters["sh0"], self.parameters["bands"]], dim=1)
        # Each kind of view contributes its mean, so that neither dominates by number.
        section_loss = torch.zeros(())
        for index in chosen.tolist():
            # Sections train the interior only: their rims would cost the skin 0.7 dB from outside.
            render = self.sections[index].weights.picture(sh.detach(), rgb, BACKGROUND)
            section_loss = section_loss + reconstruction(render, labels[index], SECTION_ALPHA)
        section_loss = section_loss / max(len(chosen), 1)
        surface_loss = torch.zeros(())
        for index in views.tolist():
            view = self.surfaces[index]
            target = torch.from_numpy(view.target)
            # Translucent pixels of the capture do not constrain the colours of opaque atoms.
            opaque = torch.from_numpy(view.opaque)[..., None]
            render = torch.where(opaque, view.weights.picture(sh, rgb, BACKGROUND), target)
            surface_loss = surface_loss + reconstruction(render, target, SURFACE_ALPHA)
        surface_loss = surface_loss / max(len(views), 1)
        self.iteration += 1
        decay = 0.5 ** ((self.iteration - self.round_start) / (HALF_LIFE_EPOCHS * self.steps_per_epoch))
        self.adam.step(section_loss + surface_loss, decay)
        with torch.no_grad():
            rgb.clamp_(0, 1)
            for name in ("sh0", "bands"):
                self.parameters[name].clamp_(-self.max_sh, self.max_sh)
        if self.iteration % SMOOTH_EVERY == 0:
            self.smooth()
        return Losses(section_loss.item(), surface_loss.item())

    def smooth(self) -> None:
        """Voxel smoothing of the atoms that no section shows; trained ones are unchanged."""
        smoothed = smooth(self.atoms.interior.means, self.initial, self.rgb.numpy(), self.trained)
        self.parameters["rgb"].data.copy_(torch.from_numpy(np.clip(smoothed, 0, 1)))

    def render(self, section: Section) -> NDArray[np.float32]:
        """(H, W, 3). The current render of a section, over white."""
        with torch.no_grad():
            return section.weights.picture(self.sh, self.rgb, BACKGROUND).numpy()

    def section_losses(self, labels: Sequence[Tensor]) -> NDArray[np.float64]:
        """(V,). Reconstruction loss of every section; the paper refines until all are below a threshold."""
        with torch.no_grad():
            return np.array(
                [
                    reconstruction(view.weights.picture(self.sh, self.rgb, BACKGROUND), label, SECTION_ALPHA).item()
                    for view, label in zip(self.sections, labels, strict=True)
                ]
            )
