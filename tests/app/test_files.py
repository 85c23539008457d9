"""Projects, autosaves, settings and dialogs, without a window."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.autosave import Autosave, find_unsaved_work
from app.model.document import Document, Part
from app.model.history import History
from app.model.pieces import PointSample
from app.model.project import FORMAT, Outside, Project, Viewing, Work, load_project, save_project
from app.model.settings import Settings, load_settings, save_settings
from app.session.project_files import _Opened
from app.session.recent_pictures import keep_picture, picture_of, remove_pictures
from app.session.session import Session
from app.ui.dialogs.file_dialogs import FileDialogs
from engine.errors import InputError
from engine.io.picture_file import read_pixels
from engine.scene.plane import Plane
from tests.helpers.app_objects import atoms, full


def test_a_project_comes_back_as_it_was(tmp_path: Path) -> None:
    project = full(tmp_path)
    save_project(tmp_path / "melon.fruitninja", project)
    assert load_project(tmp_path / "melon.fruitninja") == project
    assert str(tmp_path) not in (tmp_path / "melon.fruitninja").read_text()  # paths are relative
    moved = tmp_path / "elsewhere"
    moved.mkdir()
    (tmp_path / "melon.fruitninja").rename(moved / "melon.fruitninja")
    assert load_project(moved / "melon.fruitninja").documents[0].scene == moved / "scenes" / "melon.ply"


def test_a_project_does_not_reach_out_of_its_folder_unasked(tmp_path: Path) -> None:
    inside, path = tmp_path / "in", tmp_path / "in" / "p.fruitninja"
    inside.mkdir()
    project = Project((Document(scene=tmp_path / "secret.ply"),), Viewing())
    save_project(path, project)
    with pytest.raises(Outside, match="secret") as caught:
        load_project(path)
    assert caught.value.paths == (tmp_path / "secret.ply",)
    assert load_project(path, outside=True) == project
    (inside / "link").symlink_to(tmp_path)
    for name in ("/etc/passwd", "../../x.ply", "link/secret.ply", "a/../../b.ply"):
        raw = json.loads(path.read_text()) | {"scene": name}
        path.write_text(json.dumps(raw))
        with pytest.raises(Outside):
            load_project(path)


def test_a_path_outside_is_not_even_looked_at_before_the_user_allows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "in" / "p.fruitninja"
    save_project(path, Project((Document(scene=tmp_path / "server" / "share.ply"),), Viewing()))
    looked: list[str] = []
    resolve = Path.resolve
    monkeypatch.setattr(Path, "resolve", lambda self, strict=False: looked.append(str(self)) or resolve(self))
    with pytest.raises(Outside):
        load_project(path)
    assert not any("server" in name for name in looked)  # on Windows \\\\server would be sent a password


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes among its files")
def test_a_pipe_that_is_called_a_project_does_not_hold_up_the_window(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "p.fruitninja")
    with pytest.raises(InputError, match="not a regular file"):
        load_project(tmp_path / "p.fruitninja")


def test_another_project_in_the_place_of_a_trusted_one_is_asked_about_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    path = tmp_path / "in" / "p.fruitninja"
    session = Session(autosave=Autosave(tmp_path))
    monkeypatch.setattr(session.scene, "load", lambda *_, **__: None)
    session.files.open_document(Document(scene=tmp_path / "melon.ply"), Viewing())
    session.files.save(path)
    session.files.open(path)
    assert session.question is None and not session.error and len(session.settings.trusted) == 1
    save_project(path, Project((Document(scene=tmp_path / "secret.ply"),), Viewing()))
    session.files.open(path)
    assert session.question is not None and "secret.ply" in session.question.text
    session.answer(session.question.choices[0])
    assert session.document.scene == tmp_path / "secret.ply"
    session.files.open(path)
    assert session.question is None and len(session.settings.trusted) == 1


def marks(record: dict[str, Any]) -> dict[str, Any]:
    """The first marks of a project's record."""
    entry: dict[str, Any] = record["objects"][0]["families"][0]["marks"][0]
    return entry


