"""What the viewport shows: coarse while it moves, full at rest, and what lies under a pixel in both cases."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from app.jobs.detail_reader import DetailReader
from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import OrbitCamera, project_points
from app.model.capture_view import view_of
from app.model.document import Part
from app.model.pieces import PointSample, pieces
from app.model.project import Viewing, ViewMode
from app.model.settings import Settings
from app.session.session import Session
from app.ui.dialogs.exporter import Exporter, Options
from app.ui.view.painter import STEPS, Painter
from engine.isolate.selection import Sphere, Step
from engine.render.face_detail import FaceDetail
from engine.render.gl import GLMissing
from engine.render.gl.classic import PORTION, UPLOAD
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from tests.helpers.solids import Waves, round_gaussians, unturned, waves

EYE = OrbitCamera(azimuth=30.0, elevation=20.0, distance=5.0)


def ball() -> Atoms:
    axis = np.arange(-1, 1, 0.1) + 0.05
    inside = np.stack(np.meshgrid(axis, axis, axis), 3).reshape(-1, 3)
    inside = inside[np.linalg.norm(inside, axis=1) < 0.95].astype(np.float32)
    n = len(inside)
    interior = InteriorAtoms(inside, np.full(n, 0.05, np.float32), np.full((n, 3), 0.5, np.float32))
    index = np.arange(3000) + 0.5
    z, turn = 1 - 2 * index / 3000, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - z * z)
    means = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], 1).astype(np.float32)
    surface = SurfaceAtoms(
        means, np.full((3000, 3), 0.05, np.float32), unturned(3000), np.zeros((3000, 1, 3), np.float32)
    )
    return Atoms(surface, interior, 0.1)


@pytest.fixture(scope="module")
def painter() -> Iterator[Painter]:
    try:
        made = Painter()
    except GLMissing as missing:
        pytest.skip(str(missing))
    yield made
    assert made.ctx.error == "GL_NO_ERROR"
    made.release()


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    atoms = ball()
    made = Session(settings=Settings(), viewing=Viewing(EYE, "solid"))
    made.object = LoadedObject(SceneRequest(tmp_path / "ball.ply"), None, atoms, PointSample.of_atoms(atoms))
    made.geometry_version = 1
    return made


@pytest.mark.parametrize("density", [1.0, 2.0])
@pytest.mark.parametrize("moving", [False, True])
def test_a_pixel_shows_the_point_that_is_picked_there(
    painter: Painter, session: Session, density: float, moving: bool
) -> None:
    """At any pixel density, and however coarse the frame is drawn."""
    camera = EYE.camera(round(160 * density), round(120 * density), session.up)
    shown = [drawn for piece in pieces(session.document, session.solid) for drawn in piece.drawn()]
    painter._step = 3  # as after slow frames
    texture = painter.frame(session, camera, shown, (0.0, 0.0, 0.0), moving=moving)
    assert texture is not None
    part, level = STEPS[3] if moving else STEPS[0]
    assert texture.size == (round(camera.width * part), round(camera.height * part))
    assert painter.unfinished == moving
    towards = camera.position / np.linalg.norm(camera.position)
    across = camera.viewmat[0, :3]
    # Picking meets an atom where its kernel is at half height. Each level halves the number of atoms and enlarges them
    # to cover the skin again; and a pixel may be off by half of its diagonal.
    height = math.sqrt(2 * math.log(2)) * 0.05 * 2 ** (level / 2)
    aside = math.sqrt(0.5) * EYE.distance / (camera.fx * part)
    for point in (towards, 0.8 * towards + 0.6 * across, 0.8 * towards - 0.6 * across):
        (pixel,), _ = project_points(camera, point[None])
        number, found = painter.pick(*pixel.tolist())
        assert number == 0 and found is not None and np.linalg.norm(found - point) < height + aside
    assert painter.pick(2 * density, 2 * density)[0] is None


def test_slow_moves_are_drawn_coarser_and_rest_is_drawn_in_full(
    painter: Painter, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = [drawn for piece in pieces(session.document, session.solid) for drawn in piece.drawn()]
    painter._step = 0
    monkeypatch.setattr("app.ui.view.painter.SLOW", 0.0)
    sizes = []
    for turn in range(6):
        camera = replace(EYE, azimuth=float(turn)).camera(160, 120, session.up)
        texture = painter.frame(session, camera, shown, (0.0, 0.0, 0.0), moving=True)
        assert texture is not None and painter.unfinished
        sizes.append(texture.size[0])
    assert sizes == [160, 120, 80, 80, 56, 32]
    texture = painter.frame(session, camera, shown, (0.0, 0.0, 0.0))
    assert texture is not None and texture.size == (160, 120) and not painter.unfinished
    monkeypatch.setattr("app.ui.view.painter.SLOW", 1e9)
    monkeypatch.setattr("app.ui.view.painter.QUICK", 1e9)
    for turn in range(6):
        camera = replace(EYE, azimuth=9.0 + turn).camera(160, 120, session.up)
        texture = painter.frame(session, camera, shown, (0.0, 0.0, 0.0), moving=True)
    assert texture is not None and texture.size == (160, 120)


def show_capture(session: Session, capture: Gaussians) -> None:
    assert session.object is not None
    session.object = replace(session.object, capture=capture)


def test_another_capture_takes_the_place_of_the_one_before(painter: Painter, session: Session) -> None:
    s = ball().surface
    session.viewing = Viewing(EYE, "capture")
    for opacity in (0.5, 0.9):
        capture = Gaussians(s.means, s.scales, s.quats, np.full(len(s), opacity, np.float32), s.sh)
        show_capture(session, capture)
        for _ in range(2):
            assert painter.frame(session, EYE.camera(64, 48, session.up), [], (0.0, 0.0, 0.0)) is not None


def test_a_capture_is_uploaded_and_drawn_in_slices(
    painter: Painter, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a graphics card a frame of a large capture takes seconds: events are handled meanwhile."""
    random = np.random.default_rng(0)
    n = 3 * UPLOAD
    capture = round_gaussians(random.normal(size=(n, 3)) * 0.3, 0.004, 0.5)
    capture = replace(capture, sh=random.normal(size=(n, 1, 3)).astype(np.float32))
    show_capture(session, capture)
    session.viewing = Viewing(EYE, "capture")
    camera = EYE.camera(128, 96, session.up)
    monkeypatch.setattr("app.ui.view.painter.SLICE", 1e-9)  # as little as possible per frame
    monkeypatch.setattr(painter, "_in_software", True)
    painter._capture = None
    frames, sizes_seen = 0, []
    while not frames or painter.unfinished:
        texture = painter.frame(session, camera, [], (0.0, 0.0, 0.0))
        sizes_seen.append(None if texture is None else texture.size[0])
        frames += 1
    assert sizes_seen[:2] == [None, None] and frames > n / PORTION
    assert set(sizes_seen[2:-1]) == {round(128 * STEPS[-1][0])} and sizes_seen[-1] == 128
    gradual = painter.renderer.read()
    painter.renderer.render(camera, [], "classic", (0.0, 0.0, 0.0))
    at_once = painter.renderer.read()
    assert np.array_equal(gradual.rgb, at_once.rgb) and gradual.rgb.max() > 0.1


