"""Fits the skin to the capture: means, scales, rotations and colours of the surface atoms together.

An atom is opaque where a Gaussian of the capture was translucent, so what lies in front, how large it is and what it is
mixed with have to be found anew, by Adam through the differentiable opaque image.

A crack in the skin of a whole solid shows the far side, in about the right colour, so nothing would close it; a cut
that takes the far side away shows the crack as a speck of background. Half of the steps therefore leave out what the
solid hides, over backgrounds of any colour.

The fit begins with steps that are large compared with the errors of a nearly perfect skin, such as a scan's, and ends
at the level that steps of one view each allow. A skin that begins above that level is left as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from engine.fit.adam import Adam
from engine.fit.differentiable import AtomTensors, opaque_image
from engine.fit.occlusion import CoreView, core_of, view_of_core
from engine.render.classic import rasterizer as classic
from engine.render.cpu.opaque import render
from engine.scene.atoms import NO_INTERIOR, Atoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.constants import MIN_WEIGHT
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.sh import C0

__all__ = ["SkinFit"]

RATES = {"moves": 0.03, "sizes": 0.06, "quats": 0.015, "colours": 0.03}
"""Adam's initial learning rates; all fall to 0 as a cosine. A mean moves in units of its atom's middle scale: with
steps of one length for all, the smallest atoms, which draw the details, are thrown about (2 dB on a capture of a box).
Sizes are logarithms of scales; doubling or halving any rate changes unseen views by less than 0.3 dB."""

BETAS = (0.9, 0.99)
"""Decay rates of Adam's moments; the second forgets faster than usual, as a fit has only a few hundred steps."""

HUBER = 0.1
"""Colour difference from which the loss grows linearly: edges that a pixel cannot resolve do not outweigh texture."""

SHOWN = 0.5
"""Alpha from which a pixel belongs to a silhouette."""

FADE = 3.0
"""Slope at which the capture's alpha falls to 0 below SHOWN, at a third. Opaque atoms would draw its soft rim as dots
and hairs of the right coverage, which a closer look shows: at four times the pixels of the fit, outlines of a guitar, a
person and a box are 1.36, 1.22 and 1.17 times as long as the capture's, and with this slope 1.09, 1.03 and 0.91. At the
pixels of the fit this costs 0.4, 0.0 and 0.0 dB, and four times as near it gains 1.3, 0.7 and 0.2. Slopes of 2 and 4
are a step of the same exchange away; steeper above SHOWN as well, fits lose 0.6 to 2.5 dB."""

HELD_OUT = 12
"""One view in this many is held out and decides whether the result is better."""

FAITHFUL = 38.0
"""dB at held-out views from which a skin is not fitted. Fits of captures end below it at unseen views (donut 37.7,
plant 32.6), and the scans of an orange and an apple went from 40.1 and 39.6 down to 39.3 and 38.7. Steps of a tenth or
a twentieth gain nothing there either: what the texture wins, the outline loses."""

SMALLEST = 1 / 64
"""Pitches. Least scale: an atom that shrinks to it is no longer visible."""

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Target:
    """The capture from one camera, without the part of its rim that is mostly transparent."""

    camera: Camera
    rgb: torch.Tensor
    """(H, W, 3). Over black, in half precision, as a hundred of these are held."""
    alpha: torch.Tensor
    """(H, W, 1). Range [0, 1], in half precision."""

    @staticmethod
    def of(gaussians: Gaussians, camera: Camera) -> Target:
        """Draws the capture."""
        picture = classic.render(gaussians, camera)
        there = picture.alpha[..., None]
        alpha = np.where(there < SHOWN, np.maximum(SHOWN - FADE * (SHOWN - there), 0), there)
        rgb = picture.rgb * (alpha / np.maximum(there, MIN_WEIGHT))
        return Target(camera, torch.from_numpy(rgb).half(), torch.from_numpy(alpha).half())

    def over(self, background: Sequence[float]) -> torch.Tensor:
        """(H, W, 3). The picture over a background (3,)."""
        return self.rgb.float() + (1 - self.alpha.float()) * torch.tensor(background, dtype=torch.float32)


