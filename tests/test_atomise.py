"""Atomising: what a large Gaussian was its parts are together, and nothing off the skin is kept."""

from __future__ import annotations

import numpy as np
import pytest

from engine.atomise import atomise, split
from engine.body import Body
from engine.gaussians import Gaussians
from engine.kernel_field import axes_of


def gaussians(means, scales, opacities=None, seed=0):
    rng = np.random.default_rng(seed)
    n = len(means)
    quats = rng.standard_normal((n, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    faint = np.ones(n, np.float32) if opacities is None else np.asarray(opacities, np.float32)
    return Gaussians(
        np.asarray(means, np.float32), np.asarray(scales, np.float32), quats, faint, np.zeros((n, 1, 3), np.float32)
    )


@pytest.mark.parametrize("scales", [(0.3, 0.1, 0.02), (0.25, 0.25, 0.25), (0.05, 0.04, 0.01), (0.09, 0.4, 0.1)])
def test_parts_have_the_mean_and_nearly_the_variance_of_the_whole(scales):
    whole = gaussians([[1, 2, 3]], [scales])
    pitch = 0.1
    _, means, parts = split(whole, whole.scales, pitch)
    assert parts.max() <= np.float32(pitch)
    assert np.allclose(means.mean(0), [1, 2, 3], atol=1e-5)
    axes = axes_of(whole.quats)[0].astype(np.float64)
    local = (means - means.mean(0)) @ axes.T
    # Evenly spaced points on [-L, L] have a little more variance than the even density the formula is for.
    variance = local.var(0) + parts[0].astype(np.float64) ** 2
    assert np.allclose(np.sqrt(variance), scales, rtol=0.45)
    assert (np.sqrt(variance) > 0.99 * np.asarray(scales, np.float32)).all()


def test_a_cap_holds_and_counts_are_told():
    made = atomise(gaussians([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0.2] * 3, [0.01] * 3, [0.01] * 3], [1, 1, 0.01]), 0.1)
    assert made.atoms.scales.max() <= np.float32(0.1)
    assert made.split == 1
    assert made.dropped == 1
    assert len(atomise(gaussians(np.zeros((0, 3)), np.zeros((0, 3))), 0.1).atoms) == 0


def test_debris_inside_and_floaters_outside_are_dropped():
    rng = np.random.default_rng(0)
    shell = rng.standard_normal((4000, 3))
    shell /= np.linalg.norm(shell, axis=1, keepdims=True)
    inside, outside = 0.5 * shell[:50], 1.5 * shell[50:60]
    scene = gaussians(np.concatenate([shell, inside, outside]), np.full((4060, 3), 0.03))
    grid = Body(np.full(3, -1.6), 0.05, np.zeros((64, 64, 64), np.float32))
    body = Body(grid.origin, grid.cell, (1 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))
    distance = np.linalg.norm(atomise(scene, 0.06, body).atoms.means, axis=1)
    assert len(distance) >= 4000
    assert distance.min() > 0.9
    assert distance.max() < 1.1
