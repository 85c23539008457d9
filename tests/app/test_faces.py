"""Faces in pictures as the window finds, corrects and places them, without opening a window."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from app.jobs.face_finder import FoundFace, find_face_in
from app.jobs.placement_preview import Placed, PlacementPreview, PlacementRequest
from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.jobs.training_job import request_for
from app.model.autosave import Autosave
from app.model.document import Document
from app.model.faces.edit import BrushStroke, drag_point, nearest_point, refine
from app.model.faces.words import describe_guess
from app.model.history import History
from app.model.pieces import PointSample
from app.model.project import Project, Viewing, Work, load_project, save_project
from app.model.settings import Settings
from app.session.session import Session
from app.ui.panels.thumbnails import Thumbnails
from engine.render.gl import Renderer
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from tests.helpers.exemplar_faces import RIND, disc, save
from tests.helpers.solids import unturned
from tests.paths import SHARED
from training.faces.marks import UNMARKED, Marks
from training.faces.polygon import mask_polygon, polygon_mask
from training.families import Family, Kind

CIRCLE = tuple((0.5 + 0.4 * np.cos(a), 0.5 + 0.4 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 48, endpoint=False))


def overlap(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def ball_of_atoms(count: int = 24) -> Atoms:
    """A ball of radius 1 of atoms on a lattice; the skin does not matter here."""
    pitch = 2 / count
    steps = np.arange(-1 + pitch / 2, 1, pitch)
    lattice = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    means = lattice[np.linalg.norm(lattice, axis=1) < 1].astype(np.float32)
    inside = InteriorAtoms(means, np.full(len(means), pitch, np.float32), np.full((len(means), 3), 0.5, np.float32))
    skin = SurfaceAtoms(
        np.eye(3, dtype=np.float32),
        np.full((3, 3), pitch, np.float32),
        unturned(3),
        np.zeros((3, 1, 3), np.float32),
    )
    return Atoms(skin, inside, pitch)


def session_with(folder: Path, kind: Kind, path: Path) -> Session:
    """A session whose object is the ball, with one picture."""
    session = Session(settings=Settings(), autosave=Autosave(folder / "kept"))
    document = Document(scene=folder / "ball.ply").with_exemplars(kind, (path,))
    session.history = History(Work((document,)))
    atoms = ball_of_atoms()
    session.loaded[0] = LoadedObject(
        SceneRequest(folder / "ball.ply"), atoms=atoms, solid=PointSample.of(atoms.interior.means), up=(0.0, 0.0, 1.0)
    )
    return session


def wait(session: Session, done: Callable[[], object]) -> None:
    end = time.monotonic() + 20
    while not done():
        assert time.monotonic() < end
        session.faces.tick()
        time.sleep(0.005)


def placed_again(session: Session, before: Placed | None) -> Placed:
    """Waits for the placement after `before`."""
    face = session.faces.open_face
    assert face is not None
    session.faces.tick()
    wait(session, lambda: not session.faces.busy and face.placed is not None and face.placed is not before)
    assert face.placed is not None
    return face.placed


@pytest.fixture
def melon(tmp_path: Path) -> Path:
    """A round face with a ring of seeds, on white."""
    return save(tmp_path / "melon.png", disc(160, seeds=7)[0])


def test_a_polygon_is_its_mask_and_back() -> None:
    y, x = np.mgrid[:150, :200] + 0.5
    for mask in (
        np.hypot(x - 100, y - 75) < 60,
        (abs(x - 90) < 70) & (abs(y - 80) < 41),
        np.hypot(x - 100, y - 75) < 120,
    ):
        outline = mask_polygon(mask)
        assert outline is not None and len(outline) < 80
        assert overlap(polygon_mask(outline, 150, 200), mask) > 0.985
    square = polygon_mask(((0.1, 0.2), (0.4, 0.2), (0.4, 0.6), (0.1, 0.6)), 100, 100)
    rows, columns = np.nonzero(square)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (20, 59, 10, 39) and square.sum() == 1200
    assert mask_polygon(np.zeros((9, 9), bool)) is None


def test_a_dragged_point_takes_its_neighbours_along_unless_it_goes_alone() -> None:
    index, away = nearest_point(CIRCLE, (0.95, 0.5), 2.0)
    assert index == 0 and abs(away - 0.1) < 1e-9
    to = (1.0, 0.5)
    moved, alone = (np.array(drag_point(CIRCLE, 0, to, 1.0, soft)) for soft in (True, False))
    steps = np.linalg.norm(moved - CIRCLE, axis=1)
    assert tuple(moved[0]) == to and 0.05 < steps[1] < 0.1 and steps[1] == pytest.approx(steps[-1]) and steps[2] > 0
    assert steps[5:-5].max() == 0 and np.array_equal(alone[1:], np.array(CIRCLE)[1:]) and tuple(alone[0]) == to
    assert np.array(drag_point(CIRCLE, 0, (7.0, -3.0), 1.0)).max() <= 1
    corners = ((0.1, 0.1), (0.9, 0.1), (0.9, 0.9), (0.1, 0.9))
    finer = refine(corners, 1.0)
    assert len(finer) >= 100 and set(corners) <= set(finer) and len(refine(finer, 1.0)) == len(finer)
    assert np.array_equal(polygon_mask(finer, 60, 60), polygon_mask(corners, 60, 60))


def test_the_brush_adds_and_takes_away_and_never_takes_all() -> None:
    y, x = (np.mgrid[:100, :100] + 0.5) / 100
    add = BrushStroke(CIRCLE, (100, 100), 0.1, add=True)
    for place in ((0.5, 0.9), (0.95, 0.9)):
        add.move(place)
    painted = (np.hypot(x - np.clip(x, 0.5, 0.95), y - 0.9) <= 0.1) | polygon_mask(CIRCLE, 100, 100)
    assert add.outline is not None and overlap(polygon_mask(add.outline, 100, 100), painted) > 0.98
    part = BrushStroke(CIRCLE, (100, 100), 0.1, add=False)
    for place in ((0.7, 0.0), (0.7, 1.0)):  # what the brush cuts off no longer belongs to the face
        part.move(place)
    assert part.outline is not None and max(place[0] for place in part.outline) < 0.62
    whole = BrushStroke(CIRCLE, (100, 100), 2.0, add=False)
    whole.move((0.5, 0.5))
    assert whole.outline == CIRCLE
    from_nothing = BrushStroke(None, (100, 100), 0.1, add=True)
    from_nothing.move((0.5, 0.5))
    assert from_nothing.outline is not None and len(from_nothing.outline) > 6


def test_what_is_found_is_said_in_plain_words(tmp_path: Path, melon: Path) -> None:
    face = find_face_in(melon)
    assert face.guess is not None and describe_guess(face.guess).startswith("looks like a cut across the core")
    assert face.marks.core == pytest.approx((0.5, 0.5), abs=0.01) and not face.problem
    gradient = np.linspace(0, 1, 200)[None, :, None] * np.ones((150, 1, 3))
    nothing = find_face_in(save(tmp_path / "gradient.png", gradient))
    assert nothing.guess is None and nothing.marks == UNMARKED and nothing.verdict == "no cut face was found"
    (tmp_path / "text.png").write_text("no picture")
    unread = find_face_in(tmp_path / "text.png")
    assert unread.problem and "\n" not in unread.problem and not unread.rgb.size


def test_a_face_is_found_once_for_its_content(tmp_path: Path, melon: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Path] = []

    def find(path: Path) -> FoundFace:
        seen.append(path)
        return find_face_in(path)

    monkeypatch.setattr("app.jobs.face_finder.find_face_in", find)
    session = session_with(tmp_path, "horizontal", melon)
    copy = tmp_path / "copy.png"
    copy.write_bytes(melon.read_bytes())
    wait(session, lambda: session.faces.finder.get(melon))
    wait(session, lambda: session.faces.finder.get(copy))
    assert session.faces.finder.get(copy) is session.faces.finder.get(melon) and seen == [melon]
    copy.with_name("copy.axis.json").write_text('{"core": [0.4, 0.6]}')
    wait(session, lambda: session.faces.finder.get(copy))
    found = session.faces.finder.get(copy)
    assert found is not None and found.marks.core == (0.4, 0.6) and len(seen) == 2
    # As in training, the .axis.json file holds for any outline.
    session.change("copy", session.document.moved_exemplar(melon, "horizontal", "radial"))
    session.add_pictures("horizontal", (copy,))
    session.change("outline", session.document.with_marks("horizontal", copy, Marks(CIRCLE)))
    session.faces.edit("horizontal", copy)
    session.faces.tick()
    face = session.faces.open_face
    assert face is not None and face.marks == Marks(CIRCLE, (0.4, 0.6), found.marks.line)


def test_corrections_are_undone_saved_and_reach_the_request(tmp_path: Path, melon: Path) -> None:
    session = session_with(tmp_path, "horizontal", melon)
    session.faces.edit("horizontal", melon)
    face = session.faces.open_face
    assert face is not None
    wait(session, lambda: session.faces.finder.get(melon))
    session.faces.tick()
    outline = face.marks.outline
    assert outline is not None
    for step in (0.02, 0.04):  # a single drag
        face.drag_point(outline, 3, (outline[3][0] + step, outline[3][1]), soft=True)
    face.settle()
    face.drag_core((0.55, 0.45))
    face.settle()
    face.paint((0.5, 0.95), 0.05, add=True)
    face.settle()
    assert len(session.history.entries) == 4 and face.given.core == (0.55, 0.45)
    session.undo()
    session.undo()
    assert face.given.core is None
    assert face.given.outline == drag_point(outline, 3, (outline[3][0] + 0.04, outline[3][1]), 1.0)
    session.redo()
    session.faces.close()
    given = session.document.families[0].marks_of(melon)
    assert given.core == (0.55, 0.45)
    session.change("same", replace(session.document, training=replace(session.document.training, same=True)))
    save_project(tmp_path / "p.fruitninja", Project(session.documents, Viewing()))
    kept = load_project(tmp_path / "p.fruitninja").documents[0]
    request = request_for(kept, (0.0, 0.0, 1.0))
    assert request.families[0].marks_of(melon) == given and request.same
    assert json.loads(request.to_json())["families"][0]["marks"][0]["core"] == [0.55, 0.45]
    # To another family and back: the corrections go along.
    moved = kept.moved_exemplar(melon, "horizontal", "radial")
    radial, horizontal = moved.family("radial"), moved.family("horizontal")
    assert radial is not None and radial.marks_of(melon) == given and horizontal is not None and not horizontal.marks
    assert not moved.without_exemplar("radial", melon).families[1].marks
    # To a family that has it already, with marks of its own: these stay.
    both = kept.with_exemplars("radial", (melon,)).with_marks("radial", melon, Marks(CIRCLE))
    radial = both.moved_exemplar(melon, "horizontal", "radial").family("radial")
    assert radial is not None and radial.exemplars == (melon,) and radial.marks_of(melon) == Marks(CIRCLE)
    session.faces.edit("horizontal", melon)
    face = session.faces.open_face
    assert face is not None
    face.find_again()
    assert session.document.families[0].marks == ()
    face.set_kind("radial")
    assert face.family is not None and face.family.kind == "radial"
    session.undo()
    session.faces.tick()
    assert face.kind == "horizontal"


def test_new_pictures_are_looked_at_and_the_doubtful_one_is_named(tmp_path: Path, melon: Path) -> None:
    session = session_with(tmp_path, "horizontal", melon)
    session.faces.tick()
    assert not session.faces.busy and session.faces.hint is None  # the picture came with the project
    gradient = save(tmp_path / "gradient.png", np.linspace(0, 1, 90)[None, :, None] * np.ones((80, 1, 3)))
    other = save(tmp_path / "other.png", disc(160, seeds=5)[0])
    session.add_pictures("horizontal", (other, gradient))
    assert "horizontal cut" not in session.message
    wait(session, lambda: session.faces.hint)
    hint = session.faces.hint
    assert hint is not None and hint.path == gradient and "no cut face was found. 1 more" in hint.text
    session.undo()
    session.faces.tick()
    assert session.faces.hint is None


def test_a_picture_follows_its_outline_and_axis_on_the_object(tmp_path: Path, melon: Path) -> None:
    session = session_with(tmp_path, "horizontal", melon)
    session.faces.edit("horizontal", melon)
    face = session.faces.open_face
    assert face is not None
    first = placed_again(session, None)
    assert first.plane is not None and first.rgba is not None
    assert np.allclose(first.plane.plane.normal, (0, 0, 1)) and np.abs(first.plane.centre).max() < 0.05
    # In the ball the disc appears undistorted: flesh in the middle, rind at nine tenths, nothing outside.
    rgba, half = first.rgba.astype(int), first.rgba.shape[0] / 2
    reach = half / 1.04
    shown = [rgba[int(half), int(half + part * reach)] for part in (0.3, 0.94)]
    assert shown[0][0] > 150 and abs(shown[1][:3] - 255 * RIND).max() < 60 and not rgba[5, 5, 3]
    # The face is moved off the core, as in `Disc`; the rind stays where it is.
    seeds = rgba[..., :3].sum(-1) < 150
    face.drag_core((0.5, 0.6))
    began = time.process_time()
    second = placed_again(session, first)
    assert time.process_time() - began < 1.5 and second.rgba is not None  # 0.15 s alone; other tests run beside it
    lower = second.rgba.astype(int)[..., :3].sum(-1) < 150
    inner = np.s_[40:-40, 40:-40]
    assert np.nonzero(lower[inner])[0].mean() < np.nonzero(seeds[inner])[0].mean() - 4
    # With a smaller outline there is no rind.
    face.find_again()
    outline = np.array(face.marks.outline)
    inside = tuple((float(x), float(y)) for x, y in 0.5 + 0.8 * (outline - 0.5))
    document = session.document.with_marks("horizontal", melon, Marks(inside))
    session.change("outline", document)
    third = placed_again(session, second)
    assert third.rgba is not None and third.rgba[int(half), int(half + 0.94 * reach), 0] > 150
    # A radial cut is upright and follows a turned core line.
    face.set_kind("radial")
    face.find_again()
    wait(
        session,
        lambda: face.placed is not None and face.placed.plane is not None and face.placed.plane.kind == "radial",
    )
    upright = placed_again(session, None)
    assert upright.plane is not None and abs(upright.plane.plane.normal[2]) < 1e-6
    face.drag_end(0, (0.8, 0.1))
    turned = placed_again(session, upright)
    assert turned.rgba is not None and upright.rgba is not None
    assert np.abs(turned.rgba.astype(int) - upright.rgba)[inner].mean() > 2


@pytest.mark.parametrize(("name", "is_turned"), [("pomegranate_v5", False), ("apple_v1", True)])
def test_a_radial_picture_alone_is_turned_unless_it_has_grains(name: str, is_turned: bool) -> None:
    """As training does: arils are laid whole by a quilt, though the picture is alone."""
    path = SHARED / f"photos/fruit/{name}.png"
    if not path.exists():
        pytest.skip("the shared photographs are not here")
    found = find_face_in(path)
    shown = []
    for alone in (True, False):
        preview, end = PlacementPreview(), time.monotonic() + 60
        family = Family("radial", 1)
        wanted = PlacementRequest(found.rgb, found.marks, family, ball_of_atoms(), (0.0, 0.0, 1.0), alone)
        while (placed := preview.update(wanted)) is None or preview.busy:
            assert time.monotonic() < end
            time.sleep(0.005)
        preview.close()
        assert placed.rgba is not None
        shown.append(placed.rgba)
    assert np.array_equal(shown[0], shown[1]) != is_turned


def test_of_many_wishes_the_preview_makes_the_last(melon: Path) -> None:
    found, preview = find_face_in(melon), PlacementPreview()
    wanted = PlacementRequest(found.rgb, found.marks, Family("horizontal", 1), ball_of_atoms(), (0.0, 0.0, 1.0))
    places = [(0.5, 0.3 + 0.02 * step) for step in range(20)]
    for place in places:
        preview.update(replace(wanted, marks=replace(found.marks, core=place)))  # never waits
    last = replace(wanted, marks=replace(found.marks, core=places[-1]))
    end = time.monotonic() + 20
    while preview.update(last) is None or preview.busy:
        assert time.monotonic() < end
        time.sleep(0.005)
    placed = preview.update(last)
    assert placed is not None and placed.marks.core == places[-1]
    assert preview.update(replace(last, rgb=found.rgb.copy())) is None  # a different picture
    preview.close()


def test_thumbnails_never_wait_and_stay_until_there_are_new_ones(renderer: Renderer, tmp_path: Path) -> None:
    thumbnails = Thumbnails(renderer.ctx)
    path, broken, gone = save(tmp_path / "face.png", disc(300)[0]), tmp_path / "broken.png", tmp_path / "gone.png"
    broken.write_bytes(b"no picture")

    def settled(file: Path) -> moderngl.Texture | None:
        until = time.monotonic() + 20
        while (texture := thumbnails.get(file)) is None and not thumbnails.is_none(file):
            assert time.monotonic() < until
            time.sleep(0.01)
        return texture

    assert settled(broken) is None and settled(gone) is None
    first = settled(path)
    assert first is not None and first.size == (192, 192)
    save(path, np.zeros((150, 300, 3), np.float32))
    os.utime(path, ns=(1, 1))
    until = time.monotonic() + 20
    while (second := thumbnails.get(path)) is first:
        assert time.monotonic() < until
        time.sleep(0.01)
    assert second is not None and second.size == (192, 96) and not any(second.read()[:3])
    thumbnails.release()
