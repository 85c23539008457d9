"""What of a scene is shown, and when: a part of a large capture before the whole, a solid before its skin is fitted."""

from __future__ import annotations

import io
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

import fruitninja
from app.jobs import coarse_picture as module
from app.jobs import scene_worker
from app.jobs.coarse_picture import coarse_picture
from app.jobs.scene_loader import LoadedObject, SceneLoader, SceneRequest
from app.model.autosave import Autosave
from app.model.document import Document
from app.model.history import History
from app.model.pieces import PointSample
from app.model.project import Viewing, Work
from app.session.session import Session
from engine.io.load import load
from engine.io.splats.ply import write_ply
from engine.isolate.record import isolation_record
from engine.isolate.selection import keep_only
from tests.engine.scene.test_gather import painted
from tests.helpers.solids import ball
from tests.training.test_train_command import SCENE, make_tiny


def test_a_part_is_enlarged_until_it_covers_what_all_cover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = painted(20_000)
    write_ply(tmp_path / "ball.ply", whole)
    assert coarse_picture(tmp_path / "ball.ply") is None  # so small a file is read in one go
    monkeypatch.setattr(module, "LEAST_FILE", 0)
    monkeypatch.setattr(module, "MOST", 5000)
    part = coarse_picture(tmp_path / "ball.ply")
    assert part is not None and len(part.gaussians) == 5000
    area = [float((g.scales[:, 0] * g.scales[:, 1]).sum()) for g in (part.gaussians, whole)]
    assert 0.5 < area[0] / area[1] < 2
    assert np.array_equal(part.gaussians.means, load(tmp_path / "ball.ply").gaussians.means[::4])
    assert coarse_picture(tmp_path / "nowhere.ply") is None


@pytest.mark.slow
def test_the_window_shows_a_part_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    path = tmp_path / "ball.ply"
    write_ply(path, painted(300_000))
    assert path.stat().st_size > module.LEAST_FILE
    session = Session(autosave=Autosave(tmp_path))
    session.files.open_document(Document(scene=path), Viewing())
    shown: list[tuple[int, float]] = []
    end = time.monotonic() + 120
    while session.object is None or session.object.capture is None:
        assert time.monotonic() < end and not session.error, session.error
        session.tick()
        if session.shown_capture is not None and not session.isolation.available:
            shown.append((len(session.shown_capture), session.solid.radius))
        time.sleep(0.01)
    session.scene.cancel()
    assert shown and module.MOST / 2 < shown[0][0] <= module.MOST
    assert session.shown_capture is not None and len(session.shown_capture) == 300_000
    assert session.object.coarse is None
    assert shown[0][1] == pytest.approx(session.solid.radius, rel=0.02)  # so that the view does not have to change


def test_the_window_ends_with_the_skin_that_solidify_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make_tiny(monkeypatch)
    monkeypatch.setattr(scene_worker, "yield_to_others", lambda: None)  # this process goes on with other tests
    around = fruitninja.Sphere((0.0, 0.0, 0.0), 9.0)
    threads = torch.get_num_threads() + 1
    torch.set_num_threads(threads)
    parts: list[tuple[str, float]] = []
    solid = fruitninja.load(SCENE / "watermelon.ply", seed=3).solidify(
        detail="draft", keep=[around], seed=3, progress=lambda *told: parts.append(told)
    )
    assert [stage for stage, part in parts if not part] == ["body", "atomise", "refit"] and parts[-1] == ("refit", 1.0)
    assert torch.get_num_threads() == threads  # as the caller set them
    torch.set_num_threads(threads - 1)
    request = {"scene": str(SCENE / "watermelon.ply"), "folder": str(tmp_path), "detail": "draft", "seed": 3}
    request |= {"trained": None, "isolation": isolation_record((keep_only(around),)), "opened": False, "refit": True}
    monkeypatch.setattr("sys.stdin", io.StringIO(json.dumps(request) + "\n"))
    scene_worker.main()
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    sent = [line for line in lines if "ready" in line]
    assert [line["ready"] for line in sent] == ["atoms"] and not sent[0]["facts"]["rough"] and lines[-1]["end"]
    skin = load_file(sent[0]["file"])
    for name in ("means", "scales", "quats", "sh"):
        assert np.array_equal(skin[name], getattr(solid.atoms.surface, name)), name


