"""Sizes for the atoms of a skin: how large each is decides how much of its neighbours it hides.

Twenty steps at 256 pixels, after the fit of the colours, bring held-out views of a captured donut 1.9 dB.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from engine.fit.differentiable import AtomTensors, opaque_image
from engine.render.classic import rasterizer as classic
from engine.render.cpu.opaque import render
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.sh import C0

__all__ = ["reshape"]

SIZE_RATE = 0.03
COLOUR_RATE = 0.03
"""Adam's steps at the start, in the logarithm of a scale and in units of the harmonics; both fall to 0 as a cosine.
Steps for the places were tried: they blurred what the capture drew with its smallest Gaussians."""

HELD_OUT = 6
"""One view in this many is not learnt from and judges the result."""

VIEWS_PER_STEP = 2

OPAQUE, EMPTY = 0.95, 0.02
"""Alpha of the capture from which a pixel shows the object alone, and up to which it shows none."""

SMALLEST = 1 / 64
"""Pitches. Shortest axis: an atom that shrinks to it has left the picture."""


def reshape(
    atoms: Atoms,
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    steps: int,
    seed: int = 0,
    progress: Callable[[float], None] = lambda part: None,
) -> Atoms:
    """The atoms with scales and harmonics of the surface that show what the cameras see of the capture better.

    Atoms that were drawn behind others in the capture lie in one blended layer once all are opaque; here they shrink
    out of the way. Adam through the differentiable opaque image; scales stay under the pitch, degree-0 colours in
    [0, 1]. Pixels where the capture is neither opaque nor empty are no evidence. Views that were held out decide
    whether the atoms stay as they were. Bit-equal for the same input and seed.
    """
    judges = [(camera, *_seen(gaussians, camera)) for camera in cameras[::HELD_OUT]]
    cameras = [camera for index, camera in enumerate(cameras) if index % HELD_OUT]
    views = [_seen(gaussians, camera) for camera in cameras]
    i = atoms.interior
    shown_inside = InteriorAtoms(i.means[: i.exposed], i.sigmas[: i.exposed], i.rgb[: i.exposed], i.exposed)
    start = AtomTensors.of(replace(atoms, interior=shown_inside))
    sizes = start.scales.clamp(min=SMALLEST * atoms.pitch).log().requires_grad_()
    colours = start.sh.clone().requires_grad_()
    optimiser = torch.optim.Adam(
        [{"params": [sizes], "lr": SIZE_RATE}, {"params": [colours], "lr": COLOUR_RATE}], betas=(0.9, 0.99)
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(steps, 1))
    rng = np.random.default_rng(seed)
    low, high = math.log(SMALLEST * atoms.pitch), math.log(atoms.pitch)
    for step in range(steps):
        optimiser.zero_grad()
        for index in rng.choice(len(views), min(VIEWS_PER_STEP, len(views)), replace=False):
            target, evidence = views[index]
            shown, _ = opaque_image(replace(start, scales=sizes.exp(), sh=colours), cameras[index])
            (evidence * (shown - target) ** 2).mean().backward()
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            sizes.clamp_(low, high)
            colours[:, 0].clamp_(-0.5 / C0, 0.5 / C0)
        progress((step + 1) / steps)
    surface = replace(
        atoms.surface,
        scales=np.minimum(sizes.detach().exp().numpy(), np.float32(atoms.pitch)),
        sh=colours.detach().numpy(),
    )
    better = replace(atoms, surface=surface)
    return better if _error(better, judges) < _error(atoms, judges) else atoms


def _error(atoms: Atoms, judges: Sequence[tuple[Camera, torch.Tensor, torch.Tensor]]) -> float:
    """Mean squared error of the full renderer where the capture is evidence."""
    wrong = [
        float((evidence * (torch.from_numpy(render(atoms, camera).rgb) - target) ** 2).mean())
        for camera, target, evidence in judges
    ]
    return float(np.mean(wrong))


def _seen(gaussians: Gaussians, camera: Camera) -> tuple[torch.Tensor, torch.Tensor]:
    """The capture over white (H, W, 3), and 1 where it is evidence (H, W, 1)."""
    picture = classic.render(gaussians, camera, (1.0, 1.0, 1.0))
    evidence = (picture.alpha >= OPAQUE) | (picture.alpha <= EMPTY)
    return torch.from_numpy(np.clip(picture.rgb, 0, 1)), torch.from_numpy(evidence[..., None].astype(np.float32))
