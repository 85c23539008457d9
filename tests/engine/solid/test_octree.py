"""The adaptive inside against the uniform fill it stands for, and against colour functions known everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms, InteriorAtoms
from engine.scene.constants import LATTICE_DENSITY, SOLID_DENSITY
from engine.scene.grid import Body, Grid
from engine.solid.fill import fill
from engine.solid.octree import BUDGET, approximation_error, leaf_levels, leaf_sizes
from tests.helpers.solids import NO_SURFACE
from tests.reference import octree as reference
from training.optimise.deblur import deblur

PITCH = 2 / 80


def ball(cells: int = 96) -> Body:
    """A ball of radius 1."""
    cell = 2.2 / cells
    grid = Grid(np.full(3, -1.1), cell, (cells,) * 3)
    return Body(grid, (1 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))


def fruit(points: np.ndarray) -> np.ndarray:
    """Red flesh, a pale rind and dark seeds on a ring."""
    radius = np.linalg.norm(points, axis=-1)
    rgb = np.where((radius < 0.85)[..., None], (0.8, 0.1, 0.1), (0.9, 0.95, 0.8))
    angle = np.arange(8) * np.pi / 4
    seeds = np.column_stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), 0 * angle])
    for seed in seeds:
        rgb = np.where((np.linalg.norm(points - seed, axis=-1) < 0.08)[..., None], (0.1, 0.05, 0.0), rgb)
    return rgb.astype(np.float32)


def solid(inside: InteriorAtoms, colours=fruit) -> Atoms:
    atoms = Atoms(NO_SURFACE, inside, PITCH)
    return replace(atoms, interior=replace(inside, rgb=deblur(atoms, colours(inside.means))))


def within(depth: float, count: int = 20000) -> np.ndarray:
    points = np.random.default_rng(5).uniform(-1, 1, (4 * count, 3))
    return points[np.linalg.norm(points, axis=1) < 1 - depth][:count]


def test_an_even_inside_needs_few_atoms_and_stays_solid():
    grey = fill(ball(), PITCH, colours=lambda points: np.full(points.shape, 0.4, np.float32))
    uniform = fill(ball(), PITCH)
    assert len(grey) < 0.2 * len(uniform)
    volume = ((2 * grey.sigmas.astype(float)) ** 3).sum()
    assert volume == pytest.approx(len(uniform) * PITCH**3, rel=0.01)
    _, density = KernelField(solid(grey)).at(within(PITCH))
    assert density.min() > SOLID_DENSITY
    assert density.mean() == pytest.approx(LATTICE_DENSITY, rel=0.05)


def test_a_third_of_the_atoms_shows_the_same_inside():
    points = within(0.02)
    fine, coarse = fill(ball(), PITCH), fill(ball(), PITCH, colours=fruit)
    assert len(coarse) <= BUDGET * len(fine)
    error = [np.mean((KernelField(solid(atoms)).at(points)[0] - fruit(points)) ** 2) for atoms in (fine, coarse)]
    assert 10 * np.log10(error[1] / error[0]) < 0.2
    # The fine atoms are at the seeds.
    seed = np.linalg.norm(coarse.means - (0.5, 0, 0), axis=1) < 0.08
    assert np.allclose(coarse.sigmas[seed], PITCH / 2)


@pytest.mark.parametrize("size", leaf_sizes())
def test_errors_are_those_of_plain_numpy(size: int):
    rgb = np.random.default_rng(2).random((16, 24, 32, 3), np.float32)
    np.testing.assert_allclose(approximation_error(rgb, size), reference.approximation_error(rgb, size), rtol=1e-5)


def test_leaves_change_size_by_one_level_at_a_time():
    rgb = np.zeros((32, 32, 32, 3), np.float32)
    rgb[3, 4, 5] = 1.0
    levels = leaf_levels(rgb, np.ones(rgb.shape[:3], bool))
    assert levels[3, 4, 5] == 0 and levels[31, 31, 31] == 3
    for axis in range(3):
        assert np.abs(np.diff(levels.astype(int), axis=axis)).max() <= 1


def test_a_leaf_holds_matter_only():
    cells = np.random.default_rng(0).random((16, 16, 16)) < 0.99
    levels = leaf_levels(np.zeros((16, 16, 16, 3), np.float32), cells)
    for level in range(1, 4):
        size = 2**level
        for corner in np.argwhere(levels == level) // size * size:
            x, y, z = corner
            assert cells[x : x + size, y : y + size, z : z + size].all()


def test_a_pattern_as_fine_as_the_cells_is_kept():
    """Where every cell differs from the next, no budget blurs it."""
    checks = np.indices((24, 24, 24)).sum(0) % 2
    rgb = np.repeat(checks[..., None], 3, -1).astype(np.float32)
    assert not leaf_levels(rgb, np.ones(checks.shape, bool)).any()


def test_the_same_seed_gives_the_same_atoms():
    one, two = (fill(ball(), PITCH, seed=3, colours=fruit) for _ in range(2))
    assert one.means.tobytes() == two.means.tobytes() and one.sigmas.tobytes() == two.sigmas.tobytes()
