"""The opaque image on the CPU: against its formula in float64, and the invariants it was made for."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render, render_pieces
from engine.scene.atoms import NO_INTERIOR, Atoms, SurfaceAtoms
from engine.scene.camera import Camera, look_at, orbit, section
from engine.scene.image import psnr
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import cores, use_cores
from tests.helpers.solids import ball, rows_of, scatter, unturned, with_leaf
from tests.reference.opaque import kernel_field, reference

UP = (0.0, 0.0, 1.0)
CUTS = [Plane.of((0, 0, 1), -0.1), Plane.of((1, 0.2, 0), -0.2)]


def view(size: int = 48, distance: float = 2.0, azimuth: float = 30.0) -> Camera:
    return orbit((0, 0, 0), UP, azimuth, 35, distance, size + 5, size)


def checkerboard(pitch: float = 0.08) -> Atoms:
    """A ball of alternating black and white cubes, two atoms wide."""
    atoms = ball(pitch)
    dark = np.floor(atoms.interior.means / (2 * pitch)).astype(int).sum(1) % 2
    rgb = np.repeat(dark[:, None], 3, 1).astype(np.float32)
    return replace(atoms, interior=replace(atoms.interior, rgb=rgb))


INSIDE = Camera(look_at((0.1, 0, 0), (1, 0.2, 0.1), UP), 20, 20, 16, 16, 32, 32)
ON_PLANE = Camera(look_at((0.9, 0.3, 0.1), (0, 0, 0.1), UP), 40, 40, 16, 16, 32, 32)
OFF_CENTRE = Camera(look_at((0.9, -0.6, 0.7), (0, 0, 0), UP), 45, 38, 3, 29, 33, 27)
STRAIGHT = replace(view(40), orthographic=True, fx=35.0, fy=40.0)


@pytest.mark.parametrize("planes", [[], CUTS[:1], CUTS], ids=["whole", "half", "quarter"])
@pytest.mark.parametrize("camera", [view(), INSIDE, ON_PLANE, OFF_CENTRE, STRAIGHT])
def test_meets_the_formula(camera: Camera, planes: list[Plane]) -> None:
    for atoms in (ball(0.12), with_leaf(ball(0.12)), scatter(25, 30)):
        picture = render(atoms, camera, planes, (0.2, 0.5, 0.9), light=True)
        rgb, alpha, depth = reference(atoms, camera, planes, (0.2, 0.5, 0.9), light=True)
        assert psnr(picture.rgb, rgb) > 60
        assert psnr(picture.alpha, alpha) > 60
        both = np.isfinite(depth) & np.isfinite(picture.depth)
        assert (np.isfinite(depth) != np.isfinite(picture.depth)).mean() < 0.002
        assert np.quantile(np.abs(picture.depth[both] - depth[both]), 0.99) < 1e-4 if both.any() else True


def test_a_face_is_flat_and_looks_the_same_from_everywhere() -> None:
    atoms = checkerboard()
    field = KernelField(atoms)
    plane = Plane.of((0.2, 0.1, 1), -0.05)
    targets = np.random.default_rng(5).uniform(-0.25, 0.25, (60, 3))
    targets -= plane.distance(targets)[:, None] * np.array(plane.normal)
    truth, _ = kernel_field(atoms, targets)
    for azimuth in (0, 70, 150, 220, 300):
        # Pixels so small that the footprint is below every atom's size, one of them centred on each point.
        base = orbit((0, 0, 0), UP, azimuth, 50, 2.0, 8, 8)
        for target, colour in zip(targets[:12], truth[:12], strict=True):
            x, y, z = base.viewmat[:3, :3] @ target + base.viewmat[:3, 3]
            camera = replace(base, fx=900.0, fy=900.0, cx=3.5 - 900 * x / z, cy=4.5 - 900 * y / z)
            picture = render(atoms, camera, [plane], field=field)
            assert np.abs(picture.rgb[4, 3] - colour).max() < 2e-3
            assert abs(picture.depth[4, 3] - z) < 1e-5


def test_the_face_is_the_kernel_field() -> None:
    atoms = ball(0.1)
    plane = CUTS[0]
    camera = section(plane, UP, atoms.bounds, 40)
    picture = render(atoms, camera, [plane])
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.zeros_like(x)], -1)
    points = (local - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]
    points -= plane.distance(points)[..., None] * np.array(plane.normal)
    truth, density = kernel_field(atoms, points.reshape(-1, 3), 1 / camera.fx)
    deep = density.reshape(40, 40) > 1.8
    assert deep.sum() > 100
    assert np.abs(picture.rgb - truth.reshape(40, 40, 3))[deep].max() < 1e-5


def test_a_cut_that_misses_changes_nothing() -> None:
    atoms = ball(0.1)
    plain = render(atoms, view())
    for far in (Plane.of((0, 0, 1), -0.9), Plane.of((1, 1, 1), -2.0)):
        cut = render(atoms, view(), [far])
        np.testing.assert_array_equal(cut.rgb, plain.rgb)
        np.testing.assert_array_equal(cut.depth, plain.depth)
    nothing = render(atoms, view(), [Plane.of((0, 0, 1), 0.9)])
    assert nothing.alpha.max() == 0
    assert np.isinf(nothing.depth).all()


def test_inner_edges_let_no_background_through() -> None:
    """At a leaf's edge the ball behind it covers what the leaf leaves open."""
    alone, atoms = ball(0.06), with_leaf(ball(0.06), spacing=1.1)
    for camera in (view(96), view(96, azimuth=42.0), replace(view(96), orthographic=True, fx=80.0, fy=80.0)):
        light, dark = (render(atoms, camera, background=3 * (b,)) for b in (1.0, 0.0))
        covered = render(alone, camera).alpha == 1
        leaf = covered & (light.depth < render(alone, camera).depth - 0.2)
        assert leaf.sum() > 100
        assert light.alpha[covered].min() > 1 - 1e-6
        np.testing.assert_allclose(light.rgb[covered], dark.rgb[covered], atol=1e-6)


