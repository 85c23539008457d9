"""The fit of the skin's colours: finds the true ones, needs no more bands than they have, leaves the unseen alone."""

from __future__ import annotations

import numpy as np
import pytest

from engine.fit.sh_fit import SurfaceView, fit_sh, predict
from engine.fit.view_weights import ViewWeights
from engine.scene.atoms import NO_INTERIOR, Atoms, SurfaceAtoms
from engine.scene.camera import cameras_around
from tests.helpers.solids import unturned


def sphere(bands: int, seed: int) -> Atoms:
    rng = np.random.default_rng(seed)
    place = np.random.default_rng(0)
    means = place.standard_normal((1500, 3)).astype(np.float32)
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    sh = rng.normal(0, 0.5, (len(means), bands, 3)).astype(np.float32)
    sh[:, 1:] = np.linspace(-0.6, 0.6, 3 * (bands - 1)).reshape(bands - 1, 3)  # the same sheen everywhere
    scales = np.full((len(means), 3), 0.04, np.float32)
    return Atoms(SurfaceAtoms(means, scales, unturned(len(means)), sh), NO_INTERIOR, 0.05)


def views_of(atoms: Atoms, count: int = 36) -> list[SurfaceView]:
    views = []
    for camera in cameras_around((0, 0, 0), 1.1, (0, 0, 1), count, 72):
        weights = ViewWeights.surface(atoms, camera)
        blank = np.zeros((72, 72, 3), np.float32)
        view = SurfaceView(camera, weights, blank, weights.alpha.reshape(72, 72) > 0.95)
        views.append(SurfaceView(camera, weights, predict(view, atoms, atoms.surface.sh), view.opaque))
    return views


@pytest.mark.parametrize("bands", [1, 4])
def test_the_fit_finds_the_colours_and_no_more_bands_than_they_have(bands):
    truth = sphere(bands, 1)
    start = sphere(9, 2)
    s = truth.surface
    blurred = Atoms(SurfaceAtoms(s.means, s.scales, s.quats, start.surface.sh), truth.interior, truth.pitch)
    result = fit_sh(blurred, views_of(truth))
    assert result.degree == round(bands**0.5) - 1
    assert result.held_out[1] > result.held_out[0] + 10


def test_what_is_right_already_stays_to_the_bit():
    atoms = sphere(1, 1)
    assert (fit_sh(atoms, views_of(atoms, 8)).atoms.surface.sh == atoms.surface.sh).all()
