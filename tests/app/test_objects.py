"""Several objects in a session: found, cut, hidden, undone, split by hand, saved, each with its own result."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.jobs.results import default_out, result_folder
from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import OrbitCamera
from app.model.document import Document, Part, Training
from app.model.film.throw import SECONDS
from app.model.history import History
from app.model.knife import Stroke
from app.model.pieces import PointSample
from app.model.project import Project, Viewing, Work, load_project, save_project
from app.session.session import Session
from engine.isolate.bodies import Bodies, find_bodies
from engine.isolate.selection import Sphere, Step, removed
from engine.scene.atoms import Atoms
from engine.scene.gaussians import Gaussians
from engine.scene.plane import Plane
from tests.helpers.solids import ball, beside
from tests.paths import HELPERS

EYE = OrbitCamera((0.5, 0.0, 0.0), -90.0, 0.0, 8.0)
STUB = (sys.executable, str(HELPERS / "app_stub_trainer.py"))

ACROSS = Stroke((0.0, 60.0), (160.0, 60.0))
"""From edge to edge of the viewport, through both balls."""


def shell() -> Gaussians:
    skin = ball(1 / 16, degree=0).surface
    return Gaussians(skin.means, skin.scales * 1.5, skin.quats, np.ones(len(skin), np.float32), skin.sh)


CAPTURE = beside(shell(), shell(), places=((0, 0, 0), (1.5, 0, 0)))


FOUND: dict[bytes, Bodies] = {}
"""The bodies of captures by where and how large their Gaussians are, which decides."""


def find_once(gaussians: Gaussians) -> Bodies:
    """`find_bodies`, but once for all the sessions that open the same capture."""
    parts = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities)
    key = b"".join(part.tobytes() for part in parts)
    if key not in FOUND:
        FOUND[key] = find_bodies(gaussians)
    return FOUND[key]


@pytest.fixture(autouse=True)
def bodies_are_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("engine.isolate.selection.find_bodies", find_once)


def moved(atoms: Atoms, x: float) -> Atoms:
    shift = np.array((x, 0, 0), np.float32)
    surface = replace(atoms.surface, means=atoms.surface.means + shift)
    return replace(atoms, surface=surface, interior=replace(atoms.interior, means=atoms.interior.means + shift))


def settle(session: Session) -> None:
    session.isolation.tick()
    for _ in range(6):
        while session.isolation.pending:
            time.sleep(0.01)
        session.isolation.tick()


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    scene = tmp_path / "two.ply"
    made = Session(history=History(Work((Document(scene=scene),))), viewing=Viewing(EYE, "solid"))
    made.object = LoadedObject(SceneRequest(scene), CAPTURE, None, PointSample.of(CAPTURE.means))
    settle(made)
    return made


def make_solid(session: Session) -> None:
    for index, document in enumerate(session.documents):
        left = CAPTURE[~removed(CAPTURE, document.isolation)]
        atoms = moved(ball(1 / 12, degree=0), float(left.means[:, 0].mean()))
        request = SceneRequest(Path("two.ply"), isolation=document.isolation)
        session.loaded[document.number] = LoadedObject(request, CAPTURE, atoms, PointSample.of_atoms(atoms))
        session.activate(index, False)


def test_strokes_through_what_is_not_solid_yet_are_done_when_it_is(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Loading:
        request = SceneRequest(Path("two.ply"))
        ended, announced, error, scene = False, False, "", LoadedObject(request)

        def poll(self) -> bool:
            return False

    monkeypatch.setattr(session, "loader", Loading())
    monkeypatch.setattr(session.scene, "load", lambda *_, **__: None)
    camera = EYE.camera(160, 120, session.view_up)
    for height in (50.0, 70.0):
        session.slice(camera, Stroke((0.0, height), (160.0, height)))
    assert not any(document.cuts for document in session.documents) and "will be cut" in session.message
    make_solid(session)
    session.tick()
    assert [len(document.cuts) for document in session.documents] == [2, 2]
    assert [entry.name for entry in session.history.entries][-2:] == ["Cut", "Cut"]
    session.tick()
    assert len(session.history.entries) == 4  # the strokes are done only once


def test_separate_bodies_become_objects_once_and_undo_makes_them_one(session: Session) -> None:
    assert [document.number for document in session.documents] == [1, 2] and "2 separate objects" in session.message
    assert not session.history.changed  # closing now would lose nothing
    kept = [~removed(CAPTURE, document.isolation) for document in session.documents]
    assert np.array_equal(kept[0], ~kept[1]) and kept[0].sum() == len(CAPTURE) // 2
    assert len(session.shown_capture or ()) == len(CAPTURE)
    session.change_object("Hide object", 1, replace(session.documents[1], visible=False))
    settle(session)
    assert len(session.shown_capture or ()) == len(CAPTURE) // 2
    session.undo()
    session.undo()
    settle(session)
    assert [document.number for document in session.documents] == [0]
    session.redo()
    settle(session)
    assert len(session.documents) == 2


def test_a_project_that_was_saved_as_one_object_stays_one(session: Session, tmp_path: Path) -> None:
    other = Session(history=History(Work((Document(scene=tmp_path / "two.ply"),))), path=tmp_path / "a.fruitninja")
    other.object = LoadedObject(SceneRequest(tmp_path / "two.ply"), CAPTURE, None, PointSample.of(CAPTURE.means))
    settle(other)
    assert len(other.documents) == 1


def test_a_stroke_cuts_the_selected_object_or_all(session: Session) -> None:
    make_solid(session)
    camera = EYE.camera(160, 120, session.view_up)
    session.slice(camera, ACROSS)
    assert [len(document.cuts) for document in session.documents] == [1, 1] and session.message == "Cut 2 objects."
    session.undo()
    assert not any(document.cuts for document in session.documents)
    session.activate(1)
    session.slice(camera, ACROSS)
    assert [len(document.cuts) for document in session.documents] == [0, 1] and session.message == "Cut into two."
    session.activate(0)
    assert [session.is_cut(member) for member in session.members] == [True, False, False]
    session.undo()  # the document of the undone step is shown
    assert session.active == 1 and len(session.members) == 2
    session.change_object("Hide object", 0, replace(session.documents[0], visible=False))
    session.activate(1, False)
    session.slice(camera, ACROSS)
    assert [len(document.cuts) for document in session.documents] == [0, 1]  # hidden objects are not cut
    session.activate(0)
    session.slice(camera, ACROSS)
    assert not session.documents[0].cuts and "hidden" in session.message


def test_what_is_selected_becomes_an_object_of_its_own(session: Session) -> None:
    session.activate(0)
    left = CAPTURE[~removed(CAPTURE, session.document.isolation)]
    centre = left.means.mean(0).astype(float)
    lid = Sphere((float(centre[0]), float(centre[1]), float(centre[2]) + 0.5), 0.4)
    session.change("Select", replace(session.document, selection=(Step("add", lid),), training=Training(seed=3)))
    settle(session)
    session.isolation.split_selected()
    assert [document.number for document in session.documents] == [1, 3, 2]
    parts = [~removed(CAPTURE, document.isolation) for document in session.documents]
    assert np.array_equal(sum(part.astype(int) for part in parts), np.ones(len(CAPTURE)))
    assert parts[1].sum() == lid.contains(left.means).sum() and session.documents[1].training.seed == 3


def test_a_load_that_another_one_ended_has_its_turn_again(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    class Loader:
        """Records what is requested, and never ends by itself."""

        def __init__(self, request: SceneRequest) -> None:
            self.request, self.ended, self.error, self.announced = request, False, "", False
            asked.append([d.isolation for d in session.documents].index(request.isolation) + 1)

        def poll(self) -> bool:
            return False

        def cancel(self) -> None:
            self.ended = True

    monkeypatch.setattr("app.session.scene_controller.SceneLoader", Loader)
    make_solid(session)
    assert session.scene.outdated is None
    for document in session.documents:  # as when two trainings end at the same time
        session.scene.load(None, document)
    assert asked == [1, 2] and session.scene.outdated is None  # the second load continues
    assert session.loader is not None
    session.loader.cancel()
    session.tick()
    session.tick()
    assert asked == [1, 2, 1]
    session.loader.cancel()
    session.tick()
    assert session.scene.outdated is None and session.loader is None


def test_a_throw_ends_when_another_object_is_chosen(session: Session) -> None:
    make_solid(session)
    clock = 50.0
    session.throw.clock = lambda: clock
    session.throw.begin(EYE.camera(160, 120, (0, 0, 1)))
    clock += SECONDS / 2
    session.throw.slice(EYE.camera(160, 120, (0, 0, 1)), ACROSS)
    assert session.throw.active and session.throw.pieces > 1
    session.activate(1 - session.active)
    session.throw.keep()
    assert not any(document.cuts for document in session.documents)
    session.throw.begin(EYE.camera(160, 120, (0, 0, 1)))
    session.activate(1 - session.active)
    session.throw.tick()
    assert not session.throw.active and not session.previewing


def test_a_piece_of_which_nothing_is_shown_is_not_turned(session: Session) -> None:
    make_solid(session)
    session.change("Plane", session.document.with_cut((Part(Plane.of((0, 0, 1), 9.0)),), "Plane", "section"))
    hidden = session.document.with_cut((Part(Plane.of((0, 0, 1), -9.0)),), "Plane", "section")
    session.change("Plane", hidden)
    session.selected = frozenset(piece.key for piece in session.pieces)
    session.tool = "turn"
    session.keyboard.arrow(EYE.camera(160, 120, (0, 0, 1)), 1, 0)
    for document in session.documents:
        assert all(np.isfinite(placement.motion.matrix).all() for _, placement in document.placements)


def test_two_objects_are_trained_at_the_same_time(session: Session, tmp_path: Path) -> None:
    picture = tmp_path / "cut.png"
    picture.touch()
    (tmp_path / "two.ply").touch()
    session.training.program = (*STUB, "--steps", "2000")
    try:
        for index in (0, 1):
            session.activate(index)
            session.change("Picture", session.document.with_exemplars("radial", (picture,)))
            session.training.start()
        assert not session.error and len(session.training.jobs) == 2
        assert session.training.job is session.training.jobs[1] and session.training.job.document.number == 2
        session.training.tick()
        session.training.stop()
        session.training.toggle_pause()  # would suspend it before it has ended
        assert not session.training.can_pause and session.training.job.phase == "stopping"
        assert "paused" not in session.message
        # Once it has stopped and goes on, it is remembered for the next start, as a new one is.
        stopped = session.training.job
        while not stopped.ended:
            session.training.tick()
            time.sleep(0.02)
        session.training.tick()
        assert str(stopped.out) not in session.settings.jobs
        session.training.resume()
        assert not session.error and str(stopped.out) in session.settings.jobs
        session.activate(0)
        assert session.training.busy
        session.files.save(tmp_path / "a.fruitninja")
        session.files.close()
        assert session.question is not None and "still running" in session.question.title
    finally:
        for job in session.training.jobs:
            assert job.child is not None
            job.child.kill()
            job.child.wait()


def test_each_object_has_its_own_result_and_the_project_keeps_all(session: Session, tmp_path: Path) -> None:
    outs = {result_folder(document) for document in session.documents}
    assert outs == {default_out(tmp_path / "two.ply", n) for n in (1, 2)} and len(outs) == 2
    session.change_object("Name", 0, replace(session.documents[0], name="Apple", up=(0.0, 1.0, 0.0)))
    session.change_object("Hide object", 1, replace(session.documents[1], visible=False))
    save_project(tmp_path / "a.fruitninja", Project(session.documents, session.viewing))
    assert load_project(tmp_path / "a.fruitninja").documents == session.documents