BREAK: dict[str, Callable[[dict], object]] = {
    "version": lambda r: r.update(fruitninja=FORMAT + 1),
    "no version": lambda r: r.pop("fruitninja"),
    "no cuts": lambda r: r["objects"][0].pop("cuts"),
    "cuts are text": lambda r: r["objects"][0].update(cuts="abc"),
    "twice": lambda r: r["objects"][0]["cuts"].append(r["objects"][0]["cuts"][0]),
    "normal": lambda r: r["objects"][0]["cuts"][0]["parts"][0].update(plane=[2, 0, 0, 0]),
    "big": lambda r: r["objects"][0]["cuts"][0].update(shift=1e300),
    "bool for a number": lambda r: r["objects"][0].update(gap=True),
    "kind": lambda r: r["objects"][0]["cuts"][0].update(kind="os.system"),
    "unknown cut": lambda r: r["objects"][0]["pieces"][0].update(key=[[99, 1]]),
    "side": lambda r: r["objects"][0]["pieces"][0].update(key=[[1, 2]]),
    "mark": lambda r: r["objects"][0]["pieces"][0].update(mark="cross"),
    "turn": lambda r: r["objects"][0]["pieces"][0].update(turn=[0, 0, 0, 0]),
    "family": lambda r: r["objects"][0]["families"][0].update(count=0),
    "outline": lambda r: marks(r).update(outline=[[0, 0], [1, 1]]),
    "place": lambda r: marks(r).update(core=[0.5, 1.5]),
    "line": lambda r: marks(r).update(line=[[0.5, 0.5], [0.5, 0.5]]),
    "marks": lambda r: marks(r).update(picture="other.png"),
    "range": lambda r: r["objects"][0]["families"][0].update(range=[0.5, 0.1]),
    "range of one": lambda r: r["objects"][0]["families"][0].update(range=[0.5]),
    "family twice": lambda r: r["objects"][0]["families"].append(r["objects"][0]["families"][0]),
    "picture": lambda r: r["objects"][0]["families"][0].update(exemplars=[3]),
    "nul in a text": lambda r: r["objects"][0]["training"].update(thing="a\0b"),
    "half a character": lambda r: r["objects"][0]["cuts"][0].update(name="\ud800"),
    "half a character in a path": lambda r: r.update(scene="\ud800"),
    "nul": lambda r: r.update(scene="a\0b"),
    "elevation": lambda r: r["view"].update(elevation=91),
    "distance": lambda r: r["view"].update(distance=0),
    "mode": lambda r: r["view"].update(mode="x-ray"),
    "size of splats": lambda r: r["view"]["splats"].update(size=0),
    "opacity of splats": lambda r: r["view"]["splats"].update(opacity=1.5),
    "unit": lambda r: r["view"].update(unit={"name": "mm", "length": 0}),
    "cross": lambda r: r["view"].update(cross=[0, 1]),
    "keyframes": lambda r: r["film"].reverse(),
    "keyframe's view": lambda r: r["film"][0].pop("view"),
    "keyframe's plane": lambda r: r["film"][0]["objects"][0]["planes"][0].update(plane=[0, 0, 0, 1]),
    "a keyframe's object twice": lambda r: r["film"][0].update(objects=2 * r["film"][0]["objects"]),
    "pixels": lambda r: r["view"]["film_look"].update(size=[1e9, 1]),
    "prior": lambda r: r["objects"][0]["training"].update(prior="magic"),
    "seed": lambda r: r["objects"][0]["training"].update(seed=-1),
    "view": lambda r: r.update(view=None),
    "no objects": lambda r: r.update(objects=[]),
    "an object that is none": lambda r: r["objects"].append(3),
    "number": lambda r: r["objects"][0].update(number=-1),
    "number twice": lambda r: r["objects"][1].update(number=1),
    "visible": lambda r: r["objects"][1].update(visible="no"),
}


@pytest.mark.parametrize("name", BREAK)
def test_a_broken_project_is_refused_in_one_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "p.fruitninja"
    save_project(path, full(tmp_path))
    raw = json.loads(path.read_text())
    BREAK[name](raw)
    path.write_text(json.dumps(raw))
    with pytest.raises(InputError) as caught:
        load_project(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"fruitninja": NaN}', "[" * 100_000, "\xff", '{"fruitninja": 1}']
)
def test_what_is_no_project_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "p.fruitninja"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="not a project"):
        load_project(path)
    with pytest.raises(InputError, match="no such file"):
        load_project(tmp_path / "none.fruitninja")


