"""Isolating the object without a window: what drags mean, what is shown, and what projects and results remember."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import training.request
from app.jobs import scene_loader, scene_worker
from app.jobs.scene_loader import LoadedObject, SceneLoader, SceneRequest
from app.model.autosave import Autosave
from app.model.camera_control import project_points
from app.model.capture_view import view_of
from app.model.document import Document
from app.model.history import History
from app.model.marking import Marker, box_edges, shape_of
from app.model.project import Work, load_project, save_project
from app.session.session import Session
from engine.io.load import load
from engine.io.splats.ply import ply_data
from engine.io.trained import Meta, save_trained
from engine.isolate.record import isolation_record
from engine.isolate.selection import (
    INVERT,
    NO_SURROUNDINGS,
    Box,
    Detected,
    Isolation,
    Lasso,
    Sphere,
    Step,
    keep_only,
    removed,
)
from engine.scene.camera import orbit
from engine.scene.gaussians import Gaussians
from engine.scene.sh import sh_to_rgb
from tests.helpers.app_isolate_steps import MAT, melon_on_a_mat
from tests.helpers.app_objects import atoms, full
from tests.helpers.solids import joined, round_gaussians
from tests.helpers.workers.quick_scene_worker import BODY_CELLS, QUICK, use_quick_worker
from tests.paths import ROOT
from training.events import Reporter
from training.families import Family
from training.pipeline import prepare
from training.request import Request
from training.settings import DETAILS


def ball(count: int = 4000) -> Gaussians:
    """A unit ball's skin around (5, 5, 5), grey."""
    points = np.random.default_rng(0).normal(size=(count, 3))
    return round_gaussians(points / np.linalg.norm(points, axis=1, keepdims=True) + 5, 0.03, bands=4)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_drag_selects_what_is_seen_under_it(orthographic: bool) -> None:
    capture = ball()
    camera = orbit((5, 5, 5), (0, 0, 1), 30, 20, 6.0, 400, 300)
    if orthographic:
        camera = replace(camera, fx=camera.fx / 6, fy=camera.fy / 6, orthographic=True)
    pixels, _ = project_points(camera, capture.means)

    def drawn(marker: Marker, *path: tuple[float, float]) -> Box | Sphere | Lasso:
        shape = shape_of(marker, camera, path, capture, 6.0)
        assert isinstance(shape, Box | Sphere | Lasso)
        return shape

    triangle = ((120.0, 60.0), (260.0, 90.0), (180.0, 250.0))
    corners = np.array(triangle)
    edges = np.roll(corners, -1, axis=0) - corners
    sides = [
        edge[0] * (pixels - corner)[:, 1] - edge[1] * (pixels - corner)[:, 0]
        for corner, edge in zip(corners, edges, strict=True)
    ]
    assert np.array_equal(drawn("lasso", *triangle).contains(capture.means), np.all([side > 0 for side in sides], 0))

    box = drawn("box", (260, 90), (120, 250))
    assert isinstance(box, Box)
    inside = ((pixels >= (120, 90)) & (pixels <= (260, 250))).all(1)
    assert (box.contains(capture.means) == inside).mean() > (0.9999 if orthographic else 0.93)  # a box is no cone
    outline = project_points(camera, box_edges(box).reshape(-1, 3))[0]
    assert outline[:, 0].min() < 121 and outline[:, 0].max() > 259

    middle, rim = (200.0, 150.0), (200.0, 150.0 + (pixels[:, 1].max() - pixels[:, 1].min()) / 2)
    sphere = drawn("sphere", middle, rim)
    assert isinstance(sphere, Sphere)
    assert np.linalg.norm(np.array(sphere.centre) - 5) < 0.1 and abs(sphere.radius - 1) < 0.06
    assert shape_of("sphere", camera, [middle, (201.0, 151.0)], capture, 6.0) is None
    aside = drawn("sphere", (10.0, 10.0), (40.0, 10.0))  # there is nothing there
    assert isinstance(aside, Sphere)
    assert abs((np.array(aside.centre) - camera.position) @ camera.forward - 6) < 1e-6


def test_what_is_shown_is_what_is_left_with_the_selected_tinted() -> None:
    capture, tint = ball(), (1.0, 0.0, 0.0)
    isolation: Isolation = (keep_only(Box((4, 4, 4), (6, 6, 5))),)
    steps = (Step("add", Sphere((5, 5, 4), 0.5)), Step("grow"), INVERT, Step("subtract", Sphere((5, 5, 4), 0.2)))
    fresh = view_of(capture, isolation, steps[:1], tint)
    assert len(fresh.left) == int((~removed(capture, isolation)).sum()) and 0 < fresh.selected.sum() < len(fresh.left)
    rgb = sh_to_rgb(fresh.shown.sh[:, 0])
    assert np.allclose(rgb[fresh.selected], (0.85, 0.15, 0.15), atol=1e-6) and np.allclose(rgb[~fresh.selected], 0.5)
    step_by_step = view_of(capture, (), (), tint)
    assert step_by_step.shown is capture
    for count in range(5):
        step_by_step = view_of(capture, isolation, steps[:count], tint, step_by_step)
    whole = view_of(capture, isolation, steps, tint)
    assert np.array_equal(step_by_step.selected, whole.selected) and whole.is_for(capture, isolation, steps, tint)


