"""Fits the skin to the capture: means, scales, rotations and colours of the surface atoms together.

An atom is opaque where a Gaussian of the capture was translucent, so what lies in front, how large it is and what it is
mixed with have to be found anew. Adam through the differentiable opaque image does it (DESIGN, section 4.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from engine.fit.differentiable import AtomTensors, opaque_image
from engine.render.classic import rasterizer as classic
from engine.render.cpu.opaque import render
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.sh import C0

__all__ = ["fit_skin"]

MEAN_RATE = 0.03
SCALE_RATE = 0.06
QUAT_RATE = 0.015
COLOUR_RATE = 0.03
"""Adam's initial learning rates; all fall to 0 as a cosine. A mean moves in units of its atom's middle scale: with
steps of one length for all, the smallest atoms, which draw the details, are thrown about (2 dB on a capture of a box).
Scales are logarithms; twice or half of any rate changes unseen views by less than 0.3 dB."""

BETAS = (0.9, 0.99)
"""Decay rates of Adam's moments; the second forgets faster than usual, as a fit has some hundred steps."""

VIEWS_PER_STEP = 2
"""One over white, on which captures are mostly looked at, and one over a random colour, in turns by step."""

HUBER = 0.1
"""Colour difference from which the loss grows linearly: edges that a pixel cannot resolve do not outweigh texture."""

HELD_OUT = 12
"""One view in this many is held out and decides whether the result is better."""

SMALLEST = 1 / 64
"""Pitches. Least scale: an atom that shrinks to it is no longer visible."""

WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Target:
    """The capture from one camera."""

    camera: Camera
    rgb: torch.Tensor
    """(H, W, 3). Over black."""
    alpha: torch.Tensor
    """(H, W, 1). Range [0, 1]."""

    @staticmethod
    def of(gaussians: Gaussians, camera: Camera) -> Target:
        """Draws the capture."""
        picture = classic.render(gaussians, camera)
        return Target(camera, torch.from_numpy(picture.rgb), torch.from_numpy(picture.alpha[..., None]))

    def over(self, background: Sequence[float]) -> torch.Tensor:
        """(H, W, 3). The picture over a background (3,)."""
        return self.rgb + (1 - self.alpha) * torch.tensor(background, dtype=torch.float32)


def fit_skin(
    atoms: Atoms,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    steps: int,
    seed: int = 0,
    progress: Callable[[float], None] = lambda part: None,
) -> Atoms:
    """The atoms with a skin fitted to the capture, without its haze, in the views of at least two cameras.

    Every other step has a random background, so that a translucent edge of the capture becomes an edge of the same
    place, not a band in the background's colour. Scales stay under the pitch, degree-0 colours in [0, 1]; the number
    and the order of the atoms stay. If held-out views do not improve, the atoms are returned unchanged. Bit-equal for
    the same input and seed.
    """
    assert len(cameras) > 1, len(cameras)
    targets = []
    for index, camera in enumerate(cameras):
        targets.append(Target.of(gaussians, camera))
        progress(0.2 * (index + 1) / len(cameras))
    held_out = targets[::HELD_OUT]
    views = [target for index, target in enumerate(targets) if index % HELD_OUT]
    interior = atoms.interior
    exposed = slice(interior.exposed)
    shown = InteriorAtoms(interior.means[exposed], interior.sigmas[exposed], interior.rgb[exposed], interior.exposed)
    start = AtomTensors.of(replace(atoms, interior=shown))
    unit = start.scales.median(dim=1, keepdim=True).values
    low, high = math.log(SMALLEST * atoms.pitch), math.log(atoms.pitch)
    moves = torch.zeros_like(start.means).requires_grad_()
    sizes = start.scales.log().clamp(low, high).requires_grad_()
    quats = start.quats.clone().requires_grad_()
    colours = start.sh.clone().requires_grad_()
    rates = ((moves, MEAN_RATE), (sizes, SCALE_RATE), (quats, QUAT_RATE), (colours, COLOUR_RATE))
    # Without epsilon: the gradient of a mean picture error is far smaller than Adam's usual one.
    optimiser = torch.optim.Adam([{"params": [p], "lr": rate} for p, rate in rates], betas=BETAS, eps=1e-15)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))

    def current() -> AtomTensors:
        return replace(start, means=start.means + moves * unit, scales=sizes.exp(), quats=quats, sh=colours)

    rng = np.random.default_rng(seed)
    waiting: list[int] = []
    for step in range(steps):
        optimiser.zero_grad()
        for _ in range(VIEWS_PER_STEP):
            waiting = waiting or rng.permutation(len(views)).tolist()
            view = views[waiting.pop()]
            background = rng.random(3).tolist() if step % 2 else WHITE
            image, _ = opaque_image(current(), view.camera, background=background)
            torch.nn.functional.huber_loss(image, view.over(background), delta=HUBER).backward()
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            sizes.clamp_(low, high)
            colours[:, 0].clamp_(-0.5 / C0, 0.5 / C0)
        progress(0.2 + 0.8 * (step + 1) / steps)
    with torch.no_grad():
        found = current()
        surface = SurfaceAtoms(
            found.means.numpy(),
            np.minimum(found.scales.numpy(), np.float32(atoms.pitch)),
            torch.nn.functional.normalize(found.quats, dim=1).numpy(),
            found.sh.numpy().copy(),
        )
    fitted = replace(atoms, surface=surface)
    return fitted if _error(fitted, held_out) < _error(atoms, held_out) else atoms


def _error(atoms: Atoms, held_out: Sequence[Target]) -> float:
    """Mean squared error over white."""
    errors = [
        float(((torch.from_numpy(render(atoms, target.camera).rgb) - target.over(WHITE)) ** 2).mean())
        for target in held_out
    ]
    return float(np.mean(errors))
