"""The kernel field against its formula in float64."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from engine.render.cpu.kernel_field import KernelField
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.constants import LATTICE_DENSITY
from tests.helpers.solids import ball, rows_of, scatter
from tests.reference.opaque import kernel_field


@pytest.mark.parametrize("atoms", [ball(0.1), scatter(40, 60), scatter(0, 30), scatter(30, 0)])
def test_meets_the_formula(atoms: Atoms) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.7, 0.7, (1500, 3)).astype(np.float32)
    footprint = rng.choice([0.0, 0.005, 0.05, 0.3, 3.0], len(points))
    rgb, density = KernelField(atoms).at(points, footprint)
    true_rgb, true_density = kernel_field(atoms, points, footprint)
    assert np.abs(density - true_density).max() < 2e-5
    # A colour is a quotient: where density is almost zero, it has few digits.
    assert np.abs((rgb - true_rgb) * true_density[:, None]).max() < 2e-5


def test_entries_are_the_terms_of_the_sums() -> None:
    atoms = ball(0.12)
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (400, 3))
    footprint = np.linspace(0, 0.2, len(points))
    offsets, atom, weight = KernelField(atoms).entries(points, footprint)
    _, density = KernelField(atoms).at(points, footprint)
    sums = [weight[a:b].sum() for a, b in pairwise(offsets)]
    np.testing.assert_allclose(sums, density, rtol=1e-5, atol=1e-6)
    assert all(len(set(atom[a:b])) == b - a for a, b in pairwise(offsets))


def test_skin_is_not_seen_through_what_fills_the_body() -> None:
    """Skin that reaches in from the surface, however much, colours only what lies outside the lattice."""
    side = np.arange(-6, 7, dtype=np.float32)
    lattice = np.stack(np.meshgrid(side, side, side), -1).reshape(-1, 3)
    inside = InteriorAtoms(lattice, np.full(len(lattice), 0.5, np.float32), np.zeros_like(lattice))
    count = 50
    means = np.random.default_rng(5).uniform(-6, 6, (count, 3)).astype(np.float32)
    means[:, 2] = 6.5
    turns = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    white = np.full((count, 1, 3), 0.5 / sh.C0, np.float32)
    skin = SurfaceAtoms(means, np.full((count, 3), 2, np.float32), turns, white)
    field = KernelField(Atoms(skin, inside, 1.0))
    deep, edge, out = (np.array([[x, y, z] for x in (-2.0, 0.3) for y in (-1.0, 2.4)]) for z in (4.4, 6.2, 8.0))
    assert field.at(deep)[0].max() == 0
    assert np.all((field.at(edge)[0] > 0.01) & (field.at(edge)[0] < 0.8))
    assert field.at(out)[0].min() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("atoms", [ball(0.12), scatter(60, 80)])
@pytest.mark.parametrize("footprint", [0.0, 0.02, 0.3])
def test_a_picture_of_a_plane_has_the_same_entries(atoms: Atoms, footprint: float) -> None:
    x, y = np.meshgrid(np.linspace(-0.9, 0.8, 37), np.linspace(-0.7, 0.9, 29))
    across, down = np.array([0.8, 0.6, 0.0]), np.array([-0.3, 0.4, 0.7])  # neither level nor orthogonal
    points = 0.1 + x[..., None] * across + y[..., None] * down
    field = KernelField(atoms)
    one, other = field.entries(points.reshape(-1, 3), footprint), field.entries_on(points, footprint)
    assert len(one[1]) > 1000
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_filled_lattice_has_the_lattice_density_at_any_footprint() -> None:
    side = np.arange(-12, 13, dtype=np.float32)
    points = np.stack(np.meshgrid(side, side, side), -1).reshape(-1, 3)
    inside = InteriorAtoms(points, np.full(len(points), 0.5, np.float32), np.full_like(points, 0.4))
    field = KernelField(rows_of(Atoms(scatter(0, 0).surface, inside, 1.0), np.arange(0), np.arange(len(points))))
    ask = np.random.default_rng(3).uniform(-1, 1, (200, 3))
    for footprint in (0.0, 1.0, 3.0, 6.0):
        rgb, density = field.at(ask, footprint)
        # Cut off at three standard deviations, a Gaussian loses 3 % of its volume.
        np.testing.assert_allclose(density.mean(), 0.97 * LATTICE_DENSITY, rtol=0.01)
        np.testing.assert_allclose(density, 0.97 * LATTICE_DENSITY, rtol=0.08)
        np.testing.assert_allclose(rgb, 0.4, atol=1e-5)


def test_order_and_strays_change_nothing() -> None:
    atoms = ball(0.12)
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.6, 0.6, (500, 3))
    rgb, density = KernelField(atoms).at(points, 0.01)
    mixed = rows_of(atoms, rng.permutation(len(atoms.surface)), rng.permutation(len(atoms.interior)))
    again, d = KernelField(mixed).at(points, 0.01)
    np.testing.assert_allclose(again, rgb, atol=2e-6)
    np.testing.assert_allclose(d, density, atol=2e-6)

    inside = atoms.interior
    far = np.array([[1e6, 0, 0], [-1e7, 3e5, 0]], np.float32)
    strays = InteriorAtoms(
        np.concatenate([inside.means, far]),
        np.concatenate([inside.sigmas, inside.sigmas[:2]]),
        np.concatenate([inside.rgb, inside.rgb[:2]]),
    )
    again, d = KernelField(replace(atoms, interior=strays)).at(points, 0.01)
    np.testing.assert_allclose(again, rgb, atol=2e-6)
    np.testing.assert_allclose(d, density, atol=2e-6)


def test_nothing_and_the_degenerate_are_finite() -> None:
    points = np.array([[0.0, 0, 0], [1e9, 0, 0], [0.1, 0.1, 0.1]])
    for atoms in (scatter(0, 0), scatter(1, 0), scatter(0, 1)):
        rgb, density = KernelField(atoms).at(points, np.array([0.0, 1e-30, 1e30]))
        assert np.isfinite(rgb).all()
        assert np.isfinite(density).all()
    flat = scatter(3, 3)
    flat.surface.scales[:] = np.array([[0, 0, 0], [1e-20, 1, 1], [1e9, 1e-9, 1]])
    flat.surface.quats[0] = 0
    flat.interior.sigmas[:] = [0, 1e-30, 1e9]
    rgb, density = KernelField(flat).at(points, 0.1)
    assert np.isfinite(rgb).all()
    assert np.isfinite(density).all()
    rgb, density = KernelField(flat).at(np.zeros((0, 3)))
    assert rgb.shape == (0, 3)
