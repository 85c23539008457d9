"""The body reaches out to what its atoms show: spheres of several layers, and captures, whose layers are as found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from engine.io.load import load
from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import SurfaceAtoms
from engine.scene.constants import SOLID_DENSITY
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.solid.find_body import find_body
from engine.solid.skin_cover import inward_normals, sample_skin
from engine.solid.solidify import find_enclosure, solidify
from engine.solid.visible_skin import front_heights, out_to_front
from tests.helpers.solids import flat_gaussians, joined, sphere
from tests.paths import SHARED

SPLATS = SHARED / "splats"

PITCH = 0.05

needs_splats = pytest.mark.skipif(not SPLATS.exists(), reason="the shared captures are not here")


def layer(radius: float) -> Gaussians:
    """A sphere's skin whose Gaussians are as large as those of radius 1."""
    outer = sphere()
    return flat_gaussians(radius * outer.means.astype(float), outer.means.astype(float), float(outer.scales.max()))


def atoms_of(shell: Gaussians) -> SurfaceAtoms:
    return SurfaceAtoms(shell.means, shell.scales, shell.quats, shell.sh)


def radii(body: Body) -> np.ndarray:
    return np.linalg.norm(sample_skin(body, PITCH), axis=1)


@pytest.mark.parametrize("depths", [(1.0,), (0.8, 1.2), (0.8, 1.0, 1.2)])
def test_layers_below_the_outermost_do_not_hold_the_skin_back(depths: tuple[float, ...]) -> None:
    shell = joined(layer(1), *(layer(1 - PITCH * depth) for depth in depths))
    body = find_body(shell, cells=64).body
    assert np.median(radii(body)) < 1 - 0.2 * PITCH
    moved = radii(out_to_front(body, atoms_of(shell), PITCH))
    assert abs(np.median(moved) - 1) < 0.05 * PITCH
    assert np.quantile(np.abs(moved - 1), 0.99) < 0.25 * PITCH


def test_the_skin_of_a_scan_stays() -> None:
    shell = sphere()
    body = find_body(shell, cells=64).body
    assert out_to_front(body, atoms_of(shell), PITCH) is body


def test_what_flies_above_the_skin_does_not_lift_it() -> None:
    """A leaf three pitches above it, and single atoms one pitch above it."""
    inner = joined(layer(1), layer(1 - 0.8 * PITCH))
    leaf, single = layer(1 + 3 * PITCH), layer(1 + PITCH)[::100]
    body = find_body(inner, cells=64).body
    shell = joined(inner, leaf[leaf.means[:, 2] > 0.8], single)
    moved = radii(out_to_front(body, atoms_of(shell), PITCH))
    assert np.quantile(moved, 0.95) < 1 + 0.25 * PITCH
    assert abs(np.median(moved) - 1) < 0.05 * PITCH


@needs_splats
@pytest.mark.parametrize(("name", "least"), [("donut_mipsplatting.ply", 0.99), ("guitar.compressed.ply", 0.98)])
def test_a_capture_is_full_up_to_what_it_shows(name: str, least: float) -> None:
    """The interior alone fills it three quarters of a pitch below the front: 0.94 and 0.93 of it where atoms fill no
    more than is enclosed. All that is enclosed stays, and no piece of its own is added."""
    enclosure = find_enclosure(load(SPLATS / name).gaussians, 64, name)
    atoms, body = solidify(enclosure, 64, 0.05, 0)
    points = sample_skin(body, atoms.pitch)
    outwards = -inward_normals(body, points)
    heights = front_heights(atoms.surface, points, outwards, atoms.pitch)
    seen = np.isfinite(heights)
    below = points[seen] + outwards[seen] * (heights[seen] - 0.75 * atoms.pitch)[:, None]
    density = KernelField(atoms.without_skin()).at(below)[1]
    assert (density >= SOLID_DENSITY).mean() > least
    assert not (enclosure.body.inside & ~body.inside).any()
    assert ndimage.label(body.inside)[1] <= ndimage.label(enclosure.body.inside)[1]


def test_tilted_discs_do_not_lift_the_skin() -> None:
    """The mean of a layer is the skin, not what stands out of it."""
    rng = np.random.default_rng(0)
    ball = sphere()
    outwards = ball.means + 0.15 * rng.normal(size=ball.means.shape)
    size = float(ball.scales.max())
    inner = layer(1 - 1.2 * PITCH)
    shell = joined(flat_gaussians(ball.means.astype(float), outwards, size), inner)
    moved = radii(out_to_front(find_body(shell, cells=64).body, atoms_of(shell), PITCH))
    assert abs(np.median(moved) - 1) < 0.1 * PITCH
