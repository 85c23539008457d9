"""Fitting the skin: what the solid hides does not count, and cracks close that would not show in a whole solid."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.measure import perimeter

from engine.fit.occlusion import CORE_PITCHES, core_of, view_of_core
from engine.fit.skin_fit import SkinFit
from engine.render.classic import rasterizer as classic
from engine.render.cpu import opaque
from engine.scene.atoms import NO_INTERIOR, Atoms, SurfaceAtoms
from engine.scene.camera import Camera, cameras_around, orbit
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from engine.scene.rotations import facing

UP = np.array([0.0, 0.0, 1.0])
PITCH = 0.1


def ball() -> Body:
    """A unit ball in closed form."""
    grid = Grid(np.full(3, -1.3), 0.05, (52, 52, 52))
    return Body(grid, (1 - np.linalg.norm(grid.centres(), axis=-1)).astype(np.float32))


def distance_from_centre(camera: Camera, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Distance of the origin from the lines from the eye through points, and whether it comes before the points."""
    ray = points - camera.position
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    middle = -(ray @ camera.position)
    return np.linalg.norm(camera.position + middle[..., None] * ray, axis=-1), (points * ray).sum(-1) > 0


def test_skin_is_hidden_where_its_line_of_sight_crosses_the_core() -> None:
    camera, pitch = orbit((0, 0, 0), UP, 30, 35, 4.0, 200, 150), 0.3
    normals = np.random.default_rng(0).normal(size=(20000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    skin = normals.astype(np.float32)
    shown = np.zeros(len(skin), bool)
    shown[view_of_core(core_of(ball(), pitch), camera, pitch).shown(skin)] = True
    distance, beyond = distance_from_centre(camera, normals)
    edge = 1 - CORE_PITCHES * pitch
    sure = np.abs(distance - edge) > 0.08  # tolerance: a cell of the body and a pixel of the core's picture
    assert np.array_equal(shown[sure], (~beyond | (distance > edge))[sure])
    thin = core_of(ball(), 3.0)
    assert len(view_of_core(thin, camera, pitch).shown(skin)) == len(skin)


def discs(count: int, size: float, seed: int) -> SurfaceAtoms:
    """Flat atoms at random on the unit sphere, all of the same colour."""
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    scales = np.tile(np.array([size, size, size / 5], np.float32), (count, 1))
    sh = np.full((count, 1, 3), 0.2, np.float32)
    return SurfaceAtoms(normals.astype(np.float32), scales, facing(normals).astype(np.float32), sh)


def open_part(atoms: Atoms, size: int = 128) -> float:
    """Share of the near half of the unit sphere, rim excluded, that shows background once the far half is cut away."""
    holes, count = 0, 0
    for camera in cameras_around(np.zeros(3), 1.1, UP, 6, size, turn=23.0):
        alpha = opaque.render(atoms, camera, [Plane.through(np.zeros(3), camera.forward)]).alpha
        x, y = np.meshgrid(*(2 * [np.arange(size) + 0.5]))
        pixels = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
        points = (pixels - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
        skin = distance_from_centre(camera, points)[0] < 0.9
        holes, count = holes + int((alpha[skin] < 0.5).sum()), count + int(skin.sum())
    return holes / count


def test_a_crack_closes_though_the_far_side_has_its_colour() -> None:
    torch.set_num_threads(1)  # as training does: the kernels use all cores
    whole = discs(6000, 0.05, seed=1)
    capture = Gaussians(whole.means, whole.scales, whole.quats, np.full(6000, 0.95, np.float32), whole.sh)
    atoms = Atoms(discs(1500, 0.05, seed=2), NO_INTERIOR, PITCH)
    fit = SkinFit(atoms, capture, ball(), cameras_around(np.zeros(3), 1.1, UP, 12, 96), steps=40)
    while fit.step < fit.steps:
        fit.advance()
    before, after = open_part(atoms), open_part(fit.result())
    assert before > 0.05 and after < before / 10  # with the far side drawn, more than half of it stays open


def test_a_skin_like_its_capture_stays_and_one_with_cracks_does_not() -> None:
    whole = discs(6000, 0.05, seed=1)
    capture = Gaussians(whole.means, whole.scales, whole.quats, np.full(6000, 0.995, np.float32), whole.sh)
    cameras = cameras_around(np.zeros(3), 1.1, UP, 12, 96)
    same = Atoms(whole, NO_INTERIOR, PITCH)
    kept = SkinFit(same, capture, ball(), cameras, steps=40)
    assert kept.steps == 0 and kept.result() is same
    rows = np.random.default_rng(3).random(6000) < 0.5  # the far side shows through in the same colour
    part = SurfaceAtoms(whole.means[rows], whole.scales[rows], whole.quats[rows], whole.sh[rows])
    cracked = Atoms(part, NO_INTERIOR, PITCH)
    assert open_part(same) < 1e-3 < open_part(cracked)
    assert SkinFit(cracked, capture, ball(), cameras, steps=40).steps == 40


def test_a_soft_rim_becomes_no_hairs() -> None:
    torch.set_num_threads(1)
    rng = np.random.default_rng(10)
    core = discs(6000, 0.05, seed=1)
    soft = rng.normal(size=(3000, 3)).astype(np.float32)
    soft /= np.linalg.norm(soft, axis=1, keepdims=True)
    upright = np.tile(np.array([1, 0, 0, 0], np.float32), (3000, 1))
    capture = Gaussians(
        np.concatenate([core.means, soft]),
        np.concatenate([core.scales, np.full((3000, 3), 0.1, np.float32)]),
        np.concatenate([core.quats, upright]),
        np.repeat(np.array([0.95, 0.05], np.float32), (6000, 3000)),
        np.full((9000, 1, 3), -1.0, np.float32),
    )
    skin = discs(1500, 0.08, seed=2)
    start = SurfaceAtoms(  # needles in the rim, as atoms of a capture's Gaussians are
        np.concatenate([skin.means, 1.05 * soft[:500]]),
        np.concatenate([skin.scales, np.tile(np.array([0.08, 0.04, 0.012], np.float32), (500, 1))]),
        np.concatenate([skin.quats, rng.normal(size=(500, 4)).astype(np.float32)]),
        np.full((2000, 1, 3), -1.0, np.float32),
    )
    fit = SkinFit(Atoms(start, NO_INTERIOR, PITCH), capture, ball(), cameras_around(np.zeros(3), 1.4, UP, 24, 96), 60)
    while fit.step < fit.steps:
        fit.advance()
    found, outside, outline = fit.result(), 0.0, 0.0
    for camera in cameras_around(np.zeros(3), 1.4, UP, 4, 384, turn=23.0):
        there = classic.render(capture, camera).alpha > 0.5
        outside += float(((opaque.render(found, camera).alpha > 0.5) & ~there).sum())
        outline += perimeter(there)
    assert outside / outline < 0.6  # pixels; 1.2 if all of the rim's alpha is fitted
