"""Every write fails once, wherever it can: this gives one line, leaves the old file as it was, and nothing behind."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import app.jobs.scene_worker
from app import render_cli as cli
from app.jobs.export import save_animation, save_pieces, save_still
from app.model.document import Document
from app.model.pieces import PointSample, pieces
from app.model.project import save_project
from engine.command import REFUSED
from engine.errors import InputError
from engine.io.files import LineWriter
from engine.io.scratch import atomic_folder
from engine.io.trained import Meta, save_trained
from engine.scene.image import Picture
from tests.helpers.app_objects import atoms, full
from tests.helpers.faults import ERRORS, Faults
from tests.helpers.workers.batch_worker import SHORT, SMALL
from tests.paths import SAMPLES, SLICE
from training.batch.cli import Summary
from training.batch.grid import Outcome
from training.batch.task import Task
from training.checkpoint import Checkpoint
from training.evaluate.cuts import load_truth
from training.evaluate.grid import cells
from training.evaluate.measure import save_strip
from training.evaluate.report import write_report
from training.events import Reporter
from training.families import Family
from training.pipeline import run
from training.request import Request

SCENE = SAMPLES / "watermelon"
REQUEST = Request(
    SCENE / "watermelon.ply",
    (Family("parallel", 4, (SLICE,)),),
    detail="draft",
    up=(0.0, 0.0, 1.0),
    iterations=2,
)
RGBA = np.random.default_rng(0).integers(0, 255, (12, 16, 4), dtype=np.uint8)
FACTS = {"psnr_db": 20.0, "sharpness": 0.9, "seconds": 1.0, "peak_mb": 1.0}


@pytest.fixture
def faults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Faults:
    return Faults(tmp_path, monkeypatch)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def project(folder: Path) -> None:
    save_project(folder / "melon.fruitninja", full(folder.parent))


def exports(folder: Path) -> None:
    for suffix in ("png", "jpg", "webp"):
        save_still(folder / f"still.{suffix}", RGBA)
    save_animation(folder / "film.gif", iter([RGBA, RGBA[::-1]]))
    save_animation(folder / "film.webp", iter([RGBA, RGBA[::-1]]))
    solid = atoms()
    save_pieces(folder / "pieces.ply", [(solid, piece) for piece in pieces(Document(), PointSample.of_atoms(solid))])


def trained(folder: Path) -> None:
    save_trained(folder / "melon.ply", atoms(), Meta(seed=len(list(folder.iterdir()))))


def checkpoint(folder: Path) -> None:
    Checkpoint(folder, "run").save("labels", {"rgb": np.arange(6, dtype=np.float32)}, {"cells": 1})


def batch(folder: Path) -> None:
    task = Task("a", dict, {}, folder / "a/batch.json", "f", (folder / "a.ply",))
    task.save_facts({"warnings": []})
    Summary(folder / "batch.json", Path("all.toml")).write([Outcome(task, "done")])


def evaluation(folder: Path) -> None:
    shown = np.zeros((8, 8, 3), np.float32), np.zeros((8, 8), bool)
    solid: Any = SimpleNamespace(slice=lambda *_, **__: shown)
    cut: Any = SimpleNamespace(plane=None, camera=None)
    truth = load_truth(solid, [cut, cut], folder / "truth.safetensors")
    save_strip(folder / "results/bread/truth.png", truth.pictures)
    cell = cells(["bread"], ["ours"], [0], "draft", 6, None, folder)[0]
    Task("a", dict, {}, cell.result, cell.fingerprint).save_facts(FACTS)
    write_report([cell], {}, folder)


@pytest.mark.parametrize("write", [project, exports, trained, checkpoint, batch, evaluation])
def test_each_write_fails_once(
    write: Callable[[Path], None], tmp_path: Path, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.evaluate.report.render", lambda *_: "page \u00e9")
    folder = tmp_path / "out"
    folder.mkdir()
    write(folder)
    files = contents(folder)
    for number in range(1, 1000):
        code = ERRORS[number % len(ERRORS)]
        (folder / "truth.safetensors").unlink(missing_ok=True)  # made only if missing
        before = contents(folder)
        faults.arm(number, code)
        try:
            write(folder)
        except InputError as error:
            said = str(error)
            assert os.strerror(code) in said and said.startswith(str(folder)), said
            assert "/." not in said, f"names a temporary file: {said}"
            left = contents(folder)
            assert left.keys() - {"truth.safetensors"} == before.keys(), faults.done[-1]
            for name in before:
                assert left[name] == before[name] or name == "batch.json", (name, faults.done[-1])  # has the time
        else:
            if len(faults.done) < number:
                break  # there are no further writes
            failed = faults.done[number - 1]
            assert failed[0] in ("link", "mkdir"), failed  # the folder exists already; a failed link becomes a copy
            assert contents(folder).keys() == files.keys()
    assert number > 4
    faults.arm(None)
    write(folder)
    assert contents(folder).keys() == files.keys()


def test_a_pair_is_saved_together_or_not_at_all(tmp_path: Path, faults: Faults) -> None:
    for old in (False, True):
        folder = tmp_path / f"{old}"
        folder.mkdir()
        if old:
            save_trained(folder / "a.ply", atoms(), Meta(seed=1))
        before = contents(folder)
        for file in ("a.ply", "a.fruitninja.json"):

            def fails(operation: str, name: str, file: str = file) -> bool:
                return (operation, name) == ("replace", file)

            faults.arm(fails, errno.EIO)
            with pytest.raises(InputError, match=f"{file}: cannot be written"):
                save_trained(folder / "a.ply", atoms(), Meta(seed=2))
            faults.arm(None)
            assert contents(folder) == before


def test_a_picture_that_cannot_be_saved_leaves_the_last(
    tmp_path: Path, faults: Faults, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(tmp_path / "a.ply", atoms(), Meta())
    rgba = RGBA.astype(np.float32)
    shown = Picture(rgba[..., :3] / np.float32(255), rgba[..., 3], rgba[..., 3])
    monkeypatch.setattr(cli, "drawing", lambda *_: nullcontext((lambda *_: shown, "a test")))
    out = tmp_path / "out" / "a.png"
    out.parent.mkdir()
    Image.new("RGB", (3, 3)).save(out)
    before = out.read_bytes()
    monkeypatch.setattr(sys, "argv", ["fruitninja-render", str(tmp_path / "a.ply"), "-o", str(out)])
    for number in range(1, 100):
        faults.arm(number, ERRORS[number % 3])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr().err
        if ended.value.code == REFUSED:
            assert said.startswith(f"fruitninja-render: {out}: cannot be written") and said.count("\n") == 1
            assert contents(out.parent) == {"a.png": before}
        else:
            assert ended.value.code == 0 and not said
            if len(faults.done) < number:
                break
            assert faults.done[number - 1][0] == "mkdir"  # the folder exists already
            out.write_bytes(before)
    assert number > 4
    assert contents(out.parent).keys() == {"a.png"} and out.read_bytes() != before


def fill(out: Path) -> None:
    with atomic_folder(out) as temporary:
        (temporary / "unet").mkdir()
        (temporary / "unet/config.json").write_text("{}")


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path, faults: Faults) -> None:
    out = tmp_path / "models" / "new"
    for number in range(1, 100):
        faults.arm(number)
        try:
            fill(out)
        except InputError as error:
            message = str(error)
        else:
            break
        assert message.startswith((f"{out}: cannot be written", f"{out.parent}: cannot be written"))
        assert not list(tmp_path.glob("models/*"))
    assert number > 2 and contents(out) == {"unet/config.json": b"{}"}


# Files that grow.


def test_a_line_is_there_whole_or_not_at_all(tmp_path: Path, faults: Faults) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text('{"half')
    reporter = Reporter.open(str(path), quiet=True)
    reporter.emit("first")
    faults.arm(lambda operation, _: operation == "append")
    reporter = Reporter.open(str(path), quiet=True)
    with pytest.raises(InputError, match=f"{path}: cannot be written .No space left"):
        reporter.emit("second")
    faults.arm(None)
    Reporter.open(str(path), quiet=True).emit("third")
    half, *lines = path.read_text().splitlines()
    assert half == '{"half'
    assert [json.loads(line)["event"] for line in lines] == ["first", "third"]
    with pytest.raises(InputError, match="cannot be written here"):
        LineWriter(tmp_path)


def test_the_work_goes_on_when_nobody_follows_it() -> None:
    read, write = os.pipe()
    reporter = Reporter.open(f"/dev/fd/{write}" if Path("/dev/fd").is_dir() else pytest.skip("no names of pipes"))
    os.close(write)
    reporter.emit("heard")
    assert b"heard" in os.read(read, 100)
    os.close(read)
    reporter.emit("unheard")
    reporter.emit("unheard")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is full")
def test_a_full_device_is_said() -> None:
    reporter = Reporter.open("/dev/full")
    with pytest.raises(InputError, match="/dev/full: cannot be written"):
        reporter.emit("first")


# Whole runs.


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run of a second or two that leaves no step out."""
    for name, value in SMALL.items():
        monkeypatch.setattr(name, value)
    monkeypatch.setattr("training.request.DETAILS", {"draft": SHORT})
    monkeypatch.setattr("training.optimise.training_loop.CHECKPOINT_SECONDS", 1e9)
    monkeypatch.setattr("training.skin.CHECKPOINT_SECONDS", 1e9)


