"""The up axis: floors and roundness decide, and the real captures whose axis is known."""

from __future__ import annotations

import numpy as np
import pytest

from engine.io.load import load
from engine.scene.gaussians import Gaussians
from engine.solid.up_axis import detect_up
from tests.paths import SHARED

DATA = SHARED


def cloud(means):
    n = len(means)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    scales = np.full((n, 3), 0.01, np.float32)
    return Gaussians(means.astype(np.float32), scales, quats, np.ones(n, np.float32), np.zeros((n, 1, 3), np.float32))


def ball(n=4000):
    points = np.random.default_rng(0).standard_normal((n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mat_under_the_object_is_down(axis, sign):
    mat = np.random.default_rng(1).uniform(-2, 2, (4000, 3))
    mat[:, axis] = -sign
    up, reason = detect_up(cloud(np.concatenate([ball(), mat])))
    assert up[axis] == sign
    assert "floor" in reason


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_dome_stands_on_its_flat_end(axis, sign):
    dome = ball(8000)
    dome = dome[dome[:, axis] * sign > 0]
    disc = np.random.default_rng(2).uniform(-1, 1, (6000, 3))
    disc[:, axis] = 0.0
    disc = disc[np.linalg.norm(disc, axis=1) < 1]
    up, reason = detect_up(cloud(np.concatenate([dome, disc])))
    assert up[axis] == sign
    assert "floor" in reason or "broad end" in reason


def test_a_flattened_ball_stands_on_its_flat_side():
    for axis in range(3):
        up, _ = detect_up(cloud(ball() * np.where(np.arange(3) == axis, 0.6, 1.0)))
        assert abs(up[axis]) == 1
    assert detect_up(cloud(ball()))[0][2] == 1
    assert detect_up(cloud(ball()[:5]))[0][2] == 1


@pytest.mark.parametrize(
    ("name", "up"),
    [("donut_mipsplatting", (0, 0, 1)), ("tarot_box_capture", (0, -1, 0)), ("meshgs_orange_30k", (0, 0, 1))],
)
def test_real_captures(name, up):
    path = DATA / f"splats/{name}.ply"
    if not path.exists():
        pytest.skip("shared data is not beside the project")
    assert tuple(detect_up(load(path).gaussians)[0]) == up
