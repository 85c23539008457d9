"""The up axis: analytic shapes and real captures, turned at random; the answer must turn along."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine.io.load import load
from engine.io.splats.ply import write_ply
from engine.solid.up_axis.detect import detect_up
from engine.solid.up_axis.evidence import DIRECTIONS, flat_base, resting_pose, symmetry
from engine.solid.up_axis.support_plane import support_plane
from tests.helpers.solids import round_gaussians
from tests.paths import SHARED

Z = np.array([0.0, 0.0, 1.0])
TURNS = [Rotation.identity(), *Rotation.random(3, random_state=7)]
PHOTOGRAPHED = {(0, -1, 0): 0.4}


def degrees(a, b):
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1))))


def ball(n=12000):
    points = np.random.default_rng(0).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def disc(radius, height, n):
    rng = np.random.default_rng(1)
    r, turn = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    return np.stack([r * np.cos(turn), r * np.sin(turn), np.full(n, height)], axis=1)


def cone(n=8000):
    """Radius 1, height 2, on its base at z = 0."""
    rim = disc(1.0, 0.0, n)
    side = rim.copy()
    side[:, 2] = 2 * (1 - np.linalg.norm(rim, axis=1))
    return np.concatenate([rim, side, side[::2] * [-1, 1, 1]])


def can(n=8000):
    """Radius 0.5, from z = 0 to 2."""
    rng = np.random.default_rng(2)
    turn = rng.uniform(0, 2 * np.pi, 2 * n)
    side = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), rng.uniform(0, 2, 2 * n)], axis=1)
    return np.concatenate([disc(0.5, 0.0, n // 2), disc(0.5, 2.0, n // 2), side])


def box(n=4000):
    """1 x 0.4 x 1.6, on z = 0: standing like a book, though lying would be more stable."""
    rng = np.random.default_rng(3)
    faces = []
    for axis in range(3):
        for end in (0.0, 1.0):
            face = rng.uniform(size=(n, 3))
            face[:, axis] = end
            faces.append(face)
    return (np.concatenate(faces) - [0.5, 0.5, 0.0]) * [1.0, 0.4, 1.6]


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("shape", [box, can, cone, lambda: ball() + Z])
def test_up_is_away_from_the_table(shape, turn):
    table = np.concatenate([disc(2.0, 0.0, 10000), np.random.default_rng(4).normal(0, 0.5, (300, 3)) - [0, 0, 0.6]])
    up = detect_up(round_gaussians(turn.apply(np.concatenate([shape(), table]))), PHOTOGRAPHED)
    assert degrees(up.axis, turn.apply(Z)) < 1.5
    assert "away from what it stands on" in up.reason and up.certainty > 0.5


@pytest.mark.parametrize("turn", TURNS)
def test_without_a_table_a_cone_stands_on_its_base_and_a_can_upright(turn):
    assert degrees(detect_up(round_gaussians(turn.apply(cone())), {}).axis, turn.apply(Z)) < 2
    axis = detect_up(round_gaussians(turn.apply(can())), {}).axis
    assert min(degrees(axis, turn.apply(Z)), degrees(axis, -turn.apply(Z))) < 2


def test_only_the_file_can_tell_for_a_ball():
    for axis in ((0, -1, 0), (0, 0, 1), (1, 0, 0)):
        up = detect_up(round_gaussians(ball()), {axis: 0.4})
        assert tuple(up.axis) == axis
        assert "files of this kind" in up.reason and up.certainty < 0.5
    assert detect_up(round_gaussians(ball()), {}).certainty < 0.1
    assert tuple(detect_up(round_gaussians(ball(50)), {(0, -1, 0): 0.4}).axis) == (0, -1, 0)


def test_an_axis_of_the_file_is_taken_where_the_shape_is_no_more_exact():
    tilted = Rotation.from_euler("x", 1.0, degrees=True)
    assert tuple(detect_up(round_gaussians(tilted.apply(cone())), {}).axis) == (0, 0, 1)
    tilted = Rotation.from_euler("x", 20.0, degrees=True)
    assert degrees(detect_up(round_gaussians(tilted.apply(cone())), {}).axis, tilted.apply(Z)) < 1


@pytest.mark.parametrize("shape", [ball, cone, box])
def test_evidence_is_a_density_and_a_ball_gives_none(shape):
    points = shape()[:6000] if shape is ball else shape()[::3]
    for density in (flat_base(points, 0.05), symmetry(points), resting_pose(points)):
        assert density.shape == (len(DIRECTIONS),) and density.min() >= 0
        assert density.mean() == pytest.approx(1, rel=0.1)
        if shape is ball:
            assert density.max() < 3


def test_a_flat_plate_and_a_line_have_an_up_axis():
    for points in (disc(1.0, 0.0, 4000), np.linspace(0, 1, 4000)[:, None] * np.ones(3)):
        assert np.linalg.norm(detect_up(round_gaussians(points), {}).axis) == pytest.approx(1)


def test_the_support_is_a_plane_that_reaches_beyond_the_object():
    turn, shift = TURNS[1], np.array([3.0, -2.0, 1.0])
    scene = np.concatenate([box(), disc(2.0, 0.0, 20000)])
    plane = support_plane(turn.apply(scene) + shift, np.ones(len(scene)))
    assert plane is not None
    assert degrees(plane.normal, turn.apply(Z)) < 0.3
    assert float(plane.distance(shift)) == pytest.approx(0, abs=0.01)
    assert float(plane.distance(turn.apply(Z) + shift)) == pytest.approx(1, abs=0.01)
    assert plane == support_plane(turn.apply(scene) + shift, np.ones(len(scene)))
    # Nothing stands on the cap of a bowl, but the cap is no table.
    bowls = [points[points[:, 2] > height] for points in (ball(12000), ball(30000)) for height in (-0.3, 0.0, 0.2)]
    for alone in (box(), ball(), *bowls, np.zeros((500, 3)), scene[:5]):
        assert support_plane(alone, np.ones(len(alone))) is None
    assert support_plane(scene, np.where(scene[:, 2] > 0, 1.0, 0.0)) is None


@pytest.mark.parametrize(("comment", "axis"), [("Vertical Axis: z", (0, 0, 1)), ("Vertical axis: y", (0, -1, 0))])
def test_a_ply_may_state_its_vertical_axis(tmp_path, comment, axis):
    write_ply(tmp_path / "ball.ply", round_gaussians(ball()), comments=(comment,))
    loaded = load(tmp_path / "ball.ply")
    assert tuple(detect_up(loaded.gaussians, loaded.file_axes).axis) == axis


CAPTURES = {
    "splats/donut_mipsplatting.ply": (0, 0, 1),
    "splats/tarot_box_capture.ply": (0, -1, 0),
    "splats/plant.splat": (0, -1, 0),
    "splats/guitar.compressed.ply": (0, -1, 0),
    "splats/meshgs_apple_30k.ply": (0, 0, 1),
    "splats/meshgs_orange_30k.ply": (0, 0, 1),
    "formats/biker.compressed.ply": (0, -1, 0),
    "meshes/trimesh_bunny.ply": (0, 1, 0),
}


@cache
def capture(name):
    if not (SHARED / name).exists():
        pytest.skip("shared data is not beside the project")
    return load(SHARED / name)


@pytest.mark.parametrize(("name", "axis"), CAPTURES.items())
def test_captures_as_they_are(name, axis):
    scene = capture(name)
    assert tuple(detect_up(scene.gaussians, scene.file_axes).axis) == axis


@pytest.mark.parametrize("name", ["splats/tarot_box_capture.ply", "splats/plant.splat", "meshes/trimesh_bunny.ply"])
def test_captures_that_lie_on_their_side(name):
    """A mat, a pot or a flat base is better evidence than the axes of the file."""
    scene = capture(name)
    for turn in Rotation.random(3, random_state=1):
        turned = replace(scene.gaussians, means=turn.apply(scene.gaussians.means).astype(np.float32))
        up = detect_up(turned, scene.file_axes)
        assert degrees(up.axis, turn.apply(CAPTURES[name])) < 8
