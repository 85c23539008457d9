"""A kernel works wherever its file cannot be written or read."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core import caching

import engine  # noqa: F401 (makes numba forgiving)

KERNEL = """
from numba import njit

@njit(cache=True)
def twice(x):
    return 2 * x
"""


def kernel(path: Path) -> ModuleType:
    """The module, as a new start of the program has it."""
    path.write_text(KERNEL) if not path.exists() else None
    spec = importlib.util.spec_from_file_location("kernel", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def refuse(*_: Any, **__: Any) -> None:
    raise OSError(28, "No space left on device")


def test_no_room_for_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.IndexDataCacheFile, "_open_for_write", refuse)
    assert kernel(tmp_path / "a.py").twice(3) == 6
    assert not list(tmp_path.rglob("*.nb?"))


def test_no_folder_for_a_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.tempfile, "TemporaryFile", refuse)  # how numba tries a folder
    assert kernel(tmp_path / "a.py").twice(3) == 6
    assert not list(tmp_path.rglob("*.nb?"))


def test_half_a_kernel(tmp_path: Path) -> None:
    assert kernel(tmp_path / "a.py").twice(3) == 6
    kept = sorted(tmp_path.rglob("*.nb?"))
    assert len(kept) == 2
    for path in kept:
        whole = path.read_bytes()
        for half in (b"", whole[: len(whole) // 2]):
            path.write_bytes(half)
            assert kernel(tmp_path / "a.py").twice(3) == 6
        path.write_bytes(whole)
