"""Standing the object on a face and turning it: laws of the geometry, and the edits of the document."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import OrbitCamera, project_points
from app.model.pieces import PointSample
from app.model.project import Project, load_project, save_project
from app.model.rigid_transform import vec3
from app.model.upright import face_normal, point_under, turn_between
from app.session.session import Session
from tests.helpers.solids import round_gaussians

SIDES = [np.array(side, float) for side in ((0, 0, -1), (0, 0, 1), (1, 0, 0), (0, -1, 0))]


def unit(*values):
    return np.array(values, float) / np.linalg.norm(values)


def cube(n=3000, noise=0.004):
    """The surface of a cube from -1 to 1."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (6 * n, 3))
    for side in range(6):
        points[side * n : (side + 1) * n, side // 2] = 1 - 2 * (side % 2)
    return points + rng.normal(0, noise, points.shape)


def session_with(points) -> Session:
    capture = round_gaussians(points)
    session = Session()
    session.object = LoadedObject(SceneRequest(Path("cube.ply")), capture, None, PointSample.of(capture.means))
    session.fit()
    return session


@pytest.mark.parametrize("start", [unit(0, 0, 1), unit(1, 2, -3), unit(1, 0, 0)])
@pytest.mark.parametrize("end", [unit(0, 0, 1), unit(0, 0, -1), unit(-1, -2, 3), unit(3, 1, 1)])
def test_the_shortest_turn_is_a_rotation_that_takes_one_to_the_other(start, end):
    turn = turn_between(start, end)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)
    np.testing.assert_allclose(turn @ start, end, atol=1e-9)
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    assert angle == pytest.approx(np.arccos(np.clip(start @ end, -1, 1)), abs=1e-6)


@pytest.mark.parametrize("up", [unit(0, 0, 1), unit(1, -2, 0.3)])
def test_the_view_after_a_turn_is_that_of_a_turned_object(up):
    turn = Rotation.random(random_state=3).as_matrix()
    centre, points = np.array([0.3, -0.2, 0.5]), np.random.default_rng(1).normal(size=(20, 3))
    eye = OrbitCamera((0.1, 0.4, 0.2), 33.0, 17.0, 6.0)
    moved = eye.turned_with(turn, centre, vec3(up))
    seen = project_points(moved.camera(320, 200, vec3(turn.T @ up)), points)
    expected = project_points(eye.camera(320, 200, vec3(up)), (points - centre) @ turn.T + centre)
    for a, b in zip(seen, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-7)


@pytest.mark.parametrize("side", SIDES)
def test_the_normal_of_a_face_and_of_a_ball(side):
    at = side + 0.4 * np.roll(side, 1)
    normal = face_normal(cube(), at, 5 * side, np.sqrt(3))
    assert normal is not None and normal @ side > np.cos(np.radians(0.3))
    ball = np.random.default_rng(2).standard_normal((20000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    normal = face_normal(ball, unit(1, 2, 3), 5 * unit(1, 2, 3), 1.0)
    assert normal is not None and normal @ unit(1, 2, 3) > np.cos(np.radians(3))
    assert face_normal(ball, np.array([5.0, 0, 0]), np.zeros(3), 1.0) is None


def test_the_foremost_point_is_pointed_at():
    camera = OrbitCamera(distance=6.0, azimuth=0.0, elevation=0.0).camera(400, 400, (0, 0, 1))
    point = point_under(cube(), camera, (200, 200))
    assert point is not None and point[0] == pytest.approx(1, abs=0.03)
    assert point_under(cube(), camera, (5, 5)) is None


@pytest.mark.parametrize("side", SIDES)
def test_stand_on_a_face_is_one_step_that_can_be_undone_and_saved(side, tmp_path):
    session = session_with(cube())
    before = session.viewing.eye.camera(64, 64, session.up)
    session.stand_on(side, 5 * side)
    assert np.dot(session.up, -side) > np.cos(np.radians(0.3))
    after = session.viewing.eye.camera(64, 64, session.up)
    assert np.asarray(session.up) @ after.forward == pytest.approx(np.array([0, 0, 1.0]) @ before.forward)
    save_project(tmp_path / "cube.fruitninja", Project(session.documents, session.viewing))
    assert load_project(tmp_path / "cube.fruitninja").documents[0] == session.document
    if session.history.cursor:  # unless it stood on this face already
        session.undo()
    assert session.document.up is None and session.up == (0, 0, 1)
    session.stand_on(np.array([9.0, 9, 9]), np.zeros(3))
    assert session.document.up is None and "no face" in session.message


def test_a_drag_of_the_rings_is_one_step():
    session = session_with(cube())
    turn = Rotation.from_euler("x", 3, degrees=True).as_matrix()
    for _ in range(10):
        session.turn_object(turn)
    np.testing.assert_allclose(session.up, Rotation.from_euler("x", -30, degrees=True).apply([0, 0, 1]), atol=1e-9)
    assert len(session.history.entries) == 2
    session.set_up("Up", (3, 0, 4))
    assert session.up == pytest.approx((0.6, 0, 0.8))
