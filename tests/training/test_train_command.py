"""The main job from outside: results, the same bits after any interruption, and bad input in one line."""

from __future__ import annotations

import io
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from safetensors.numpy import load_file

import training.settings
from engine.io.load import load
from engine.io.trained import load_trained
from engine.render.cpu.kernel_field import KernelField
from tests.paths import SAMPLES, SLICE
from training import cli
from training.events import Reporter
from training.families import Family
from training.pipeline import run
from training.priors.inside_file import read_inside
from training.request import Interrupted, Request
from training.settings import Detail

SCENE = SAMPLES / "watermelon"
TINY = Detail(
    cells=20, tolerance=0.1, fine=28, voxels=32, label=48, surface=48, surface_views=6, iterations=9, skin_views=6,
    skin_steps=2, skin_size=48,
)  # fmt: skip
REQUEST = Request(
    SCENE / "watermelon.ply",
    (Family("parallel", 8, (SLICE,)),),
    detail="draft",
    up=(0.0, 0.0, 1.0),
    iterations=9,
)
SHEET_TILE, PICTURE, BODY = 48, 192, 32
"""Pixels along a tile of the contact sheet and along a photograph, and cells across the body: at full size these would
take longer than everything else in so small a run."""

# The command with draft made tiny, for tests that end it from outside.
SMALL_COMMAND = f"""
import sys
import engine.solid.solidify, training.contact_sheet, training.optimise.training_loop, training.settings, training.skin
import training.priors.exemplar.pictures
from training.settings import Detail
training.settings.DETAILS["draft"] = {TINY!r}
training.contact_sheet.TILE = {SHEET_TILE}
training.priors.exemplar.pictures.MAX_SIDE = {PICTURE}
engine.solid.solidify.BODY_CELLS = {BODY}
training.optimise.training_loop.CHECKPOINT_SECONDS = training.skin.CHECKPOINT_SECONDS = 0.0
training.optimise.training_loop.MIN_IMPROVEMENT = float("-inf")
from training.cli import main
main()
"""
ARGUMENTS = [
    str(SCENE / "watermelon.ply"),
    *("--exemplar", f"parallel={SLICE}", "--family", "parallel:8", "--detail", "draft", "--up", "z"),
    *("--iterations", "9"),
]