def test_unsaved_work_survives_a_crash(tmp_path: Path) -> None:
    project = full(tmp_path)
    autosave = Autosave(tmp_path)
    assert not autosave.update(project, changed=False, target=None, now=0)
    assert autosave.update(project, changed=True, target=tmp_path / "p.fruitninja", now=0)
    assert not autosave.update(replace(project, viewing=Viewing()), changed=True, target=None, now=1)  # not due yet
    assert find_unsaved_work(tmp_path) == []  # this session is alive
    note = autosave.file.with_suffix(".json")
    note.write_text(json.dumps(json.loads(note.read_text()) | {"started": 1.0}))  # another process has that id now
    found = find_unsaved_work(tmp_path)
    assert len(found) == 1 and found[0].load() == project and found[0].project == tmp_path / "p.fruitninja"
    # Taken over, it is kept until this session has written its own, even if that fails at first.
    session = Autosave(tmp_path)
    session.update(replace(project, viewing=Viewing()), changed=True, target=None, now=1)
    session.take_over(found[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.model.autosave.save_project", full_disk)
        with pytest.raises(InputError):
            session.update(project, changed=True, target=None, now=2)
    assert found[0].load() == project
    session.update(project, changed=True, target=None, now=20)
    assert load_project(session.file, outside=True) == project and not found[0].file.exists()
    session.clear()
    assert find_unsaved_work(tmp_path) == [] and not list(tmp_path.iterdir())


@pytest.mark.parametrize("gap", [5.0, float("nan")])
def test_what_could_not_be_opened_again_is_not_saved(tmp_path: Path, gap: float) -> None:
    project = full(tmp_path)
    save_project(tmp_path / "p.fruitninja", project)
    first, *others = project.documents
    wrong = replace(project, documents=(replace(first, gap=gap), *others))
    with pytest.raises(InputError, match="cannot be saved"):
        save_project(tmp_path / "p.fruitninja", wrong)
    assert load_project(tmp_path / "p.fruitninja", outside=True) == project


def full_disk(*_: object) -> None:
    raise InputError("no space left")


def test_files_are_replaced_only_if_the_user_agrees(tmp_path: Path) -> None:
    scene, other, new = tmp_path / "melon.ply", tmp_path / "old.ply", tmp_path / "new.ply"
    scene.touch()
    other.touch()
    session = Session(history=History(Work((Document(scene=scene),))))
    done: list[Path] = []
    session.files.write([new], False, lambda: done.append(new))
    session.files.write([other], True, lambda: done.append(other))
    assert done == [new, other] and session.question is None
    session.files.write([new, other], False, lambda: done.append(scene))
    assert session.question is not None and "old.ply" in session.question.text and done == [new, other]
    session.answer(session.question.choices[0])
    assert done == [new, other, scene]
    session.files.write([scene], True, lambda: done.append(scene))
    assert "melon.ply: is open here" in session.error and len(done) == 3


def test_what_the_user_does_not_save_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    session = Session(history=History(Work((Document(scene=tmp_path / "melon.ply"),))))
    monkeypatch.setattr(session.scene, "load", lambda *_, **__: None)
    session.object = LoadedObject(SceneRequest(tmp_path / "melon.ply"))
    session.change("Up", replace(session.document, up=(0.0, 1.0, 0.0)))
    session.tick()
    assert session.autosave.file.exists()
    session.files.close()
    assert session.question is not None
    session.answer(next(choice for choice in session.question.choices if choice.label == "Don't save"))
    session.autosave.next = 0.0  # as if closing the window took long
    session.tick()
    assert session.closing and not session.autosave.file.exists()


def test_settings_survive_and_a_broken_file_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "settings.json"
    settings = Settings("light", face_light=False, seen_hint=True).with_recent(tmp_path / "a").with_job(tmp_path / "b")
    save_settings(settings, path)
    assert load_settings(path) == settings
    for text in ("", "[]", '{"theme": 3, "recent": [1], "window": [1, 2, 3], "seen_hint": "x"}'):
        path.write_text(text)
        assert load_settings(path) == Settings()
    many = settings
    for index in range(20):
        many = many.with_recent(tmp_path / str(index % 12))
    assert len(many.recent) == 10 and many.recent[0] == str(tmp_path / "7")
    assert str(tmp_path / "7") not in many.without_recent(str(tmp_path / "7")).recent


def test_pictures_of_recent_files_tell_no_names_and_go_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    one, other = "/private/melon.ply", "/private/Melon.ply"
    for name, grey in ((one, 40), (other, 200)):
        keep_picture(name, np.full((90, 90, 3), grey, np.uint8))
    assert [int(read_pixels(picture_of(name)).mean()) for name in (one, other)] == [40, 200]
    written = [path.name for path in (tmp_path / "home").rglob("*") if path.is_file()]
    assert len(written) == 2 and not any("elon" in name for name in written)
    remove_pictures([other])
    assert not picture_of(one).exists() and picture_of(other).exists()
    (tmp_path / "home").rename(tmp_path / "away")
    (tmp_path / "home").write_text("a file where the folder should be")
    keep_picture(one, np.zeros((9, 9, 3), np.uint8))  # fails without a message
    remove_pictures([])


def test_dialogs_of_the_system_open_and_are_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[object] = [[], ["a.spz"], "", "b.JPG", "b v1.2", [], ["c.png", "d.png"]]
    asked: list[tuple[object, ...]] = []

    class Fake:
        def __init__(self, *words: object) -> None:
            asked.append(words)

        def ready(self, _: int) -> bool:
            return True

        def result(self) -> object:
            return answers.pop(0)

    for kind in ("open_file", "save_file", "select_folder"):
        monkeypatch.setattr(f"app.ui.dialogs.file_dialogs.pfd.{kind}", Fake)
    got: list[object] = []
    dialogs = FileDialogs(tmp_path)
    dialogs.native = True
    for _ in range(2):
        dialogs.open_scene(got.append)
        dialogs.show()
    assert got == [Path("a.spz")] and dialogs.dialog is None
    assert all(f"*{suffix}" in str(asked[0][2]) for suffix in (".ply", ".splat", ".spz", ".obj", ".fruitninja"))
    for _ in range(3):
        dialogs.save("Save", tmp_path / "x.png", ["PNG", "*.png"], [".png", ".jpg"], lambda *answer: got.append(answer))
        dialogs.show()
    for _ in range(2):
        dialogs.open_pictures(got.append)
        dialogs.show()
    assert got == [Path("a.spz"), (Path("b.JPG"), True), (Path("b v1.2.png"), False), (Path("c.png"), Path("d.png"))]


def test_what_cannot_be_read_leaves_what_is_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path))
    session, solid = Session(), atoms()
    document = Document(scene=tmp_path / "melon.ply")
    session.history = History(Work((document,)))
    session.object = LoadedObject(
        SceneRequest(tmp_path / "melon.ply"), None, solid, PointSample.of_atoms(solid), trained=True
    )
    session.change("Cut", document.with_cut((Part(Plane.of((0, 0, 1), 0.0)),)))
    shown, history, path = session.object, session.history, tmp_path / "melon.fruitninja"
    session.path = path

    def opened(name: str) -> None:
        session.files.open(tmp_path / name)
        if session.question is not None:  # whether to keep the cut
            session.answer(session.question.choices[1])
        end = time.monotonic() + 60
        while session.loader is not None or session.files._before is not None:
            session.tick()
            time.sleep(0.02)
            assert time.monotonic() < end

    (tmp_path / "words.ply").write_text("a text, and no capture")
    (tmp_path / "half.splat").write_bytes(b"\0" * 33)
    for name in ("words.ply", "half.splat"):
        opened(name)
        assert name in session.error
        assert session.history is history and session.history.changed and session.path == path
        assert session.object is shown and len(session.pieces) == 2 and session.document.scene == document.scene
        session.tick()
        assert session.loader is None  # nothing is loaded again
        session.error = ""
    save_project(tmp_path / "gone.fruitninja", Project((Document(scene=tmp_path / "gone.ply"),), Viewing()))
    opened("gone.fruitninja")
    assert "gone.ply" in session.error and session.object is shown and session.path == path

    # Of several objects, another one may be looked at when the first is read.
    session.files._before = _Opened(History(Work((Document(),))), session.viewing, None, 0, {})
    number = session.document.number
    session.loaded[number + 1] = session.loaded.pop(number)
    session.files.tick()
    assert session.history is history and session.path == path and session.object is None
    session.loaded[number] = session.loaded.pop(number + 1)

    # What was still being made solid is made solid again.
    session.object = replace(shown, atoms=None, trained=False)
    again: list[Path | None] = []
    monkeypatch.setattr(session.scene, "load", again.append)
    session.files._before = _Opened(history, session.viewing, path, 0, dict(session.loaded))
    session.loaded.clear()
    session.files.tick()
    assert again == [None] and session.object is not None and session.history is history