def test_a_result_that_cannot_be_held_ends_loading(monkeypatch: pytest.MonkeyPatch) -> None:
    class Process:
        stdout, stderr = io.StringIO('{"ready": "atoms", "file": "none"}\n'), io.BytesIO()
        stdin = io.BytesIO()
        wait = kill = staticmethod(lambda: None)

    def too_large(_: Path) -> None:
        raise MemoryError("no room for 9 GB")

    monkeypatch.setattr("app.jobs.scene_loader.start_python", lambda *_, **__: Process())
    monkeypatch.setattr("app.jobs.scene_loader.map_arrays", too_large)
    loader = SceneLoader(SceneRequest(SCENE / "watermelon.ply"))
    end = time.monotonic() + 20
    while not loader.ended:
        assert time.monotonic() < end
        loader.poll()
        time.sleep(0.01)
    assert loader.error == "watermelon.ply: opening it failed (no room for 9 GB)"


class Loader:
    """Stands in for a loader of a scene; a test says what it has read."""

    def __init__(self, request: SceneRequest, shown: LoadedObject | None = None) -> None:
        self.request, self.scene = request, shown
        self.ended = self.cancelled = self.announced = self.arrived = False
        self.error = ""
        MADE.append(self)

    def poll(self) -> bool:
        arrived, self.arrived = self.arrived, False
        return arrived

    def cancel(self) -> None:
        self.ended = self.cancelled = True

    def end(self, **changes: Any) -> None:
        assert self.scene is not None
        self.scene, self.ended, self.arrived = replace(self.scene, **changes), True, bool(changes)


MADE: list[Loader] = []
"""The loaders that a test has started so far."""


@pytest.fixture
def rough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """A session with two solids whose skins can be fitted more closely, after its first tick."""
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    monkeypatch.setattr("app.session.scene_controller.SceneLoader", Loader)
    MADE.clear()
    two = Document(scene=tmp_path / "two.ply", number=1), Document(scene=tmp_path / "two.ply", number=2)
    session = Session(history=History(Work(two)), autosave=Autosave(tmp_path))
    atoms = ball(1 / 6, degree=0)
    for document in two:
        request = SceneRequest(tmp_path / "two.ply")
        session.loaded[document.number] = LoadedObject(request, None, atoms, PointSample.of_atoms(atoms), rough=True)
    session.tick()
    return session


def test_skins_are_fitted_one_by_one_once_all_is_solid(rough: Session) -> None:
    finer = ball(1 / 7, degree=0)
    assert len(MADE) == 1 and MADE[0].request.refit
    rough.tick()
    MADE[0].end(atoms=finer, rough=False)
    rough.tick()
    assert rough.loaded[1].atoms is finer and rough.loaded[2].atoms is not finer and "solid now" not in rough.message
    rough.tick()
    assert len(MADE) == 2 and MADE[1].request.refit
    MADE[1].end(atoms=finer, rough=False)
    rough.tick()
    rough.tick()
    assert rough.loaded[2].atoms is finer and rough.loader is None and len(MADE) == 2


def test_a_fit_gives_way_to_a_load_and_is_begun_again(rough: Session) -> None:
    kept = keep_only(fruitninja.Sphere((0.0, 0.0, 0.0), 9.0))
    rough.change_object("Keep", 1, replace(rough.documents[1], isolation=(kept,)))
    rough.tick()
    assert MADE[0].cancelled and len(MADE) == 2 and not MADE[1].request.refit and MADE[1].request.isolation == (kept,)
    rough.tick()
    assert not MADE[1].cancelled  # an interrupted fit does not ask for its object to be made again
    atoms = ball(1 / 6, degree=0)
    MADE[1].scene = LoadedObject(MADE[1].request)
    MADE[1].end(atoms=atoms, solid=PointSample.of_atoms(atoms), rough=True)
    rough.tick()
    rough.tick()
    assert len(MADE) == 3 and MADE[2].request.refit and rough.loaded[1].rough


@pytest.mark.parametrize("how", ["cancelled", "failed"])
def test_a_fit_that_was_cancelled_or_failed_is_not_begun_again(rough: Session, how: str) -> None:
    if how == "cancelled":
        rough.scene.cancel()
    else:
        MADE[0].error = "two.ply: not enough memory for it"
        MADE[0].end()
    for _ in range(3):
        rough.tick()
    assert [loader.request.refit for loader in MADE] == [True, True]  # the second is that of the other object
    assert rough.loaded[1].atoms is not None and rough.error == MADE[0].error


def test_nothing_is_fitted_while_something_trains(rough: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    class Job:
        ended, phase, document = False, "running", rough.document
        out = rough.autosave.file.parent

        def poll(self) -> bool:
            return False

    job = Job()
    monkeypatch.setattr("app.session.training_controller.Job.start", lambda *_, **__: job)
    rough.training.start()
    assert MADE[0].cancelled
    rough.tick()
    assert len(MADE) == 1
    job.ended, job.phase = True, "stopped"
    rough.tick()
    rough.tick()
    assert len(MADE) == 2 and MADE[1].request.refit