FAILING = (
    ("serialize", ".labels."),
    ("replace", "surface.safetensors"),
    ("write", ".parallel_"),
    ("open", ".training."),
    ("append", "events.jsonl"),
    ("replace", "watermelon.fruitninja.json"),
    ("fsync", ""),
    ("replace", "report.json"),
)
"""Stages of a run in order, and how the disk fails in each."""


@pytest.mark.slow
def test_a_run_goes_on_after_each_failure_with_the_same_bits(short: None, tmp_path: Path, faults: Faults) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    run(REQUEST, whole, Reporter(), False, lambda: False)
    out.mkdir()
    for count, (operation, start) in enumerate(FAILING):
        hit: list[str] = []

        def fails(o: str, name: str, operation: str = operation, start: str = start, hit: list[str] = hit) -> bool:
            if (o, bool(hit)) == (operation, False) and name.startswith(start):
                hit.append(name)
                return True
            return False

        before = contents(out)
        faults.arm(None)
        with Reporter.open(str(out / "events.jsonl")) as reporter:
            faults.arm(fails, ERRORS[count % len(ERRORS)])
            with pytest.raises(InputError) as caught:
                run(REQUEST, out, reporter, True, lambda: False)
        assert os.strerror(faults.code) in str(caught.value) and str(out) in str(caught.value), (operation, start)
        after = contents(out)
        assert not [name for name in after if Path(name).name.startswith(".")], after.keys()
        for name in before.keys() - {"events.jsonl"}:  # repeated work has the same bits
            assert after[name] == before[name] or name.endswith("training.safetensors"), name
        for line in after["events.jsonl"].splitlines():
            json.loads(line)
    faults.arm(None)
    run(REQUEST, out, Reporter(), True, lambda: False)
    for name in ("watermelon.ply", "watermelon.fruitninja.json", "cuts.png"):
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name


def test_the_window_is_told_that_the_temporary_folder_is_full(tmp_path: Path, faults: Faults) -> None:
    folder = tmp_path / "fruitninja-x"
    folder.mkdir()
    faults.arm(lambda operation, _: operation == "serialize")
    with pytest.raises(InputError, match=f"{tmp_path}: no room in the temporary folder .*No space left.*TMPDIR"):
        app.jobs.scene_worker._send_arrays(folder, "capture", {"means": np.zeros((2, 3), np.float32)}, {})
