"""Throw and slice: the flight against its closed form, cuts in the air, and that nothing is kept unless asked for."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.autosave import Autosave
from app.model.camera_control import OrbitCamera, project_points
from app.model.document import Document
from app.model.film.throw import SECONDS, in_flight, sliced, thrown
from app.model.history import History
from app.model.knife import Stroke
from app.model.pieces import PointSample, pieces
from app.model.project import Viewing, Work
from app.session.session import Session
from tests.helpers.solids import ball

EYE = OrbitCamera(distance=4.0)
CAMERA = EYE.camera(400, 300, (0.0, 0.0, 1.0))
SOLID = PointSample.of(np.random.default_rng(0).uniform(-0.5, 0.5, (3000, 3)))
ACROSS = Stroke((20.0, 150.0), (380.0, 150.0))


def test_it_rises_from_below_the_picture_and_falls_back_on_a_parabola() -> None:
    throw = thrown(Document(), SOLID, CAMERA, 4.0, 0.0)

    def middle(time: float) -> np.ndarray:
        (piece,) = pieces(in_flight(throw, time), SOLID)
        return piece.motion.apply(SOLID.points.mean(0))

    heights = [project_points(CAMERA, middle(t)[None])[0][0, 1] for t in np.linspace(0, SECONDS, 9)]
    assert heights[0] > 300 and np.isclose(heights[0], heights[8]) and 80 < heights[4] < 150
    assert all(a > b for a, b in pairwise(heights[:5]))
    step = SECONDS / 8
    places = np.array([middle(k * step) for k in range(9)])
    assert np.allclose(np.diff(places, 2, axis=0) / step**2, throw.fall, atol=1e-9)


def test_a_stroke_in_flight_parts_what_it_crosses_without_a_jump() -> None:
    throw = thrown(Document(), SOLID, CAMERA, 4.0, 0.0)
    now = SECONDS / 2 - 0.3
    cut = sliced(throw, SOLID, CAMERA, ACROSS, (0.0, 0.0, 1.0), now)
    assert len(cut.flights) == 2 and cut.cuts == 1 and not throw.document.cuts
    before, (low, high) = pieces(in_flight(throw, now), SOLID)[0], pieces(in_flight(cut, now), SOLID)
    for half in (low, high):
        assert np.allclose(half.motion.matrix, before.motion.matrix, atol=1e-9)

    def apart(time: float) -> float:
        one, other = (p.motion.apply(SOLID.points[p.rows].mean(0)) for p in pieces(in_flight(cut, time), SOLID))
        return float(np.linalg.norm(one - other))

    assert apart(now) < apart(now + 0.2) < apart(now + 0.6)
    assert sliced(cut, SOLID, CAMERA, Stroke((1.0, 1.0), (3.0, 9.0)), (0.0, 0.0, 1.0), now) is cut  # a miss


def test_the_game_changes_nothing_unless_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    document = Document(scene=Path("melon.ply"))
    session = Session(history=History(Work((document,))), viewing=Viewing(EYE), autosave=Autosave(tmp_path))
    atoms = ball(1 / 8)
    session.object = LoadedObject(SceneRequest(Path("melon.ply")), atoms=atoms, solid=PointSample.of_atoms(atoms))
    clock = 50.0
    session.throw.clock = lambda: clock
    for keep in (False, True):
        session.throw.begin(CAMERA)
        clock += SECONDS / 2
        session.throw.tick()
        session.slice(CAMERA, ACROSS)
        session.slice(CAMERA, Stroke((200.0, 5.0), (200.0, 295.0)))
        assert session.throw.pieces == len(session.members) == 4 and session.documents == (document,)
        if not keep:
            session.throw.stop()
            assert not session.previewing and len(session.history.entries) == 1 and len(session.pieces) == 1
    session.throw.keep()
    assert len(session.pieces) == 4 and len(session.history.entries) == 2 and not session.document.placements
    session.undo()
    session.throw.begin(CAMERA)
    session.slice(CAMERA, ACROSS)
    clock += SECONDS + 1
    session.throw.tick()  # it has fallen: whole again, and thrown anew
    assert session.throw.active and session.throw.pieces == 1
    session.change("Gap", document.with_cut(()))
    session.throw.tick()
    assert not session.throw.active
