"""Filling shapes of known volume: closed forms, and meshes whose inside follows from their winding number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from engine.errors import InputError
from engine.io.load import load
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.scene.rotations import rotation_matrices
from engine.solid.distance_transform import depth_in, nearest, within
from engine.solid.fill import fill
from engine.solid.find_body import find_body
from engine.solid.opacity_field import opacity_field
from engine.solid.skin_cover import project_onto_skin
from tests.helpers.solids import flat_gaussians, joined, sphere
from tests.paths import SAMPLES, SHARED

MESHES = SHARED / "meshes"

needs_meshes = pytest.mark.skipif(not MESHES.exists(), reason="the shared meshes are not here")


def lathe(profile: np.ndarray, n: int, closed: bool = True) -> Gaussians:
    """The evenly covered skin of a polygon (r, z) turned about the z axis."""
    rng = np.random.default_rng(0)
    ends = np.roll(profile, -1, axis=0) if closed else profile[1:]
    starts = profile if closed else profile[:-1]
    edges = ends - starts
    areas = np.pi * (starts[:, 0] + ends[:, 0]) * np.linalg.norm(edges, axis=1)
    which = rng.choice(len(edges), n, p=areas / areas.sum())
    r0, r1 = starts[which, 0], ends[which, 0]
    u = rng.random(n)  # the area along a cone's edge grows with the radius
    flat = np.abs(r1 - r0) < 1e-9
    t = np.where(flat, u, (np.sqrt(r0**2 + u * (r1**2 - r0**2)) - r0) / np.where(flat, 1, r1 - r0))
    rz = starts[which] + t[:, None] * edges[which]
    across = np.column_stack([edges[:, 1], -edges[:, 0]])[which]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    a = 2 * np.pi * rng.random(n)
    points = np.column_stack([rz[:, 0] * np.cos(a), rz[:, 0] * np.sin(a), rz[:, 1]])
    normals = np.column_stack([across[:, 0] * np.cos(a), across[:, 0] * np.sin(a), across[:, 1]])
    return flat_gaussians(points, normals, (areas.sum() / n) ** 0.5)


def turns(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """How often the mesh winds around each point: the sum of its triangles' solid angles over 4 pi."""
    total = np.zeros(len(points))
    for corner in np.array_split(mesh.triangles, max(1, len(mesh.triangles) // 200)):
        a, b, c = np.moveaxis(corner, 1, 0)
        across = np.cross(b - a, c - a)
        above = (across * a).sum(1) - points @ across.T  # triple product of the vectors to the corners
        la, lb, lc = (cdist(points, corner) for corner in (a, b, c))
        ab, bc, ca = (  # dot products of two such vectors, by the law of cosines
            (lu**2 + lv**2 - ((u - v) ** 2).sum(1)) / 2
            for (u, lu), (v, lv) in pairwise([(a, la), (b, lb), (c, lc), (a, la)])
        )
        total += 2 * np.arctan2(above, la * lb * lc + ab * lc + bc * la + ca * lb).sum(1)
    return total / (4 * np.pi)


def test_opacity_field_is_equation_2() -> None:
    rng = np.random.default_rng(1)
    n = 40
    quats = rng.normal(size=(n, 4))
    scene = Gaussians(
        rng.uniform(0, 1, (n, 3)).astype(np.float32),
        np.exp(rng.uniform(-5, -1.5, (n, 3))).astype(np.float32),
        (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        rng.uniform(0, 1, n).astype(np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    grid = Grid(np.array([-0.1, 0.0, 0.1]), 0.05, (23, 18, 20))
    centres = grid.centres().astype(np.float64)
    truth = np.zeros(grid.shape)
    axes, sigma = rotation_matrices(scene.quats).astype(np.float64), np.maximum(scene.scales.astype(np.float64), 0.02)
    for p in range(n):
        q = ((((centres - scene.means[p]) @ axes[p]) / sigma[p]) ** 2).sum(-1)
        truth += scene.opacities[p] * np.exp(-q / 2) * (q <= 9)
    found = opacity_field(scene, grid, widen=0.02)
    # A cell at the rim of the cutoff may lie on either side of it: exp(-4.5) of one Gaussian.
    assert np.quantile(np.abs(found - truth), 0.999) < 1e-5
    assert np.abs(found - truth).max() < 0.012
    assert np.array_equal(found, opacity_field(scene, grid, widen=0.02))


def test_nearest_is_the_euclidean_distance() -> None:
    mask = np.random.default_rng(2).random((17, 30, 23)) < 0.01
    distance, index = nearest(mask)
    assert np.abs(distance - distance_transform_edt(~mask)).max() < 1e-5
    there, here = np.unravel_index(index.ravel(), mask.shape), np.unravel_index(np.arange(mask.size), mask.shape)
    assert np.allclose(np.linalg.norm(np.subtract(there, here), axis=0), distance.ravel(), atol=1e-5)
    assert np.isinf(nearest(np.zeros((2, 3, 4), bool))[0]).all()


def test_depth_in_a_picture_is_scipys_to_the_bit() -> None:
    random = np.random.default_rng(3)
    for part in (0, 0.02, 0.5, 0.9, 0.99, 0.999, 1):
        for shape in [(1, 1), (1, 40), (40, 1), (2, 3), (131, 97), *random.integers(1, 40, (20, 2))]:
            mask = random.random(shape) < part
            assert np.array_equal(depth_in(mask), distance_transform_edt(mask)), (part, shape)
            assert np.array_equal(depth_in(mask.T), distance_transform_edt(mask.T)), (part, shape)
    wide = np.ones((60, 2500), bool)  # wider than a task of columns
    wide[0, 0] = wide[50, 1200] = False
    assert np.array_equal(depth_in(wide), distance_transform_edt(wide))
    disc = np.hypot(*np.ogrid[-500:700, -600:600]) < 450
    assert np.array_equal(depth_in(disc), distance_transform_edt(disc))


@pytest.mark.parametrize("radius", [0.0, 1.5, 5**0.5, 6.0, 11.0, 40.0])
def test_within_a_radius_lies_what_is_no_farther(radius: float) -> None:
    mask = np.random.default_rng(3).random((17, 30, 23)) < 0.003
    places = np.stack(np.nonzero(mask), axis=1)
    cells = np.indices(mask.shape).reshape(3, -1).T
    squared = np.min([((cells - place) ** 2).sum(axis=1) for place in places], axis=0).reshape(mask.shape)
    assert np.array_equal(within(mask, radius), squared <= round(radius**2, 6))
    assert not within(np.zeros((2, 3, 4), bool), radius).any()


@needs_meshes
@pytest.mark.parametrize("name", ["unit_sphere", "torus", "angle_block"])
def test_meshes_fill_to_their_volume_and_no_farther(name: str) -> None:
    mesh = trimesh.load_mesh(MESHES / f"trimesh_{name}.STL")
    points, faces = trimesh.sample.sample_surface(mesh, 30000, seed=0)
    body = find_body(flat_gaussians(points, mesh.face_normals[faces], (mesh.area / 30000) ** 0.5)).body
    assert abs(body.volume / mesh.volume - 1) < 0.01
    pitch = max(mesh.extents) / 64
    atoms = fill(body, pitch)
    assert abs(len(atoms) * pitch**3 / mesh.volume - 1) < 0.03
    some = atoms.means[np.random.default_rng(0).choice(len(atoms), 1500, replace=False)].astype(np.float64)
    outside = some[turns(mesh, some) < 0.5]
    # Only in the acute grooves of the block's dovetails, two cells deep, do the walls touch before the groove ends.
    assert len(outside) <= (5 if name == "angle_block" else 0)
    assert len(outside) == 0 or KDTree(points).query(outside)[0].max() < 2.5 * body.grid.cell
    if name == "torus":
        assert body.at(np.zeros((1, 3)))[0] < -0.4


def test_depth_is_the_distance_to_the_skin() -> None:
    body = find_body(sphere(), cells=64).body
    truth = 1 - np.linalg.norm(body.grid.centres(), axis=-1)
    close = np.abs(truth) < 3 * body.grid.cell
    assert np.abs(body.depth - truth)[np.abs(truth) < body.grid.cell].max() < 0.05 * body.grid.cell
    assert np.abs(body.depth - truth)[close].max() < 0.4 * body.grid.cell
    assert np.abs(body.depth - truth)[truth > 0].max() < 0.6 * body.grid.cell
    assert abs(body.volume / (4 / 3 * np.pi) - 1) < 0.005


@pytest.mark.parametrize("towards", [(0, 0, -1), (1, 1, 1)])
@pytest.mark.parametrize("hole", [5, 20, 45, 60])
def test_a_sphere_with_a_hole_is_closed_flat(hole: float, towards: tuple[float, float, float]) -> None:
    found = find_body(sphere(hole=hole, towards=towards), cells=64)
    h = 1 - np.cos(np.radians(hole))  # a flat lid leaves out a cap of this height
    truth = 4 / 3 * np.pi - np.pi * h**2 * (3 - h) / 3
    assert abs(found.body.volume / truth - 1) < 0.03
    assert hole < 20 or any("open" in note for note in found.notes)


def test_half_of_a_melon_is_filled() -> None:
    melon = load(SAMPLES / "watermelon" / "watermelon.ply").gaussians
    middle = melon.visible_bounds()[:, 0].mean()
    whole, half = find_body(melon, 64).body, find_body(melon[melon.means[:, 0] > middle]).body
    points = whole.grid.centres()[whole.inside]
    # Its thick fuzzy wall has pockets; from those the paper's rule alone fills a lump and leaves the rest a bowl.
    assert (half.at(points[points[:, 0] > middle]) > 0).mean() > 0.6


def test_a_cup_keeps_its_hollow() -> None:
    profile = np.array([[0, 0], [0.5, 0], [0.5, 1], [0.4, 1], [0.4, 0.1], [0, 0.1]])
    body = find_body(lathe(profile, 30000), cells=96).body
    truth = np.pi * (0.5**2 - 0.4**2 * 0.9)
    assert body.at(np.array([[0.0, 0, 0.5]]))[0] < 0 < body.at(np.array([[0.45, 0, 0.5]]))[0]
    assert abs(body.volume / truth - 1) < 0.03


def test_a_box_without_a_bottom_on_a_mat_is_filled_to_the_mat() -> None:
    box = np.array([[0.5, 0], [0.5, 1], [0, 1]])
    mat = np.array([[0.5, 0], [1.0, 0]])
    body = find_body(joined(lathe(box, 15000, closed=False), lathe(mat, 8000, closed=False)), cells=96).body
    assert abs(body.volume / (np.pi / 4) - 1) < 0.04
    assert body.at(np.array([[0.8, 0, 0.05]]))[0] < 0


def test_everything_in_the_outer_shell_is_solid() -> None:
    body = find_body(joined(sphere(), sphere(6000, radius=0.5)), cells=64).body
    assert abs(body.volume / (4 / 3 * np.pi) - 1) < 0.01


def test_what_encloses_little_of_what_is_shown_is_told() -> None:
    mat = lathe(np.array([[0, -1.05], [4, -1.05]]), 20000, closed=False)
    notes = find_body(joined(sphere(), mat), cells=96).notes
    (told,) = [note for note in notes if "encloses an inside" in note]
    share = int(told.removeprefix("only ").partition("%")[0])
    assert abs(share - 100 * 4 / (4 + 16)) < 8  # areas of the ball and of the mat, over pi
    assert not any("encloses an inside" in note for note in find_body(sphere(), cells=64).notes)


def test_what_is_cut_through_wide_gaussians_ends_inside_the_grid() -> None:
    scene = lathe(np.array([[0.5, -1], [0.5, 1], [0, 1]]), 15000, closed=False)
    cut = scene.means[:, 2] < -0.9
    scales = np.where(cut[:, None], np.float32(0.2), scene.scales)  # debris that reaches far beyond the cut
    body = find_body(replace(scene, scales=scales), cells=64).body
    border = np.ones(body.grid.shape, bool)
    border[1:-1, 1:-1, 1:-1] = False
    assert body.depth[border].max() < 0
    low, high = body.bounds()
    atoms = fill(body, 0.04)
    assert ((atoms.means > low) & (atoms.means < high)).all()


def test_what_flies_around_does_not_coarsen_the_grid() -> None:
    rng = np.random.default_rng(0)
    n = 200
    far = flat_gaussians(100 * rng.normal(size=(n, 3)), np.tile([0.0, 0, 1], (n, 1)), 0.5)
    near = flat_gaussians(rng.uniform(1.3, 1.5, (20, 3)), np.tile([0.0, 0, 1], (20, 1)), 0.02)
    found = find_body(joined(sphere(), far, near), cells=64)
    assert abs(found.body.volume / (4 / 3 * np.pi) - 1) < 0.01
    assert any(note.startswith("220 Gaussians") for note in found.notes)


@pytest.mark.parametrize("thickness", [0.05, 0.1])
def test_a_thin_plate_is_a_solid(thickness: float) -> None:
    profile = np.array([[0, 0], [0.5, 0], [0.5, thickness], [0, thickness]])
    body = find_body(lathe(profile, 20000), cells=64).body
    assert abs(body.volume / (np.pi * 0.25 * thickness) - 1) < 0.05


def thinned(whole: Gaussians, part: float) -> Gaussians:
    """A random fraction of the Gaussians."""
    return whole[np.sort(np.random.default_rng(0).choice(len(whole), round(part * len(whole)), replace=False))]


@pytest.mark.parametrize("part", [0.3, 0.1, 0.03])
def test_a_thinned_shell_encloses_what_the_whole_one_does(part: float) -> None:
    """With gaps of many cells between its Gaussians, which stay as small as before."""
    found = find_body(thinned(sphere(30000), part), cells=96)
    assert abs(found.body.volume / (4 / 3 * np.pi) - 1) < 0.08
    assert any("gaps" in note for note in found.notes) == (part < 0.3)


def test_a_hundredth_of_a_shell_still_encloses_it() -> None:
    """Its Gaussians are wide and stick out of the skin, but none is buried deeper than it reaches."""
    found = find_body(thinned(sphere(30000), 0.01), cells=64)
    assert 1 < found.body.volume / (4 / 3 * np.pi) < 1.3


@pytest.mark.parametrize(
    ("name", "cells"), [("meshgs_orange_30k.ply", 64), ("tarot_box_capture.ply", 104), ("plant.splat", 128)]
)
def test_a_tenth_of_a_capture_encloses_what_all_of_it_does(name: str, cells: int) -> None:
    path = SHARED / "splats" / name
    if not path.exists():
        pytest.skip("the shared captures are not here")
    whole = load(path).gaussians
    volume = find_body(whole, cells).body.volume
    assert abs(find_body(thinned(whole, 0.1), cells).body.volume / volume - 1) < 0.08


def test_a_skin_of_misplaced_gaussians_does_not_swell_until_it_buries_them() -> None:
    """A cloud of a few cells has no gaps, however far apart its Gaussians are: their reach is not widened."""
    path = SHARED / "splats/meshgs_orange_30k.ply"
    if not path.exists():
        pytest.skip("the shared captures are not here")
    whole = load(path).gaussians
    low, high = whole.visible_bounds()
    away = np.random.default_rng(0).normal(0, 0.02 * float((high - low).max()), whole.means.shape)
    found = find_body(replace(whole, means=(whole.means + away).astype(np.float32)))
    assert abs(found.body.volume / find_body(whole, 64).body.volume - 1) < 0.08
    assert not any("gaps" in note for note in found.notes)


@pytest.mark.parametrize(
    "scene",
    [
        lambda: sphere()[:0],
        lambda: sphere()[:3],
        lambda: lathe(np.array([[0, 0], [1.0, 0]]), 5000, closed=False),
        lambda: flat_gaussians(np.zeros((50, 3)), np.tile([0.0, 0, 1], (50, 1)), 1e-3),
    ],
    ids=["none", "three", "flat", "coincident"],
)
def test_what_encloses_nothing_is_said_in_one_line(scene: Callable[[], Gaussians]) -> None:
    with pytest.raises(InputError, match=r"^thing\.ply: no closed body found[^\n]*$"):
        find_body(scene(), cells=32, name="thing.ply")


def test_atoms_stay_under_the_skin_and_leave_no_gap() -> None:
    body = find_body(sphere(), cells=64).body
    pitch = 1 / 12
    atoms = fill(body, pitch, seed=3)
    radius = np.linalg.norm(atoms.means, axis=1)
    assert radius.max() < 1 - 0.6 * pitch / 2
    assert abs(len(atoms) * pitch**3 / body.volume - 1) < 0.02
    assert np.array_equal(atoms.means, fill(body, pitch, seed=3).means)
    # Solid up to half a pitch under the skin: the weights sum to more than half of a lattice's.
    probe = np.random.default_rng(0).normal(size=(500, 3))
    probe *= (
        (np.random.default_rng(1).random((500, 1)) ** (1 / 3))
        * (1 - pitch / 2)
        / np.linalg.norm(probe, axis=1, keepdims=True)
    )
    squared = ((probe[:, None] - atoms.means[None]) ** 2).sum(-1) / (pitch / 2) ** 2
    assert np.exp(-0.5 * squared).sum(1).min() > 0.98


def test_points_are_projected_onto_the_skin() -> None:
    ball = sphere()
    body = find_body(ball, cells=64).body
    for steep in (0.5, 1.0, 1.5):  # the depth need not be a true distance near the skin
        points = project_onto_skin(Body(body.grid, body.depth * np.float32(steep)), 0.95 * ball.means)
        assert np.abs(np.linalg.norm(points, axis=1) - 1).max() < 0.1 * body.grid.cell, steep
