"""Atomising: small opaque atoms that hide what the capture hid, and none where it had nothing."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from engine.fit.skin_fit import SkinFit
from engine.io.load import load
from engine.render.classic import rasterizer as classic
from engine.render.cpu import opaque
from engine.scene.atoms import NO_INTERIOR, Atoms
from engine.scene.camera import cameras_around
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.scene.rotations import facing, rotation_matrices
from engine.solid.atomise import Atomised, atomise, split
from engine.solid.contribution import contributions
from engine.solid.denoise_capture import without_haze
from engine.solid.find_body import WIDEN, Enclosure
from engine.solid.opacity_field import opacity_field
from engine.solid.skin_cover import coverage_at, inward_normals, sample_skin
from tests.helpers.solids import joined
from tests.paths import SHARED

DATA = SHARED


def on_body(scene: Gaussians, pitch: float, body: Body) -> Atomised:
    shell, _ = without_haze(scene)
    return atomise(Enclosure(body, shell, opacity_field(shell, body.grid, WIDEN * body.grid.cell)), pitch, 0.05)


def ball(cell: float = 0.05) -> Body:
    """A unit ball in closed form."""
    n = int(2.6 / cell)
    grid = Grid(np.full(3, -1.3), cell, (n, n, n))
    return Body(grid, (1 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))


def skin(n: int, size: float, opacity: float, radius: float = 1.0, seed: int = 0) -> Gaussians:
    """Flat Gaussians at random on a sphere, coloured by position."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Gaussians(
        (radius * normals).astype(np.float32),
        np.tile(np.array([size, size, size / 6], np.float32), (n, 1)),
        facing(normals).astype(np.float32),
        np.full(n, opacity, np.float32),
        normals[:, None].astype(np.float32),
    )


def solid(made: Atomised, pitch: float) -> Atoms:
    return Atoms(made.atoms, NO_INTERIOR, pitch)


def test_no_axis_is_longer_than_the_pitch() -> None:
    rng = np.random.default_rng(0)
    scene = skin(3000, 0.02, 0.9)
    wild = Gaussians(scene.means, np.exp(rng.uniform(-7, -1.5, (3000, 3))).astype(np.float32), scene.quats,
                     rng.uniform(0, 1, 3000).astype(np.float32), scene.sh)  # fmt: skip
    made = on_body(wild, 0.05, ball())
    assert made.atoms.scales.max() <= np.float32(0.05)
    assert made.split > 0
    assert np.linalg.norm(np.diff(made.atoms.means, axis=0), axis=1).mean() < 0.1  # neighbours stand side by side
    again = on_body(wild, 0.05, ball())
    assert np.array_equal(made.atoms.means, again.atoms.means)
    assert np.array_equal(made.atoms.scales, again.atoms.scales)


def test_parts_have_the_mean_and_the_covariance_of_the_whole() -> None:
    scene = skin(1, 0.02, 0.99)
    scales = np.array([[0.09, 0.05, 0.004]], np.float32)
    source, means, sizes = split(scene, scales, 0.02)
    axes = rotation_matrices(scene.quats)[0].astype(np.float64)
    local = (means - scene.means[0]).astype(np.float64) @ axes
    assert np.abs(local.mean(0)).max() < 1e-6
    spread = np.sqrt(local.var(0) + sizes[0].astype(np.float64) ** 2)
    assert np.abs(spread / scales[0] - 1).max() < 1e-4
    assert len(np.unique(source)) == 1


def test_what_cannot_be_seen_is_dropped() -> None:
    scene = joined(
        skin(4000, 0.03, 0.99),
        skin(200, 0.03, 0.99, radius=0.6),  # debris inside
        skin(50, 0.01, 0.2, radius=1.25),  # specks around it
        skin(50, 0.4, 0.05, radius=1.1),  # haze
    )
    made = on_body(scene, 0.05, ball())
    radius = np.linalg.norm(made.atoms.means, axis=1)
    assert 0.94 < radius.min() < radius.max() < 1.05
    assert made.dropped + len(scene) - len(without_haze(scene)[0]) >= 300


def test_a_veil_goes_and_what_it_veiled_is_seen() -> None:
    # A film that lets a third of the light through would hide the ball if it were opaque.
    veil = skin(1500, 0.06, 0.1, radius=1.3, seed=1)
    scene = joined(skin(12000, 0.03, 0.99), veil)
    made = on_body(scene, 0.05, ball())
    cameras = cameras_around(np.zeros(3), 1.4, np.array([0.0, 0, 1]), 6, 128)
    assert contributions(veil, cameras)[0].min() > 0.05  # it is visible
    assert np.linalg.norm(made.atoms.means, axis=1).max() < 1.1
    film = joined(skin(12000, 0.03, 0.99), skin(12000, 0.06, 0.9, radius=1.3, seed=1))
    outer = on_body(film, 0.05, Body(ball().grid, ball().depth + np.float32(0.3)))
    assert (np.linalg.norm(outer.atoms.means, axis=1) > 1.25).mean() > 0.9  # if dense enough, it is the skin