def make_tiny(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(training.settings.DETAILS, "draft", TINY)
    patch.setattr("training.contact_sheet.TILE", SHEET_TILE)
    patch.setattr("training.priors.exemplar.pictures.MAX_SIDE", PICTURE)
    patch.setattr("engine.solid.solidify.BODY_CELLS", BODY)
    # All iterations, however soon the loss settles.
    patch.setattr("training.optimise.training_loop.MIN_IMPROVEMENT", float("-inf"))


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    make_tiny(monkeypatch)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        make_tiny(patch)
        run(REQUEST, out, Reporter(), False, lambda: False)
    return out


def test_a_run_leaves_a_solid_a_sheet_and_a_report(whole):
    atoms, meta = load_trained(whole / "watermelon.ply")
    assert meta.up == (0.0, 0.0, 1.0)
    report = json.loads((whole / "report.json").read_text())
    assert len(atoms.surface) == report["surface_atoms"] > 0
    assert len(atoms.interior) == report["interior_atoms"] > 1000
    assert report["surface_psnr_db"] > 18
    assert {"train", "save", "cuts", "measure"} <= set(report["seconds"])
    assert len(load(whole / "watermelon.ply").gaussians) == len(atoms)
    assert np.asarray(Image.open(whole / "cuts.png")).std() > 10
    # The inside of a watermelon is red, the outside is not: an interior coloured like the skin would fail here.
    deep = np.linalg.norm(atoms.interior.means, axis=1) < 0.4
    red, green, _ = atoms.interior.rgb[deep].mean(0)
    assert red > 1.5 * green


def test_nothing_is_trained_where_the_inside_is_known(tmp_path):
    solid = run(replace(REQUEST, iterations=None), tmp_path, Reporter(), False, lambda: False)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["iterations"] == 0 and "nothing to train" in report["ended"]
    assert report["views"] == {"parallel": 8} and len(list((tmp_path / "previews").iterdir())) == 2
    assert len(load_file(tmp_path / "checkpoint/labels.safetensors")["labels"]) == 2  # no label that nothing shows
    atoms, _ = load_trained(solid)
    inside = read_inside(solid)
    assert inside is not None
    deep = atoms.interior.means[np.linalg.norm(atoms.interior.means, axis=1) < 0.6]
    rgb, _ = KernelField(atoms).at(deep, atoms.pitch)
    assert np.abs(rgb - inside.at(deep, atoms.pitch)).mean() < 0.03


def holds(said: io.StringIO, words: str) -> bool:
    return words in said.getvalue()


@pytest.mark.slow
def test_an_interrupted_run_ends_with_the_same_bits(whole, tmp_path):
    for reached in ('"stage": "labels"', '"stage": "views"', '"iteration": 2'):
        said = io.StringIO()
        with pytest.raises(Interrupted):
            run(REQUEST, tmp_path, Reporter(said), True, partial(holds, said, reached))
    assert (tmp_path / "checkpoint/training.safetensors").exists()
    run(REQUEST, tmp_path, Reporter(), True, lambda: False)
    assert (tmp_path / "watermelon.ply").read_bytes() == (whole / "watermelon.ply").read_bytes()


def start(out: Path, events: Path, *more: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", SMALL_COMMAND, *ARGUMENTS, "-o", str(out), "--events", str(events), *more],
        stderr=subprocess.PIPE,
    )


def wait_for(events: Path, text: str) -> None:
    for _ in range(2400):
        if events.exists() and text in events.read_text():
            return
        time.sleep(0.05)
    raise AssertionError(f"no {text} in {events}")


@pytest.mark.slow
def test_a_kill_breaks_nothing_and_a_signal_ends_cleanly(whole, tmp_path):
    out = tmp_path / "out"
    process = start(out, tmp_path / "1.jsonl")
    wait_for(tmp_path / "1.jsonl", '"iteration": 2')
    process.kill()
    process.communicate()
    process = start(out, tmp_path / "2.jsonl", "--resume")
    wait_for(tmp_path / "2.jsonl", '"stage": "views"')
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate()
    assert process.returncode == 143
    assert b"--resume" in said
    process = start(out, tmp_path / "3.jsonl", "--resume")
    process.communicate()
    assert process.returncode == 0
    assert (out / "watermelon.ply").read_bytes() == (whole / "watermelon.ply").read_bytes()
    assert not [path for path in out.rglob(".*") if path.is_file()]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (["missing.ply"], "missing.ply: no such file"),
        (["--detail", "extreme"], "draft, standard, high"),
        (["--prior", "oracle"], "choose exemplar"),
        (["--up", "w"], "give x, y, z"),
        (["--keep", "box:1,2,3"], "--keep box:1,2,3: give box:x0,y0,z0,x1,y1,z1"),
        (["--remove", "cone:1,2,3"], "--remove cone:1,2,3: give box"),
        (["--keep", "sphere:0,0,0,-1"], "the radius must be above 0"),
        (["--keep", "sphere:9,9,9,1"], "watermelon.ply: nothing is left of its"),
        (["--exemplar", "parallel=LICENSE"], "LICENSE"),
        (["--exemplar", "radial=README.md"], "add --family radial:30"),
    ],
)
def test_bad_input_gets_one_line_and_status_2(change, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(SCENE.parents[1])
    arguments = [*change, *ARGUMENTS[1:]] if change[0].endswith(".ply") else [*ARGUMENTS, *change]
    monkeypatch.setattr(sys, "argv", ["fruitninja-train", *arguments, "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    printed = capsys.readouterr().err.strip().splitlines()
    assert said in printed[-1]
    assert not any("Traceback" in line for line in printed)
    assert not (tmp_path / "out/watermelon.ply").exists()
