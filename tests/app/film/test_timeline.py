"""The film of a project: what it shows at its keyframes and between them, its edits, and how the window plays it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from PIL import Image

from app.jobs.film.film_job import FilmRequest, message_for, too_large
from app.jobs.film.film_worker import save
from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.autosave import Autosave
from app.model.camera_control import OrbitCamera
from app.model.document import DEFAULT_GAP, Document, Part
from app.model.film.record import LONGEST, MOST_PLANES
from app.model.film.timeline import FilmLook, SceneKeyframe, Timeline, exploding, played, sweeping, turning
from app.model.history import History
from app.model.pieces import PointSample, sections
from app.model.project import Project, Viewing, Work
from app.session.session import Session
from engine.errors import InputError
from engine.scene.plane import Plane
from tests.helpers.solids import ball

BALL = PointSample.of(np.random.default_rng(0).uniform(-1, 1, (2000, 3)))
EYE = OrbitCamera((0.1, 0.2, -0.3), 170.0, 20.0, 3.0, 40.0)
HALVED = Document(number=3, scene=Path("melon.ply")).with_cut((Part(Plane.of((1, 0, 0), 0.0)),))
OPENED = HALVED.with_cut((Part(Plane.of((0, 0, 1), 0.25)),), "Plane", "section")


def test_a_film_passes_through_its_keyframes_by_the_short_way() -> None:
    away = replace(EYE, target=(0.5, 0.2, -0.3), azimuth=-170.0, distance=12.0)
    film = Timeline(
        (SceneKeyframe.of(0.0, EYE, (HALVED,)), SceneKeyframe.of(2.0, away, (replace(HALVED, explode=1.0),)))
    )
    at, closed = played(film, (HALVED,), {3: BALL})
    assert not closed
    for time, eye, explode in ((0.0, EYE, 0.0), (1.0, None, 0.5), (2.0, away, 1.0), (9.0, away, 1.0)):
        seen, (document,) = at(time)
        assert np.isclose(document.explode, explode) and np.isclose(document.gap, HALVED.gap)
        assert document.cuts == HALVED.cuts and document.placements == HALVED.placements
        if eye is not None:
            assert np.allclose(seen.target, eye.target) and np.isclose(seen.distance, eye.distance)
            assert np.isclose((seen.azimuth - eye.azimuth + 180) % 360, 180) and seen.fov == 40.0
    middle, _ = at(1.0)  # a smoothstep is halfway there; for a distance, in its logarithm
    assert (
        np.isclose(middle.azimuth % 360, 180) and np.isclose(middle.distance, 6.0) and np.isclose(middle.target[0], 0.3)
    )


def test_a_plane_comes_from_beside_the_object_and_a_flipped_one_leaves() -> None:
    flipped = HALVED.with_cut((Part(Plane.of((0, 0, -1), -0.25)),), "Plane", "section")
    film = Timeline(tuple(SceneKeyframe.of(2.0 * k, EYE, (d,)) for k, d in enumerate((HALVED, OPENED, flipped))))
    at, _ = played(film, (HALVED,), {3: BALL})

    def hidden(time: float) -> float:
        keep = np.ones(len(BALL.points), bool)
        for plane in sections(at(time)[1][0]):
            keep &= plane.distance(BALL.points) <= 0
        return 1 - float(keep.mean())

    upper = float((BALL.points[:, 2] > -0.25).mean())
    assert hidden(0.0) == 0 and 0 < hidden(1.0) < upper
    assert np.isclose(hidden(2.0), upper) and np.isclose(hidden(4.0), 1 - upper)


def test_presets_begin_and_end_as_it_is_shown_now() -> None:
    now = SceneKeyframe.of(0.0, EYE, (OPENED,))
    turned, swept, parted = (
        turning(now, 6.0),
        sweeping(now, 6.0, 3, 2, Plane.of((0, 0, 1), 0.25), BALL),
        exploding(now, 6.0),
    )
    for film in (turned, swept, parted):
        at, closed = played(film, (OPENED,), {3: BALL})
        assert closed and film.seconds == 6.0 and film.keyframes[0].time == 0.0
        assert np.isclose((at(0.0)[0].azimuth - at(6.0)[0].azimuth + 180) % 360, 180)
    at, _ = played(turned, (OPENED,), {3: BALL})
    assert np.allclose([(at(t)[0].azimuth - EYE.azimuth) % 360 for t in (1.5, 3.0, 4.5)], (90, 180, 270))
    at, _ = played(swept, (OPENED,), {3: BALL})
    places = [sections(at(t)[1][0])[0].offset for t in (0.0, 3.0, 6.0)]
    assert places[0] < -0.9 and places[1] > 0.9 and np.isclose(places[2], places[0])
    at, _ = played(parted, (OPENED,), {3: BALL})
    halfway = at(3.0)
    assert np.isclose(halfway[1][0].explode, 0.7) and np.isclose(halfway[1][0].gap, 0.7 * DEFAULT_GAP)
    assert at(0.0)[1][0].gap == 0 and halfway[0].distance > EYE.distance


def test_keyframes_are_moved_between_their_neighbours_and_replaced() -> None:
    film = Timeline(tuple(SceneKeyframe(float(t), EYE) for t in (0, 2, 4)))
    assert [m.time for m in film.moved(1, 9.0).keyframes] == [0.0, 3.9, 4.0]
    assert film.moved(0, -5.0).keyframes[0].time == 0.0 and film.moved(2, 7.5).seconds == 7.5
    other = SceneKeyframe(2.01, replace(EYE, azimuth=1.0))
    assert film.with_keyframe(other).keyframes == (film.keyframes[0], other, film.keyframes[2])
    assert film.at(2.02) == 1 and film.at(2.3) is None and film.without(1).keyframes == film.keyframes[::2]
    # One keyframe is a still; a film that does not begin at 0 shows its first keyframe until then.
    still, _ = played(Timeline(film.keyframes[:1]), (HALVED,), {3: BALL})
    assert still(0.0)[0] == still(5.0)[0]
    held, _ = played(
        Timeline((SceneKeyframe(1.0, EYE), SceneKeyframe(2.0, replace(EYE, azimuth=0.0)))), (HALVED,), {3: BALL}
    )
    assert held(0.0)[0] == held(0.9)[0] != held(1.5)[0]


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    made = Session(history=History(Work((HALVED,))), viewing=Viewing(EYE, "capture"), autosave=Autosave(tmp_path))
    atoms = ball(1 / 8)
    made.object = LoadedObject(SceneRequest(Path("melon.ply")), atoms=atoms, solid=PointSample.of_atoms(atoms))
    return made


def test_the_window_keeps_what_is_shown_plays_it_and_leaves_it(session: Session) -> None:
    film, clock = session.film, 100.0
    film.clock = lambda: clock
    film.play()
    assert not film.playing and "two keyframes" in session.message
    film.add()
    session.viewing = replace(session.viewing, eye=replace(EYE, azimuth=200.0))
    session.change("Explode", replace(session.document, explode=1.0))
    film.add()  # two seconds after the last keyframe
    assert [one.time for one in session.timeline.keyframes] == [0.0, 2.0] and film.selected == 1
    untouched = session.documents

    # Between keyframes: drawn as in the film, not editable; one can look around in it and keep what is seen.
    film.seek(1.0)
    assert film.shown and session.mode == "solid" and np.isclose(session.viewing.eye.azimuth % 360, 185)
    assert np.isclose(session.drawn_documents[0].explode, 0.5) and session.documents is untouched
    apart = [piece.motion for piece in session.pieces]
    assert [m.piece.motion for m in session.members] != apart
    session.viewing = replace(session.viewing, eye=session.viewing.eye.turned(0, 100))
    film.add()
    assert np.isclose(session.timeline.keyframes[1].objects[0].explode, 0.5)
    assert session.timeline.keyframes[1].eye == session.viewing.eye and session.documents is untouched
    assert film.selected == 1
    session.undo()
    film.remove()  # the keyframe that was selected is gone
    assert len(session.timeline.keyframes) == 2 and film.shown and film.selected is None

    # Playing stops at the end; an edit of the object shows the object as it is.
    film.play()
    clock += 0.5
    film.tick()
    assert film.playing and np.isclose(film.time, 1.5)
    clock += 5.0
    film.tick()
    assert not film.playing and film.time == 2.0
    session.change("Gap", replace(session.document, gap=0.5))
    assert not film.shown and session.drawn_documents is session.documents
    film.tick()
    assert session.previewed is None

    # A turntable goes on after a full turn.
    film.preset("turntable")
    assert film.playing and len(session.timeline.keyframes) == 4
    clock += 7.0
    film.tick()
    assert film.playing and np.isclose(film.time, 1.0)
    film.leave()
    session.undo()
    assert len(session.timeline.keyframes) == 2
    film.selected = 0
    film.remove()
    assert len(session.timeline.keyframes) == 1 and not film.ready


def test_a_closed_film_of_which_undo_leaves_one_keyframe_stops(session: Session) -> None:
    film, clock = session.film, 100.0
    film.clock = lambda: clock
    film.add()
    film.add()  # of the same: the film is closed
    film.play()
    clock += 0.5
    film.tick()
    assert film.playing
    session.undo()
    clock += 0.5
    film.tick()
    assert not film.playing and film.time == 0.0


def test_a_film_is_saved_as_the_window_shows_it(session: Session, tmp_path: Path) -> None:
    project = Project(
        (HALVED,),
        Viewing(),
        exploding(SceneKeyframe.of(0.0, OrbitCamera(azimuth=-90.0, elevation=0.0), (HALVED,)), 1.0),
    )
    look, stop = FilmLook((64, 48), 4.0), Event()

    def saved(out: Path, ground: tuple[float, float, float] | None) -> int:
        request = FilmRequest(out, project, look, ground, (0.0, 0.0, 1.0), True, {3: session.loaded[3]})
        return save(message_for(request, tmp_path), stop)

    assert saved(tmp_path / "frames", None) == 4
    pictures = [np.asarray(Image.open(tmp_path / "frames" / f"frame_{k:05d}.png")) for k in range(4)]
    assert all(p.shape == (48, 64, 4) and p[0, 0, 3] == 0 for p in pictures)
    middle = [p[24, :, 3] > 127 for p in pictures]
    gaps = [int((~row[slice(*np.flatnonzero(row)[[0, -1]])]).sum()) for row in middle]
    assert gaps[0] == 0 < gaps[1] == gaps[3] < gaps[2]  # apart and together again
    first = (tmp_path / "frames" / "frame_00000.png").stat().st_mtime_ns
    saved(tmp_path / "frames", None)  # again: all frames are there
    assert (tmp_path / "frames" / "frame_00000.png").stat().st_mtime_ns == first
    stop.set()
    with pytest.raises(InputError, match="stopped"):
        saved(tmp_path / "stopped.gif", (0.0, 0.0, 1.0))
    assert not (tmp_path / "stopped.gif").exists()
    assert "too large" in too_large(Path("a.gif"), FilmLook((3840, 2160), 25.0), 60.0)
    assert not too_large(Path("a.mp4"), FilmLook((3840, 2160), 25.0), 60.0)


def test_no_keyframe_is_more_than_a_project_can_keep(session: Session) -> None:
    plane = (Part(Plane((0.0, 0.0, 1.0), 0.0)),)
    for _ in range(MOST_PLANES + 1):
        session.change("Section", session.document.with_cut(plane, "Section", "section"))
    session.film.add()
    assert not session.timeline.keyframes and "16 open sections" in session.message
    session.change("Less", replace(session.document, cuts=session.document.cuts[-MOST_PLANES:]))
    session.film.add()
    assert len(session.timeline.keyframes) == 1
    assert session.timeline.moved(0, 1e9).seconds == LONGEST


def test_parts_of_an_object_go_on_in_its_film() -> None:
    whole = exploding(SceneKeyframe.of(0.0, EYE, (HALVED,)), 2.0)
    film = whole.renumbered(HALVED.number, (7, 8))
    parts = tuple(replace(HALVED, number=number) for number in (7, 8))
    before, shown = played(whole, (HALVED,), {3: BALL})[0], played(film, parts, {7: BALL, 8: BALL})[0]
    for time in (0.0, 0.7, 1.0, 1.6):
        assert [one.explode for one in shown(time)[1]] == [before(time)[1][0].explode] * 2
    assert before(1.0)[1][0].explode > 0
    again = film.renumbered(7, (HALVED.number,))
    assert {opened.number for one in again.keyframes for opened in one.objects} == {HALVED.number, 8}
