"""`fruitninja-render`: from a file to a picture, and from bad input to one line."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app import render_cli as cli
from app.render_cli import main
from engine.io.trained import Meta, save_trained
from engine.render.gl import GLMissing
from engine.scene.plane import Plane
from fruitninja.drawing import default_angles
from tests.helpers.solids import Waves, ball


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "melon.ply"
    save_trained(path, ball(1 / 12, degree=0), Meta())
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["fruitninja-render", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


def test_pictures(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "cut.png"
    common = (trained, "-o", out, "--size", "160x90")
    assert run(monkeypatch, *common, "--plane", "0,0,1,0", "--camera", "20,60,1.1") == 0
    said = capsys.readouterr().out
    assert "cut.png (160x90, drawn by" in said
    cut = np.asarray(Image.open(out)).astype(int)
    assert cut.shape == (90, 160, 3)
    assert (cut[0, 0] == 255).all()
    assert cut[45, 80, 0] > 150 > cut[45, 80, 1]  # red flesh in the middle
    assert run(monkeypatch, *common, "--camera", "20,60,1.1") == 0
    whole = np.asarray(Image.open(out)).astype(int)
    assert whole[45, 80, 1] > whole[45, 80, 0]  # green skin
    assert run(monkeypatch, *common, "--plane", "0,0,1,0", "--plane", "-1,0,0,0") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["cut.png"]


def test_the_cpu_draws_the_same_where_there_is_no_egl(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    common = (trained, "--size", "160x90", "--plane", "0.2,0,1,0.05", "-o")
    assert run(monkeypatch, *common, tmp_path / "a.png") == 0
    first = capsys.readouterr().out

    def missing() -> None:
        raise GLMissing("no offscreen OpenGL")

    monkeypatch.setattr("fruitninja.drawing.Renderer", missing)
    assert run(monkeypatch, *common, tmp_path / "b.png") == 0
    assert "drawn by the CPU renderer: no offscreen OpenGL" in capsys.readouterr().out
    if "OpenGL:" not in first:
        pytest.skip(first)
    a, b = (np.asarray(Image.open(tmp_path / name)).astype(float) for name in ("a.png", "b.png"))
    assert 20 * np.log10(255 / np.sqrt(((a - b) ** 2).mean())) > 40


def test_faces_are_read_from_the_inside(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    common = (trained, "--size", "160x90", "--plane", "0.2,0,1,0.05", "-o")
    assert run(monkeypatch, *common, tmp_path / "a.png") == 0
    monkeypatch.setattr(cli, "read_inside", lambda path: Waves())
    assert run(monkeypatch, *common, tmp_path / "b.png") == 0
    a, b = (np.asarray(Image.open(tmp_path / name)).astype(int) for name in ("a.png", "b.png"))
    changed = np.abs(a - b).max(-1) > 20
    assert 0.05 < changed.mean() < 0.6 and changed[40, 80] and not changed[:, :20].any()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--plane", "1,2,3"), "--plane 1,2,3: give four numbers"),
        (("--plane", "0,0,0,1"), "not zero"),
        (("--plane", "0,0,nan,1"), "give four numbers"),
        (("--camera", "1,2"), "azimuth,elevation,distance"),
        (("--camera", "1,2,0"), "above 0"),
        (("--size", "10by10"), "WIDTHxHEIGHT"),
        (("--size", "0x10"), "WIDTHxHEIGHT"),
        (("--size", "100000x10"), "WIDTHxHEIGHT"),
    ],
)
def test_bad_arguments(
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, str],
    complaint: str,
) -> None:
    assert run(monkeypatch, trained, "-o", tmp_path / "x.png", *arguments) == 2
    said = capsys.readouterr().err
    assert complaint in said
    assert said.startswith("fruitninja-render: ")
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_bad_files(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments in (
        (tmp_path / "absent.ply", "-o", tmp_path / "x.png"),
        (trained, "-o", tmp_path / "x.jpg"),
        (trained, "-o", "/proc/nowhere/x.png"),
    ):
        assert run(monkeypatch, *arguments) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_the_default_view_sees_the_cut() -> None:
    for normal in ((0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0.2), (0.5, 0.5, -0.7)):
        plane, up = Plane.of(normal, 0), np.array([0.0, 0, 1])
        azimuth, elevation = np.radians(default_angles((plane,), up))
        towards = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        assert towards @ np.array(plane.normal) > 0.7