class SkinFit:
    """A fit of the skin to the capture, one view a step. Bit-equal for the same input and seed, interrupted or not.

    Half as many steps of two views each cost the same and give 0.2 dB less. Every other step is over white, on which
    captures are mostly viewed. The others have a random background, so that a translucent edge of the capture becomes
    an edge in the same place, not a band in the background's colour; they show only the skin that the core of the body
    leaves in sight (`engine.fit.occlusion`), so that a crack in it becomes skin. Scales stay below the pitch, degree-0
    colours in [0, 1]; the number and the order of the atoms stay.
    """

    def __init__(
        self,
        atoms: Atoms,
        gaussians: Gaussians,
        body: Body,
        cameras: Sequence[Camera],
        steps: int,
        seed: int = 0,
        progress: Callable[[float], None] = lambda part: None,
    ) -> None:
        """Draws the capture, without its haze, from at least two cameras. `steps`, at least one, becomes 0 if the skin
        is already FAITHFUL."""
        assert len(cameras) > 1 and steps > 0, (len(cameras), steps)
        self.atoms, self.steps, self.step = atoms, steps, 0
        core = core_of(body, atoms.pitch)

        def seen(some: Sequence[Camera], begin: float) -> tuple[list[Target], list[CoreView]]:
            targets, cores = [], []
            for index, camera in enumerate(some):
                targets.append(Target.of(gaussians, camera))
                cores.append(view_of_core(core, camera, atoms.pitch))
                progress(begin + (index + 1) / len(cameras))
            return targets, cores

        unseen = cameras[::HELD_OUT]
        self.held_out, self.held_out_cores = seen(unseen, 0.0)
        self.start_error = self._error(atoms.surface)
        if self.start_error < 10 ** (-FAITHFUL / 10):
            self.steps = 0
            progress(1.0)
            return
        fitted_to = [camera for index, camera in enumerate(cameras) if index % HELD_OUT]
        self.views, self.cores = seen(fitted_to, len(unseen) / len(cameras))
        rng = np.random.default_rng(seed)
        epochs = -(-steps // len(self.views))
        self.order = np.concatenate([rng.permutation(len(self.views)) for _ in range(epochs)])
        self.backgrounds = rng.random((steps, 3))
        self.backgrounds[::2] = WHITE
        self.start = AtomTensors.of(replace(atoms, interior=NO_INTERIOR))
        self.unit = self.start.scales.median(dim=1, keepdim=True).values
        self.range = math.log(SMALLEST * atoms.pitch), math.log(atoms.pitch)
        self.parameters = {
            "moves": torch.zeros_like(self.start.means),
            "sizes": self.start.scales.log().clamp(*self.range),
            "quats": self.start.quats.clone(),
            "colours": self.start.sh.clone(),
        }
        # Without epsilon: the gradient of a mean picture error is far smaller than Adam's usual one.
        self.adam = Adam(self.parameters, RATES, BETAS, eps=1e-15)

    def advance(self) -> None:
        """Takes one optimisation step."""
        decay = 0.5 * (1 + math.cos(math.pi * self.step / self.steps))
        number, background = self.order[self.step], self.backgrounds[self.step].tolist()
        view, atoms = self.views[number], self._current()
        if self.step % 2:
            atoms = _chosen(atoms, self.cores[number].shown(atoms.means.detach().numpy()))
        image, _ = opaque_image(atoms, view.camera, background=background)
        self.adam.step(torch.nn.functional.huber_loss(image, view.over(background), delta=HUBER), decay)
        with torch.no_grad():
            self.parameters["sizes"].clamp_(*self.range)
            self.parameters["colours"][:, 0].clamp_(-0.5 / C0, 0.5 / C0)
        self.step += 1

    def state(self) -> dict[str, NDArray[np.float32]]:
        """All that changes from step to step, except the step number, for a checkpoint."""
        return self.adam.state()

    def restore(self, state: dict[str, NDArray[np.float32]], step: int) -> None:
        """Restores the state of a checkpoint made after `step` steps."""
        self.adam.restore(state, step)
        self.step = step

    def result(self) -> Atoms:
        """The atoms with the skin fitted so far; unchanged if held-out views did not improve."""
        if not self.steps:
            return self.atoms
        with torch.no_grad():
            found = self._current()
            surface = SurfaceAtoms(
                found.means.numpy(),
                np.minimum(found.scales.numpy(), np.float32(self.atoms.pitch)),
                torch.nn.functional.normalize(found.quats, dim=1).numpy(),
                found.sh.numpy().copy(),
            )
        better = self._error(surface) < self.start_error
        return replace(self.atoms, surface=surface) if better else self.atoms

    def _error(self, surface: SurfaceAtoms) -> float:
        """Mean squared error of a skin where it or the capture shows something in held-out views: whole, and without
        what the solid hides, each over white and over black, so that a crack counts whatever is behind it."""
        total, count = 0.0, 0
        for target, core in zip(self.held_out, self.held_out_cores, strict=True):
            rows = core.shown(surface.means)
            part = SurfaceAtoms(*(array[rows] for array in (surface.means, surface.scales, surface.quats, surface.sh)))
            for some in (surface, part):
                image = render(Atoms(some, NO_INTERIOR, self.atoms.pitch), target.camera, background=BLACK)
                union = (image.alpha > SHOWN) | (target.alpha[..., 0].numpy() > SHOWN)
                for background in (BLACK, WHITE):
                    over = image.rgb + (1 - image.alpha[..., None]) * np.array(background, np.float32)
                    difference = (over - target.over(background).numpy())[union].astype(np.float64)
                    total, count = total + float((difference**2).sum()), count + difference.size
        return total / max(count, 1)

    def _current(self) -> AtomTensors:
        p = self.parameters
        means = self.start.means + p["moves"] * self.unit
        return replace(self.start, means=means, scales=p["sizes"].exp(), quats=p["quats"], sh=p["colours"])


def _chosen(atoms: AtomTensors, rows: NDArray[np.intp]) -> AtomTensors:
    """Some of the surface atoms, and all of the interior."""
    chosen = torch.from_numpy(rows)
    means, scales, quats, sh = (t.index_select(0, chosen) for t in (atoms.means, atoms.scales, atoms.quats, atoms.sh))
    return replace(atoms, means=means, scales=scales, quats=quats, sh=sh)
