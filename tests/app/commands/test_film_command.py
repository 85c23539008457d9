"""`fruitninja-render --film`: from a solid to a film, in one run and in two."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from PIL import Image

from app import render_cli as cli
from app.jobs.film.film_job import FilmRequest, message_for
from app.jobs.film.film_worker import save
from app.jobs.scene_loader import LoadedObject, SceneRequest
from app.model.camera_control import OrbitCamera
from app.model.document import Document, Part
from app.model.film.timeline import FilmLook, SceneKeyframe, Timeline, exploding
from app.model.project import Project, Viewing, save_project
from engine.errors import InputError
from engine.io.picture_file import save_png
from engine.io.trained import Meta, load_trained, save_trained
from engine.scene.plane import Plane
from tests.app.commands.test_render_command import run
from tests.helpers.solids import Waves, ball


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "melon.ply"
    save_trained(path, ball(1 / 8, degree=0), Meta())
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_film_in_two_goes_has_the_same_bits(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cli, "read_inside", lambda path: Waves())
    common = ("--film", "sweep", "--plane", "0,0.2,1,0", "--size", "96x64", "--seconds", "1", "--fps", "6")
    assert run(monkeypatch, trained, "-o", tmp_path / "whole", *common) == 0
    assert "6 frames, 6 of them new" in capsys.readouterr().out
    whole = contents(tmp_path / "whole")
    assert sorted(whole) == ["film.json", *(f"frame_{k:05d}.png" for k in range(6))]
    assert len(set(whole.values())) >= 4  # the way back shows the same frames as the way there

    left = 2

    def stopping(path: Path, pixels: np.ndarray) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise InputError("stopped")
        save_png(path, pixels)

    with monkeypatch.context() as patched:
        patched.setattr("app.jobs.film.frame_folder.save_png", stopping)
        assert run(monkeypatch, trained, "-o", tmp_path / "two", *common) == 2
    assert len(contents(tmp_path / "two")) == 3
    (tmp_path / "two/frame_00000.png").unlink()
    capsys.readouterr()
    assert run(monkeypatch, trained, "-o", tmp_path / "two", *common) == 0
    assert "6 frames, 5 of them new" in capsys.readouterr().out
    assert contents(tmp_path / "two") == whole

    for other in (("--background", "black"), ("--camera", "0,0,1")):
        assert run(monkeypatch, trained, "-o", tmp_path / "two", *common, *other) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "the frames of another film" in said
    assert contents(tmp_path / "two") == whole
    (tmp_path / "two/film.json").unlink()
    assert run(monkeypatch, trained, "-o", tmp_path / "two", *common) == 2
    assert "frames without film.json" in capsys.readouterr().err


def test_films_and_backgrounds_open_again(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = ("--size", "64x48")
    keys = tmp_path / "keys.json"
    poses = [{"time": 0, "azimuth": 0, "elevation": 10}, {"time": 1, "azimuth": 40, "elevation": 30, "explosion": 1}]
    keys.write_text(json.dumps({"fruitninja_film": 1, "cuts": [[1, 0, 0, 0]], "keyframes": poses}))
    film = tmp_path / "a.webp"
    assert (
        run(monkeypatch, trained, "-o", film, "--film", keys, "--fps", "4", "--background", "transparent", *small) == 0
    )
    with Image.open(film) as image:
        assert (getattr(image, "n_frames", 1), image.size, image.mode) == (4, (64, 48), "RGBA")
        seen = []
        for number in range(4):
            image.seek(number)
            seen.append(np.asarray(image)[..., 3] > 127)
    assert not any(alpha[0, 0] for alpha in seen)
    assert np.ptp(np.flatnonzero(seen[3].any(0))) > np.ptp(np.flatnonzero(seen[0].any(0)))  # parted, it is wider
    for name, background, corner in (
        ("white", "white", (255, 255, 255)),
        ("grey", "#20262e", (32, 38, 46)),
        ("clear", "transparent", (0, 0, 0, 0)),
    ):
        picture = tmp_path / f"{name}.png"
        assert run(monkeypatch, trained, "-o", picture, "--background", background, *small) == 0
        with Image.open(picture) as image:
            assert image.getpixel((0, 0)) == corner


@pytest.mark.parametrize(
    ("out", "arguments", "complaint"),
    [
        ("a.gif", ("--film", "turntable", "--background", "transparent"), ".gif has no transparency"),
        ("a.avi", ("--film", "turntable"), "a film is saved as"),
        ("a.gif", ("--film", "explode"), "give the planes"),
        ("a.gif", ("--film", "dance"), "--film dance: give turntable"),
        ("a.gif", ("--film", "turntable", "--fps", "0"), "0 frames a second"),
        ("a.gif", ("--film", "turntable", "--seconds", "nan"), "--seconds nan"),
        ("a.gif", ("--film", "none.json"), "none.json: there is no such file"),
        ("a.gif", ("--film", "none.json", "--plane", "0,0,1,0"), "of their own"),
        ("a.png", ("--fps", "5"), "give --film too"),
        ("a.png", ("--background", "red"), "#rrggbb"),
    ],
)
def test_bad_options_are_one_line(
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    out: str,
    arguments: tuple[str, ...],
    complaint: str,
) -> None:
    assert run(monkeypatch, trained, "-o", tmp_path / out, *arguments) == 2
    said = capsys.readouterr().err
    assert complaint in said and said.count("\n") == 1 and not list(tmp_path.iterdir())


def test_the_film_of_a_project_is_that_of_the_window(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FRUITNINJA_HOME", str(tmp_path / "home"))
    document = Document(scene=trained).with_cut((Part(Plane.of((1, 0, 0), 0.0)),))
    film = exploding(SceneKeyframe.of(0.0, OrbitCamera(azimuth=-90.0, elevation=0.0), (document,)), 1.0)
    look = FilmLook((64, 48), 4.0, "black")
    path = trained.parent / "melon.fruitninja"
    save_project(path, Project((document,), Viewing(film=look), film))
    assert run(monkeypatch, path, "-o", tmp_path / "command") == 0
    assert "4 frames of 64x48" in capsys.readouterr().out
    atoms, meta = load_trained(trained)
    loaded = {0: LoadedObject(SceneRequest(trained), atoms=atoms)}
    project = Project((document,), Viewing(), film)
    request = FilmRequest(tmp_path / "window", project, look, (0.0, 0.0, 0.0), meta.up, True, loaded)
    save(message_for(request, tmp_path), Event())
    theirs, ours = contents(tmp_path / "window"), contents(tmp_path / "command")
    assert len(ours) == 5 and {k: v for k, v in ours.items() if k.endswith("png")}.items() <= theirs.items()

    def refused(project: Project, *options: str) -> str:
        save_project(path, project)
        assert run(monkeypatch, path, "-o", tmp_path / "no.gif", *options) == 2
        return " ".join(capsys.readouterr().err.split())

    assert "no film; keep two keyframes" in refused(Project((document,), Viewing(), Timeline()))
    assert "of its own; leave them out" in refused(project, "--plane", "0,0,1,0")
    hollow = Project((replace(document, scene=trained.parent / "other.ply"),), Viewing(), film)
    assert "none of its objects has an inside" in refused(hollow)
