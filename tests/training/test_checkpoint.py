"""Checkpoints: whole or absent, of this run or refused; and the event stream."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.io.files import atomic, locked_folder, remove_leftovers
from tests.paths import ROOT, SAMPLES
from training.checkpoint import Checkpoint
from training.events import Reporter
from training.pipeline import run
from training.request import Request


def test_round_trip_is_bit_exact(tmp_path):
    checkpoint = Checkpoint(tmp_path, "run")
    array = np.random.default_rng(0).standard_normal((7, 3)).astype(np.float32)
    checkpoint.save("training", {"rgb": array}, {"losses": [0.1, 1e-17]})
    loaded = checkpoint.load("training")
    assert loaded is not None
    arrays, facts = loaded
    assert (arrays["rgb"] == array).all()
    assert facts == {"losses": [0.1, 1e-17]}
    assert checkpoint.load("labels") is None


def test_another_run_or_a_broken_file_is_refused(tmp_path):
    Checkpoint(tmp_path, "run").save("training", {"rgb": np.zeros(3, np.float32)}, {})
    with pytest.raises(InputError, match="start again without --resume"):
        Checkpoint(tmp_path, "other").load("training")
    path = tmp_path / "training.safetensors"
    for content in (b"", path.read_bytes()[:-2], b"\xff" * 64):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a readable checkpoint"):
            Checkpoint(tmp_path, "run").load("training")


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def write():
        with atomic(path) as temporary:
            temporary.write_text("half")
            raise KeyError

    with pytest.raises(KeyError):
        write()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_writer_leaves_nothing_after_the_next_start(tmp_path: Path) -> None:
    """And hidden files of the user stay, in a folder that results are written to and below it."""
    names = ".settings.json", ".env.template", ".zshrc.20240131", ".bashrc.original", "deep/.notes.deadbeef.txt"
    mine = [tmp_path / name for name in names]
    (tmp_path / "deep").mkdir()
    for path in mine:
        path.touch()
    writer = atomic(tmp_path / "previews/radial_001.png")
    left = writer.__enter__()
    assert left.exists()
    remove_leftovers(tmp_path, tmp_path / "previews")
    assert not left.exists()
    assert all(path.exists() for path in mine)


def test_events_are_json_lines_whatever_the_numbers():
    stream = io.StringIO()
    reporter = Reporter(stream)
    with reporter.stage("train") as stage:
        stage.progress(0.5, losses={"section": float("nan")})
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [line["event"] for line in lines] == ["stage", "progress"]
    assert lines[1]["losses"]["section"] is None
    assert "train" in reporter.timings


@pytest.mark.parametrize("name", ["checkpoint", "previews"])
def test_a_link_in_a_result_folder_leads_nowhere(name: str, tmp_path: Path) -> None:
    """A result folder may be a stranger's: the target of a link in it is neither emptied nor written into."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "model.safetensors").write_bytes(b"precious")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "mine")
    scene = SAMPLES / "watermelon/watermelon.ply"
    with pytest.raises(InputError, match="remove this link"):
        run(Request(scene, ()), tmp_path / "out", Reporter(), False, lambda: False)
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["model.safetensors"]


def test_a_folder_is_written_by_one_run_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "new/out"
    ask = (
        "from pathlib import Path; from engine.io.files import locked_folder\n"
        f"with locked_folder(Path({str(out)!r})): pass"
    )

    def another() -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True, check=False, cwd=ROOT)

    with locked_folder(out):
        assert "another run is writing there" in another().stderr
    assert another().returncode == 0
    assert not list(out.iterdir())
    with pytest.raises(InputError, match="cannot be written here"), locked_folder(Path("/proc/none")):
        pass
