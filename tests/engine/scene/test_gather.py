"""Gathering a large capture into fewer Gaussians."""

from __future__ import annotations

import numpy as np

from engine.render.classic.rasterizer import render
from engine.scene.camera import orbit
from engine.scene.gather import gathered
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import rotation_matrices
from engine.scene.sh import rgb_to_sh
from tests.helpers.solids import sphere


def painted(count: int) -> Gaussians:
    """A sphere with soft bands of colour."""
    ball = sphere(count)
    rgb = 0.5 + 0.4 * np.sin(3 * ball.means)
    ball.sh[:, 0] = rgb_to_sh(rgb.astype(np.float32))
    return ball


def covariance(g: Gaussians, weight: np.ndarray) -> np.ndarray:
    """(3, 3). Covariance of the whole mixture, about the origin."""
    axes = rotation_matrices(g.quats.astype(np.float64)) * g.scales[:, None]
    return np.einsum("n,nij->ij", weight, axes @ axes.transpose(0, 2, 1) + g.means[:, :, None] * g.means[:, None])


def test_a_gathered_sphere_looks_the_same() -> None:
    many = painted(60_000)
    few = gathered(many, 25_000)
    assert 20_000 < len(few) <= 25_000
    for azimuth in (0, 100):
        camera = orbit([0, 0, 0], [0, 0, 1], azimuth, 30, 3.5, 160, 160)
        a, b = render(many, camera), render(few, camera)
        inside = a.alpha > 0.9
        assert -10 * np.log10(((a.rgb - b.rgb)[inside] ** 2).mean()) > 30
        assert np.percentile(b.alpha[inside], 1) > 0.9  # no holes, except at the outline
        assert (np.abs(a.alpha - b.alpha) > 0.5).mean() < 0.005


def test_a_pair_becomes_its_moments() -> None:
    """Two equal Gaussians in a cell, far from all others, have the mean, covariance and light of the mixture."""
    ball = painted(300)
    pair = Gaussians(
        np.array([[0.001, 0, 0], [-0.001, 0, 0]], np.float32),
        np.full((2, 3), 0.004, np.float32),
        np.array([[1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5]], np.float32),
        np.array([0.4, 0.4], np.float32),
        rgb_to_sh(np.array([[[0.2, 0.4, 0.6]], [[0.4, 0.4, 0.2]]], np.float32)),
    )
    both = Gaussians(*(np.concatenate([getattr(ball, n), getattr(pair, n)]) for n in NAMES))
    few = gathered(both, 301)
    (row,) = np.flatnonzero(np.linalg.norm(few.means, axis=1) < 0.5)
    one = few[row : row + 1]
    assert np.abs(one.means).max() < 1e-6
    light = -2 * np.log(1 - 0.4) * 0.004**2
    spread = np.sort(np.linalg.eigvalsh(covariance(pair, np.array([0.5, 0.5]))))
    assert one.scales[0].min() ** 2 == np.float32(spread[0])
    wide = np.sort(one.scales[0].astype(np.float64))[1:]
    assert np.isclose(-np.log(1 - one.opacities[0]) * wide.prod(), light, rtol=1e-4)
    assert np.allclose(one.sh[0, 0], pair.sh[:, 0].mean(0), atol=1e-6)


NAMES = ("means", "scales", "quats", "opacities", "sh")


def test_few_stay_as_they_are_and_many_are_gathered_the_same_every_time() -> None:
    many = painted(20_000)
    assert gathered(many, 20_000) is many
    a, b = gathered(many, 3000), gathered(many, 3000)
    assert all(np.array_equal(getattr(a, n), getattr(b, n)) for n in NAMES)
    big = Gaussians(many.means, many.scales * 50, many.quats, many.opacities, many.sh)
    kept = gathered(big, 3000)
    assert len(kept) == len(big) and np.array_equal(np.sort(kept.means[:, 0]), np.sort(big.means[:, 0]))