def skin(means: NDArray[np.floating], sigmas: NDArray[np.floating], light: NDArray[np.floating]) -> Atoms:
    """Round atoms without an interior: black, or nearly white where `light` (N,) is 1."""
    sh = np.where(light > 0, 1.5, -1e6).astype(np.float32)[:, None, None].repeat(3, 2)
    scales = np.repeat(sigmas.astype(np.float32)[:, None], 3, 1)
    surface = SurfaceAtoms(means.astype(np.float32), scales, unturned(len(means)), sh)
    return replace(ball(0.05), surface=surface, interior=NO_INTERIOR)


def test_an_edge_shows_what_it_covers_and_what_lies_behind_it() -> None:
    """A dark half plane before a light plane: brightness across the edge is the uncovered share of a pixel, and what
    lies behind both does not shine through."""
    camera = section(Plane.of((0, 0, 1), 0.0), (0, 1, 0), np.array([[-1.0] * 3, [1.0] * 3]), 64)
    side = np.arange(-2, 2, 0.05)  # beyond the edges of the picture
    x, y = (a.ravel() for a in np.meshgrid(side, side))
    near, far, last = (np.stack([x, y, np.full_like(x, z)], 1) for z in (0.9, 0.3, -0.6))
    means = np.concatenate([near[x <= 0], far, last])
    light = np.repeat([0, 1, 0], [(x <= 0).sum(), len(x), len(x)])
    rgb = render(skin(means, np.full(len(means), 0.035), light), camera).rgb[8:-8, :, 0].mean(0)
    white = float(rgb[-12:].mean())
    assert rgb[:12].max() < 1e-3 and white > 0.9
    assert (np.diff(rgb) > -1e-3).all()
    assert 1 <= ((rgb > 0.02 * white) & (rgb < 0.98 * white)).sum() <= 3  # the width of one antialiased edge


def test_atoms_that_only_together_close_a_gap_hide_what_lies_behind() -> None:
    """Between four atoms there is no core, but their weights add up to more than a half."""
    camera = section(Plane.of((0, 0, 1), 0.0), (0, 1, 0), np.array([[-0.1] * 3, [0.1] * 3]), 33)
    corners = [(x, y, 0.9) for x in (-0.05, 0.05) for y in (-0.05, 0.05)]
    means, sigmas = np.array([*corners, (0, 0, 0)]), np.array([0.045] * 4 + [0.2])
    atoms = skin(means, sigmas, np.array([1, 1, 1, 1, 0]))
    picture = render(atoms, camera)
    assert picture.depth[16, 16] == picture.depth.max()  # the nearest core belongs to the far atom
    assert picture.rgb[16, 16].min() > 0.9


