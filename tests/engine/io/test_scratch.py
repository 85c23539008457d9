"""Temporary folders: gone when closed, swept after a killed owner, never somebody else's."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from engine.errors import InputError
from engine.io.scratch import LOCK, Scratch

OWNER = """
import sys, time
from pathlib import Path
from engine.io.scratch import Scratch
scratch = Scratch("fruitninja-", Path(sys.argv[1]))
(scratch.path / "capture.safetensors").write_bytes(bytes(1000))
print(scratch.path, flush=True)
time.sleep(60)
"""


def test_what_a_killed_process_left_is_swept_by_the_next_and_nothing_else(tmp_path: Path) -> None:
    command = [sys.executable, "-c", OWNER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        left = Path(owner.stdout.readline().strip())
        Scratch("fruitninja-", tmp_path).close()
        assert (left / "capture.safetensors").is_file()  # its owner is alive
        owner.kill()

    results = tmp_path / "results"
    results.mkdir()
    (results / "melon.ply").touch()
    (results / LOCK).touch()
    (tmp_path / "fruitninja-abcdefgh").symlink_to(results)
    others = [tmp_path / name for name in ("fruitninja-melon", "fruitninja-abcdefg_", "kiwi-abcdefgh")]
    for other in others:  # another name, no lock of ours (a result folder's has another name), another prefix
        other.mkdir()
        (other / ("x" if other == others[1] else LOCK)).touch()
    (others[1] / ".lock").touch()
    left.with_name("fruitninja-bcdefghi").mkdir()
    (left.with_name("fruitninja-bcdefghi") / LOCK).symlink_to(results / "melon.ply")

    with_link = left / "link"
    with_link.symlink_to(results)
    scratch = Scratch("fruitninja-", tmp_path)
    assert not left.exists() and scratch.path.is_dir()
    assert (results / "melon.ply").is_file() and all(len(list(other.iterdir())) for other in others)
    assert (tmp_path / "fruitninja-abcdefgh").is_symlink() and (tmp_path / "fruitninja-bcdefghi").is_dir()
    scratch.close()
    assert not scratch.path.exists()


def test_where_nothing_can_be_written_one_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written here"):
        Scratch("fruitninja-", tmp_path / "nowhere")