def test_weight_in_views_decides_not_opacity_alone() -> None:
    lining = skin(3000, 0.03, 0.9, radius=0.97, seed=1)  # opaque, within reach of the skin, and never seen
    floater = skin(1, 0.03, 0.99)
    floater.means[:] = [0, -1.6, 0.2]  # in front of everything, and no part of the object
    scene = joined(skin(12000, 0.03, 0.9), lining, floater)
    cameras = cameras_around(np.zeros(3), 1.1, np.array([0.0, 0, 1]), 12, 128)
    weight = contributions(scene, cameras)[0]
    assert abs(weight[-1] - 0.99) < 0.03
    assert np.median(weight[:12000]) > 0.1 > 0.02 > np.median(weight[12000:15000])
    made = on_body(scene, 0.05, ball())
    radius = np.linalg.norm(made.atoms.means, axis=1)
    assert radius.max() < 1.05
    assert (radius < 0.98).sum() < 0.3 * len(lining)
    assert (radius > 0.98).sum() > 0.9 * 12000


def test_a_leaf_off_the_skin_stays() -> None:
    rng = np.random.default_rng(0)
    leaf = skin(400, 0.03, 0.95, radius=0.0)
    leaf = Gaussians((np.array([1.15, 0, 0]) + rng.uniform(-0.1, 0.1, (400, 3)) * [0.0, 1, 1]).astype(np.float32),
                     leaf.scales, leaf.quats, leaf.opacities, leaf.sh)  # fmt: skip
    scene, pitch = joined(skin(4000, 0.03, 0.99), leaf), 0.05
    made = on_body(scene, pitch, ball())
    assert (made.atoms.means[:, 0] > 1.1).sum() > 100
    for camera in cameras_around(np.zeros(3), 1.3, np.array([0.0, 0, 1]), 4, 128):
        shown = classic.render(scene, camera).alpha > 0.9
        assert (opaque.render(solid(made, pitch), camera).alpha[shown] > 0.9).mean() > 0.98


def test_holes_are_closed_in_the_colours_around_them() -> None:
    scene, body, pitch = skin(6000, 0.03, 0.99), ball(), 0.05
    points = sample_skin(body, 0.05)
    assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 0.01
    assert abs(len(points) * 0.05**2 / (4 * np.pi) - 1) < 0.2
    open_ = scene[scene.means[:, 2] > -0.8]  # no bottom
    made = on_body(open_, pitch, body)
    assert np.quantile(coverage_at(made.atoms, points, points, pitch), 0.01) > 0.5
    bottom = made.atoms.means[:, 2] < -0.85
    assert bottom.sum() > 100
    rim = open_.sh[open_.means[:, 2] < -0.7, 0]
    assert np.abs(made.atoms.sh[bottom, 0].mean(0) - rim.mean(0)).max() < 0.1


def test_the_opaque_object_looks_like_the_capture() -> None:
    scene, pitch = skin(3000, 0.06, 0.5), 0.05
    made = on_body(scene, pitch, ball())
    for camera in cameras_around(np.zeros(3), 1.1, np.array([0.0, 0, 1]), 3, 96):
        wanted, contributions = classic.render(scene, camera, (1, 1, 1)), opaque.render(solid(made, pitch), camera)
        centre = np.hypot(*np.indices((96, 96)) - 47.5) < 30
        assert contributions.alpha[centre].min() > 0.9
        assert np.sqrt(((wanted.rgb - contributions.rgb)[centre] ** 2).mean()) < 0.12


def test_fitting_the_skin_makes_unseen_views_better() -> None:
    torch.set_num_threads(1)  # as training does: the kernels use all cores
    scene, pitch = skin(1500, 0.09, 0.6), 0.06
    atoms = solid(on_body(scene, pitch, ball()), pitch)
    up = np.array([0.0, 0, 1])

    def fit(saved: tuple[dict[str, np.ndarray], int] | None = None, until: int = 80) -> SkinFit:
        fit = SkinFit(atoms, scene, ball(), cameras_around(np.zeros(3), 1.1, up, 24, 96), steps=80)
        if saved is not None:
            fit.restore(*saved)
        while fit.step < until:
            fit.advance()
        return fit

    fitted = fit().result()

    def error(a: Atoms) -> float:
        unseen = cameras_around(np.zeros(3), 1.1, up, 6, 96, turn=23.0)
        return float(
            np.mean([(opaque.render(a, c).rgb - classic.render(scene, c, (1, 1, 1)).rgb) ** 2 for c in unseen])
        )

    assert error(fitted) < 0.8 * error(atoms)
    assert fitted.surface.scales.max() <= np.float32(pitch)
    assert np.abs(np.linalg.norm(fitted.surface.quats, axis=1) - 1).max() < 1e-5
    stopped = fit(until=17)
    again = fit((stopped.state(), stopped.step)).result()  # the same bits with and without interruption
    for name in ("means", "scales", "quats", "sh"):
        assert np.array_equal(getattr(fitted.surface, name), getattr(again.surface, name))


@pytest.mark.parametrize("name", [pytest.param("donut_mipsplatting", marks=pytest.mark.slow), "meshgs_orange_30k"])
def test_captures_keep_their_skin_whole(name: str) -> None:
    path = DATA / f"splats/{name}.ply"
    if not path.exists():
        pytest.skip("shared data is not beside the project")
    from engine.solid.find_body import find_body

    scene = load(path).gaussians
    body = find_body(scene, 96).body
    pitch = float(np.ptp(body.bounds(), axis=0).max()) / 64
    made = on_body(scene, pitch, body)
    points = sample_skin(body, pitch / 2)
    covered = coverage_at(made.atoms, points, -inward_normals(body, points), pitch) >= 0.5
    assert covered.mean() > 0.998
