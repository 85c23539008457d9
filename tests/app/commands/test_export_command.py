"""`fruitninja-export`: from a trained object to a file that other programs open, and from bad input to one line."""

from __future__ import annotations

import io
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.export_cli import main
from engine.export.kinds import KINDS
from engine.io.load import load
from engine.io.trained import Meta, load_trained, save_trained
from tests.helpers.solids import ball


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trained") / "melon.ply"
    save_trained(path, ball(1 / 8, degree=1), Meta(source="melon.splat"))
    return path


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["fruitninja-export", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("suffix", KINDS["splats"].suffixes)
def test_two_halves_are_the_whole(
    suffix: str, trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    counts = []
    for name, planes in (("a", ["0.3,0,1,0.04"]), ("b", ["-0.3,0,-1,-0.04"]), ("whole", [])):
        out = tmp_path / f"{name}{suffix}"
        assert run(monkeypatch, trained, "-o", out, *(part for p in planes for part in ("--plane", p))) == 0
        said = capsys.readouterr().out
        assert f"{name}{suffix} (" in said
        counts.append(int(said.split("(")[1].split()[0].replace(",", "")))
        if not suffix.startswith(".usd"):
            gaussians = load(out).gaussians
            assert len(gaussians) == counts[-1] and (gaussians.opacities > 0.99).all()
    assert counts[0] > 0 < counts[1] and counts[0] + counts[1] == counts[2] == len(load_trained(trained)[0])
    assert not np.any([path.name.startswith(".") for path in tmp_path.iterdir()])


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("a.glb", ["--as", "mesh", "--plane", "0,0,1,0", "--plane", "1,0,0,0", "--pieces"], "4 pieces, "),
        ("a.obj", ["--plane", "0,0,1,0"], "triangles, texture "),
        ("a.nrrd", ["--step", "0.1"], "a.labels.nrrd beside it; labels outside, inside"),
        ("a.npz", ["--metres", "0.1"], "particles, volume 0.0004"),
    ],
)
def test_other_kinds_say_what_they_hold(
    name: str,
    options: list[str],
    said: str,
    trained: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("manifold3d", reason="the export extra is not installed")
    assert run(monkeypatch, trained, "-o", tmp_path / name, *options) == 0
    assert said in capsys.readouterr().out and (tmp_path / name).stat().st_size > 100


def test_gaussians_in_metres_are_as_large_as_is_said(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes = []
    for metres in ("1", "0.04"):
        assert run(monkeypatch, trained, "-o", tmp_path / "a.glb", "--metres", metres) == 0
        found = load(tmp_path / "a.glb").gaussians
        sizes.append((np.ptp(found.means, axis=0).max(), np.median(found.scales)))
    assert sizes[1] == pytest.approx([0.04 * size for size in sizes[0]], rel=1e-5)


def test_a_stack_of_inks_shows_no_other_colour(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("zarr", reason="the export extra is not installed")
    out = tmp_path / "a.zip"
    assert run(monkeypatch, trained, "-o", out, "--step", "0.05", "--inks", "#ffffff, #231f20,#00AEEF") == 0
    with zipfile.ZipFile(out) as archive:
        layers = [archive.read(name) for name in archive.namelist() if name.endswith(".png")]
    rgba = np.stack([np.asarray(Image.open(io.BytesIO(layer))) for layer in layers])
    shown = np.unique(rgba[rgba[..., 3] > 0], axis=0).tolist()
    assert len(shown) > 1 and all(c in [[255, 255, 255, 255], [35, 31, 32, 255], [0, 174, 239, 255]] for c in shown)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["-o", "a.doc"], "a.doc: an object is saved as .ply"),
        (["-o", "a.ply", "--as", "soup"], "'soup': no kind of export; choose splats"),
        (["-o", "a.doc", "--as", "splats"], "a.doc: splats are saved as .ply"),
        (["-o", "a.ply", "--plane", "1,2,3"], "--plane 1,2,3: give four numbers a,b,c,d"),
        (["-o", "a.ply", "--plane", "1,0,0,9"], "a.ply: nothing to save"),
        (["-o", "a.npz", "--pieces"], "a.npz: only a mesh holds several pieces"),
        (["-o", "a.obj", "--step", "0"], "step 0: give a length above 0"),
        (["-o", "a.obj", "--metres", "nan"], "metres nan: give a length above 0"),
        (["-o", "a.nrrd", "--plane", "1,0,0,9"], "a.nrrd: nothing to save"),
        (["-o", "a.npz", "--step", "1e-6"], "a.npz: 1.1e+18 voxels are too many"),
        (["-o", "a.zip", "--inks", "#ffffff,red"], "--inks #ffffff,red: give colours as #rrggbb"),
        (["-o", "a.zip", "--inks", "#ffffff"], "1 inks: give 2 to 16"),
        (["-o", "a.nrrd", "--inks", "#ffffff,#000000"], "a.nrrd: only a stack for a printer is of inks"),
        (["-o", "melon.ply"], "melon.ply: this is the object itself"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    options: list[str],
    line: str,
    trained: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(trained.parent)
    before = {path.name: path.read_bytes() for path in trained.parent.iterdir()}
    assert run(monkeypatch, trained.name, *options) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"fruitninja-export: {line}") and said.count("\n") == 1
    assert {path.name: path.read_bytes() for path in trained.parent.iterdir()} == before
