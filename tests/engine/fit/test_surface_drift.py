"""Joint training must not spoil the skin: the surface views hold it against the sections."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch

from engine.fit.sh_fit import SurfaceView, fit_sh
from engine.fit.view_weights import ViewWeights
from engine.render.cpu import opaque
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.camera import cameras_around, section
from engine.scene.plane import Plane
from tests.helpers.solids import ball
from training.families import Family
from training.optimise.trainer import Trainer
from training.views import ENTRIES, Section

UP = np.array([0.0, 0.0, 1.0])


def views_of(truth: Atoms, atoms: Atoms, count: int, turn: float) -> list[SurfaceView]:
    views = []
    for camera in cameras_around(np.zeros(3), 0.55, UP, count, 96, turn):
        seen = opaque.render(truth, camera)
        weights = ViewWeights.surface(atoms, camera).truncated(ENTRIES)
        views.append(SurfaceView(camera, weights, seen.rgb, seen.alpha > 0.95))
    return views


def psnr(views: list[SurfaceView], atoms: Atoms) -> float:
    """PSNR of the views in the full renderer."""
    wrong = [(opaque.render(atoms, v.camera).rgb - v.target)[v.opaque] for v in views]
    return float(-10 * np.log10(np.square(np.concatenate(wrong)).mean()))


def test_the_surface_stays_within_a_fifth_of_a_decibel() -> None:
    truth, plain = ball(0.06, seed=1, degree=1), ball(0.09)
    inner = plain.interior
    grey = InteriorAtoms(inner.means, inner.sigmas, np.full_like(inner.rgb, 0.5))
    views = views_of(truth, Atoms(plain.surface, grey, plain.pitch), 12, 0.0)
    atoms = fit_sh(Atoms(plain.surface, grey, plain.pitch), views).atoms
    low_high = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
    cuts, labels = [], []
    for height in np.linspace(-0.4, 0.4, 9):
        plane = Plane.of((0, 0, 1), -height)
        camera = section(plane, UP, low_high, 64, 0.55)
        weights = ViewWeights.section(atoms, plane, camera).truncated(ENTRIES)
        none = cast(Any, None)  # not used by the trainer
        cuts.append(
            Section(family=Family("horizontal", 9), plane=plane, camera=camera, points=none, inside=none, body=none,
                    extent=none, weights=weights)
        )  # fmt: skip
        label = torch.tensor([0.9, 0.1, 0.1]).expand(64, 64, 3).clone()  # red up to the rim, where green skin is cut
        label[~torch.from_numpy(weights.pixels.reshape(64, 64))] = 1.0
        labels.append(label)
    held_out = views_of(truth, atoms, 6, 0.4)
    before = psnr(held_out, atoms)
    cuts, labels = 8 * cuts, 8 * labels  # as many as in a run: the decay of the steps depends on it
    trainer = Trainer(atoms, cuts, views, seed=0)
    first = trainer.section_losses(labels).mean()
    for _ in range(40):
        trainer.step(labels)
    assert trainer.section_losses(labels).mean() < first - 0.02
    assert psnr(held_out, trainer.result()) > before - 0.2
    assert trainer.render(cuts[4])[32, 32] @ [1, -1, 0] > 0.05