def test_the_selected_is_tinted_in_the_window_but_not_in_a_saved_picture(painter: Painter, session: Session) -> None:
    s, red = ball().surface, (1.0, 0.0, 0.0)
    session.viewing = Viewing(EYE, "capture")
    capture = Gaussians(s.means, s.scales, s.quats, np.full(len(s), 0.9, np.float32), s.sh)
    show_capture(session, capture)
    camera = EYE.camera(64, 48, session.up)
    plain = painter.picture(session, camera, [])
    session.capture_view = view_of(capture, (), (Step("add", Sphere((0, 0, 0), 9.0)),), red)
    assert np.array_equal(painter.picture(session, camera, []), plain)
    texture = painter.frame(session, camera, [], (0.0, 0.0, 0.0))
    while painter.unfinished:
        texture = painter.frame(session, camera, [], (0.0, 0.0, 0.0))
    assert texture is not None
    frame = painter.renderer.read().rgb
    assert frame[24, 32, 0] > plain[24, 32, 0] / 255 + 0.2 and frame[24, 32, 1] < plain[24, 32, 1] / 255 - 0.1


def test_a_saved_picture_is_not_taken_for_what_is_shown(painter: Painter, session: Session) -> None:
    """Nor is the frame read that the picture has replaced: it is gone if the sizes differ."""
    camera = EYE.camera(64, 48, session.up)
    whole = [drawn for piece in pieces(session.document, session.solid) for drawn in piece.drawn()]
    painter.frame(session, camera, whole, (0.0, 0.0, 0.0))
    shown = painter.snapshot()
    assert shown is not None and shown.shape == (48, 64, 3)
    painter.picture(session, EYE.camera(32, 20, session.up), whole)
    assert painter.snapshot() is None
    painter.frame(session, camera, whole, (0.0, 0.0, 0.0))
    again = painter.snapshot()
    assert again is not None and np.array_equal(again, shown)


