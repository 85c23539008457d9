"""The guard over other people's files notices what it should."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from benchmarks.readers.guard import Forbidden, guarded
from benchmarks.readers.rules import words_wrong
from tests.paths import ROOT


def test_a_guarded_reader_can_do_nothing_but_read_what_is_near(tmp_path: Path) -> None:
    near, far = tmp_path / "near", tmp_path / "far"
    for folder in (near, far):
        folder.mkdir()
        (folder / "a.txt").write_text("x")
    (near / "link.txt").symlink_to(far / "a.txt")
    deeds = {
        "subprocess.Popen": lambda: subprocess.Popen(["true"]),
        "os.system": lambda: os.system("true"),
        "to change it": lambda: (near / "b.txt").write_text("x"),
        "os.remove": lambda: (near / "a.txt").unlink(),
        "os.mkdir": lambda: (near / "c").mkdir(),
        "to read it": lambda: (far / "a.txt").read_text(),
        f"{os.sep}far{os.sep}": lambda: (near / "link.txt").read_text(),
        "socket.connect": lambda: socket.socket().connect(("127.0.0.1", 9)),
    }
    for word, deed in deeds.items():
        with guarded(near) as tried, pytest.raises(Forbidden, match=word):
            deed()
        assert len(tried) == 1 and word in tried[0]
    with guarded(near) as tried:
        assert (near / "a.txt").read_text() == "x"
    assert not tried
    (near / "b.txt").write_text("x")  # no longer guarded


def test_words_for_programmers_are_told_from_words_for_people() -> None:
    assert not words_wrong("a.ply: not a .ply file")
    for words in (
        "",
        "two\nlines",
        "x" * 2000,
        "KeyError: 'x'",
        "Traceback (most",
        "b'abc'",
        "[Errno 2] no",
        "codec can't",
    ):
        assert words_wrong(words), words


@pytest.mark.slow
def test_a_folder_is_read_with_every_reader_and_told_of_without_its_place(tmp_path: Path) -> None:
    folder = tmp_path / "from somebody"
    folder.mkdir()
    with Image.open(ROOT / "sample_scenes/orange/horizontal_1.png") as picture:
        picture.resize((128, 128)).save(folder / "orange.png")
    (folder / "nothing.ply").write_text("ply is what this is called\n")
    out = tmp_path / "table.json"
    command = [sys.executable, "-m", "benchmarks.readers.corpus", str(folder), "-o", str(out), "--workers", "1"]
    subprocess.run(command, check=False, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=300)
    record = json.loads(out.read_text(encoding="utf-8"))
    assert record["folders"] == {"from somebody": 2}
    assert record["loaded"]["picture"] == ["from somebody/orange.png"]
    assert record["readers"]["scene"]["refused"] == 2
    assert not [failure for failure in record["failures"] if failure["file"] == "from somebody/nothing.ply"]
    assert str(tmp_path) not in out.read_text(encoding="utf-8")
    assert "| picture | 1 | 1 | 0 |" in out.with_suffix(".md").read_text(encoding="utf-8")