def test_a_project_of_an_earlier_version_has_one_object(tmp_path: Path) -> None:
    path = tmp_path / "p.fruitninja"
    save_project(path, full(tmp_path))
    record = json.loads(path.read_text())
    fields = record.pop("objects")[0]
    for name in ("number", "name", "visible"):
        del fields[name]
    single = replace(full(tmp_path).documents[0], number=0, name="", visible=True)
    path.write_text(json.dumps(record | fields | {"fruitninja": 2}))
    assert load_project(path).documents == (single,)
    del fields["isolation"], fields["marked"]
    path.write_text(json.dumps(record | fields | {"fruitninja": 1}))
    assert load_project(path).documents == (replace(single, isolation=(), selection=()),)


def test_a_result_of_another_part_of_the_capture_is_not_shown(tmp_path: Path) -> None:
    isolation: Isolation = (keep_only(Box((0, 0, 0), (1, 1, 1 / 3))), (Step("add", Detected("floor")),))
    document = Document(scene=tmp_path / "melon.ply")
    (tmp_path / "melon-inside").mkdir()
    result = tmp_path / "melon-inside" / "melon.ply"
    save_trained(result, atoms(), Meta(isolation=tuple(isolation_record(isolation))))
    training = Session().training
    assert training.result_for(document) is None
    assert training.result_for(Document(scene=document.scene, isolation=isolation)) == result
    save_trained(result, atoms(), Meta())
    assert training.result_for(document) == result
    assert training.result_for(Document(scene=document.scene, isolation=isolation)) is None


def test_nothing_is_removed_without_a_selection_and_not_everything() -> None:
    capture = ball()
    session = Session(history=History(Work((Document(scene=Path("melon.ply")),))))
    session.object = LoadedObject(SceneRequest(Path("melon.ply")), capture)

    def settle() -> None:
        session.isolation.tick()
        while session.isolation.pending:
            time.sleep(0.01)
        session.isolation.tick()

    settle()
    session.isolation.remove_selected()
    assert "Nothing is selected" in session.message
    session.isolation.invert()
    session.isolation.keep_selected()
    assert "One moment" in session.message
    settle()
    session.isolation.keep_selected()
    assert "Everything is selected" in session.message and session.document.isolation == ()
    session.undo()
    assert session.document.selection == ()


def test_a_scene_that_is_opened_is_shown_without_its_surroundings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Undo brings them back for good, and leaves nothing to save."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(4000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    walls = rng.uniform(-12, 12, (6000, 3))
    walls[np.arange(6000), np.arange(6000) % 3] = np.where(np.arange(6000) % 2, 12, -12)
    scene = tmp_path / "room.ply"
    far = round_gaussians(walls, 0.7, 0.8)
    ply_data(joined(round_gaussians(ball, 0.06, 0.8), far), []).write(str(scene))
    session = Session(autosave=Autosave(tmp_path))
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    session.files.open(scene)

    def read(without: bool) -> LoadedObject:
        start = time.monotonic()
        while (
            (seen := session.object) is None
            or seen.capture is None
            or (NO_SURROUNDINGS in seen.request.isolation) != without
        ):
            session.tick()
            time.sleep(0.01)
            assert not session.error and time.monotonic() - start < 60, session.error
        return seen

    seen = read(without=True)
    assert session.document.isolation == (NO_SURROUNDINGS,) == seen.request.isolation
    assert not session.history.changed and session.scene.outdated is None
    assert np.linalg.norm(seen.extent, axis=1).max() < 2
    session.undo()
    assert session.document.isolation == () and session.scene.outdated is session.document
    seen = read(without=False)  # or the walls alone, if they have been separated by then
    assert NO_SURROUNDINGS not in session.document.isolation
    assert np.linalg.norm(seen.extent, axis=1).max() > 10
    session.scene.cancel()


@pytest.mark.slow
def test_the_window_and_the_trainer_make_the_same_skin_of_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))  # the helper sets a different one
    assert scene_worker.DETAILS is training.request.DETAILS is DETAILS  # one table of detail for both
    monkeypatch.setitem(DETAILS, "draft", QUICK)  # the same for both, coarser than the default
    monkeypatch.setattr("engine.solid.solidify.BODY_CELLS", BODY_CELLS)
    monkeypatch.setattr(scene_loader, "start_python", scene_loader.start_python)
    use_quick_worker()
    monkeypatch.setenv("PYTHONPATH", str(ROOT), prepend=os.pathsep)  # the folder of the worker's module
    document = melon_on_a_mat(tmp_path)
    assert document.scene is not None
    isolation: Isolation = ((Step("add", Detected("floor")),),)
    picture = Family("radial", 3, (tmp_path / "a.png",))
    request = Request(document.scene, (picture,), "draft", (0.0, 0.0, 1.0), isolation=isolation)
    geometry, facts = prepare(request, Reporter(), lambda: None)
    assert abs(facts["gaussians"] - (len(load(document.scene).gaussians) - MAT)) < 0.05 * MAT
    loader = SceneLoader(SceneRequest(document.scene, "draft", isolation=isolation))
    while not loader.ended and loader.scene.atoms is None:  # the first solid has the skin before fitting
        loader.poll()
        time.sleep(0.02)
    loader.cancel()
    assert not loader.error and loader.scene.atoms is not None
    assert np.array_equal(loader.scene.atoms.surface.means, geometry.skin.means)
    assert loader.scene.solid is not None and loader.scene.solid.radius < 1.5