def test_a_cut_face_is_saved_as_the_solid_whatever_is_shown(painter: Painter, session: Session, tmp_path: Path) -> None:
    atoms = session.atoms
    assert atoms is not None and session.object is not None
    shell = round_gaussians(atoms.surface.means, 0.05)
    session.object = replace(session.object, capture=shell)
    session.change("Plane", session.document.with_cut((Part(Plane.of((0, 0, 1), 0.1)),)))
    saved = []
    modes: tuple[ViewMode, ...] = ("solid", "capture")
    for mode in modes:
        session.viewing = replace(session.viewing, mode=mode)
        Exporter(session, painter).run(Options(kind="section", width=100), tmp_path / f"{mode}.png")
        assert not session.error and session.viewing.mode == mode
        saved.append((tmp_path / f"{mode}.png").read_bytes())
    assert saved[0] == saved[1]


def test_a_camera_of_fewer_pixels_sees_the_same() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    for eye in (EYE, replace(EYE, orthographic=True)):
        camera = eye.camera(301, 203, (0.0, 0.0, 1.0))
        small = camera.scaled(0.35)
        assert (small.width, small.height) == (105, 71)
        before, after = project_points(camera, points)[0], project_points(small, points)[0]
        assert np.allclose(before / (301, 203), after / (105, 71))


def test_a_face_at_rest_is_read_from_the_inside(painter: Painter, session: Session) -> None:
    """Only partly between two frames; in motion, and without an inside, the face is drawn from atoms."""
    camera = EYE.camera(300, 200, session.up)
    half = [Piece((Plane.through((0, 0, 0), camera.position),))]

    def frame(moving: bool = False) -> np.ndarray:
        texture = painter.frame(session, camera, half, (0.0, 0.0, 0.0), moving=moving)
        assert texture is not None
        return np.frombuffer(texture.read(), np.float16).astype(float).reshape(texture.height, texture.width, 4)

    def settle() -> np.ndarray:
        shown, begin = frame(), time.monotonic()
        while painter.unfinished and time.monotonic() - begin < 30:  # the reader may have to wait for a core
            shown = frame()
        return shown

    plain = frame()
    assert not painter.unfinished and session.object is not None
    assert session.atoms is not None
    session.object = replace(session.object, inside=Waves())
    first = frame()
    assert painter.unfinished and np.array_equal(first, plain)
    sharp = settle()
    assert not painter.unfinished and np.array_equal(frame(), sharp)
    saved = painter.picture(session, camera, half)[..., :3] / 255
    changed = np.abs(sharp - plain).max(-1) > 0.1
    assert 0.05 < changed.mean() < 0.6 and changed[100, 150]
    assert np.abs(sharp[..., :3] - saved)[changed].max() < 0.01
    assert sharp[100, 150, 0] == pytest.approx(waves(np.zeros((1, 3)))[0, 0], abs=0.3)
    frame(moving=True)
    assert np.array_equal(frame(), plain)  # and the detail comes back later
    with_lines = painter.frame(session, camera, half, (0.0, 0.0, 0.0), [])
    assert with_lines is not None
    session.object = replace(session.object, inside=Broken())
    with pytest.raises(MemoryError):
        settle()
    assert np.array_equal(frame(), plain) and not painter.unfinished  # reported once
    session.object = replace(session.object, inside=None)
    assert np.array_equal(frame(), plain) and not painter.unfinished


class Broken(Waves):
    def at(self, points: np.ndarray, footprint: float) -> np.ndarray:
        raise MemoryError


class Steps:
    """A reading of faces in three steps that gives `number` everywhere; the first step waits for `go`."""

    def __init__(self, number: float, go: threading.Event, error: Exception | None = None) -> None:
        self.rgb, self.go, self.error, self.steps = np.full((1, 1, 3), number, np.float32), go, error, 0

    @property
    def ended(self) -> bool:
        return self.steps == 3

    def advance(self) -> None:
        assert self.go.wait(10)
        self.steps += 1
        if self.error is not None:
            raise self.error


def test_a_reading_of_faces_that_is_not_wanted_any_more_is_given_up() -> None:
    told, go = [], threading.Event()
    reader = DetailReader(lambda: told.append(1))
    first, second, third = Steps(1, go), Steps(2, go), Steps(3, go, OSError("no such picture"))
    reader.start(lambda: cast(FaceDetail, first))
    reader.start(lambda: cast(FaceDetail, second))
    assert reader.busy and reader.take(0.01) is None
    go.set()
    read = reader.take(10)
    assert read is not None and (read == 2).all() and not reader.busy
    assert first.steps <= 1 and second.steps == 3
    reader.start(lambda: cast(FaceDetail, third))
    with pytest.raises(OSError, match="no such picture"):
        reader.take(10)
    assert not reader.busy and len(told) >= 2  # the last is told a moment later
    reader.close()