def test_two_halves_put_back_together_are_the_whole() -> None:
    atoms = ball(0.1)
    move = np.eye(4)
    move[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    move[:3, 3] = (0.1, 0.2, -0.1)
    for plane in (CUTS[1], Plane.of((0.3, 0.1, 1), 0.0)):
        for transform in (np.eye(4), move):
            whole = render_pieces(atoms, view(), [Piece((), transform)])
            pieces = [Piece((plane,), transform), Piece((plane.flipped(),), transform)]
            joined = render_pieces(atoms, view(), pieces)
            assert psnr(joined.rgb, whole.rgb) > 90
            assert psnr(joined.alpha, whole.alpha) > 90


def test_pieces_hide_each_other_by_depth() -> None:
    atoms = ball(0.1)
    camera = orbit((0, 0, 0), UP, 0, 0, 3.0, 48, 48)
    back, front = np.eye(4), np.eye(4)
    back[0, 3], front[0, 3] = -0.6, 0.8
    half = Plane.of((1, 0, 0), 0.0)  # keeps the far half, whose face is turned to the camera
    behind, before = Piece((half,), back), Piece((half,), front)
    alone = render_pieces(atoms, camera, [before])
    both = render_pieces(atoms, camera, [behind, before])
    swapped = render_pieces(atoms, camera, [before, behind])
    np.testing.assert_allclose(both.rgb, swapped.rgb, atol=1e-6)
    hidden = alone.alpha == 1
    assert hidden.sum() > 200
    np.testing.assert_allclose(both.rgb[hidden], alone.rgb[hidden], atol=1e-6)
    np.testing.assert_allclose(both.depth[hidden], alone.depth[hidden], atol=1e-6)


def test_no_pieces_are_the_background() -> None:
    picture = render_pieces(ball(0.2), view(16), [], (0.1, 0.2, 0.3))
    np.testing.assert_allclose(picture.rgb, np.broadcast_to([0.1, 0.2, 0.3], picture.rgb.shape), atol=1e-7)
    assert picture.alpha.max() == 0
    assert np.isinf(picture.depth).all()


def test_the_order_of_the_atoms_does_not_matter() -> None:
    atoms = ball(0.1)
    rng = np.random.default_rng(6)
    s, i = rng.permutation(len(atoms.surface)), rng.permutation(len(atoms.interior))
    mixed = rows_of(atoms, s, i)
    for planes in ([], CUTS):
        a, b = render(atoms, view(), planes), render(mixed, view(), planes)
        np.testing.assert_allclose(a.rgb, b.rgb, atol=5e-6)


def test_the_same_bits_again_with_any_number_of_cores() -> None:
    atoms = ball(0.1)
    first = render(atoms, view(), CUTS)
    before = cores()
    try:
        for count in (1, 2, 3):
            use_cores(count)
            again = render(atoms, view(), CUTS)
            np.testing.assert_array_equal(again.rgb, first.rgb)
            np.testing.assert_array_equal(again.depth, first.depth)
    finally:
        use_cores(before)


@pytest.mark.parametrize("zoom", [0.1, 0.3, 1.0, 3.0, 10.0])
def test_near_and_far_the_solid_has_no_holes(zoom: float) -> None:
    atoms = ball(0.05)
    base = orbit((0, 0, 0), UP, 20, 30, 4.0, 120, 120, math.radians(24))
    camera = replace(base, fx=base.fx * zoom, fy=base.fy * zoom)
    x, y = np.meshgrid(np.arange(120) + 0.5 - camera.cx, np.arange(120) + 0.5 - camera.cy)
    angle = np.arctan(np.hypot(x / camera.fx, y / camera.fy))
    margin = 1.5 / camera.fx
    inside = angle < np.arcsin(0.5 / 4) - margin
    picture = render(atoms, camera)
    assert inside.any()
    assert (picture.alpha[inside] >= 0.99).mean() >= 0.99
    outside = angle > np.arcsin((0.5 + 0.05) / 4) + margin
    assert picture.alpha[outside].max(initial=0) < 0.02


def test_thirty_planes_and_a_tangent_one() -> None:
    atoms = ball(0.12)
    turn = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    planes = [Plane.of((np.cos(a), np.sin(a), 0.3), -0.35) for a in turn]
    picture, truth = render(atoms, view(32), planes), reference(atoms, view(32), planes)
    assert psnr(picture.rgb, truth[0]) > 60
    tangent = [Plane.of((0, 0, 1), -0.5)]
    assert psnr(render(atoms, view(32), tangent).rgb, reference(atoms, view(32), tangent)[0]) > 60


def test_the_degenerate_is_finite() -> None:
    tiny = replace(view(), width=1, height=1, cx=0.5, cy=0.5)
    for atoms in (scatter(0, 0), scatter(1, 0), scatter(0, 1), ball(0.2)):
        for camera in (view(16), tiny, INSIDE):
            for planes in ([], CUTS):
                picture = render(atoms, camera, planes)
                assert np.isfinite(picture.rgb).all()
                assert not np.isnan(picture.depth).any()
    atoms = scatter(8, 4)
    atoms.surface.scales[:] = np.array(
        [[0, 0, 0], [1e-30, 1, 1], [1e12, 1, 1], [1e-9, 1e-9, 10], [1, 1, 1], [1e3, 1e-6, 1e-6], [0, 0, 1], [1, 0, 1]]
    )
    atoms.surface.quats[2] = 0
    atoms.surface.means[4] = view().position  # the eye lies on the atom
    atoms.surface.means[5] = view().position + 0.01 * view().forward
    for planes in ([], CUTS):
        picture = render(atoms, view(), planes)
        assert np.isfinite(picture.rgb).all()
        assert not np.isnan(picture.depth).any()
