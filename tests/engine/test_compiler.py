"""Kernels work where their cache file cannot be written or read."""

from __future__ import annotations

import gc
import importlib.util
import threading
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba import njit, types
from numba.core import caching, event
from numba.core.errors import TypingError

from engine import compiler

KERNEL = """
from numba import njit

@njit(cache=True)
def twice(x):
    return 2 * x
"""


def kernel(path: Path) -> ModuleType:
    """The module as a new start of the program loads it."""
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
    monkeypatch.setattr(caching.tempfile, "TemporaryFile", refuse)  # how numba probes a folder
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


def test_what_another_process_compiles_is_waited_for_and_loaded(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    assert kernel(tmp_path / "a.py").twice(3) == 6
    cached = {path: path.read_bytes() for path in tmp_path.rglob("*.nb?")}
    [path.unlink() for path in cached]
    again = kernel(tmp_path / "a.py")
    results: list[int] = []
    with (tmp_path / "a.py").open() as other:  # locks of two open files exclude each other, as two processes' do
        fcntl.flock(other, fcntl.LOCK_EX)
        waiting = threading.Thread(target=lambda: results.append(again.twice(3)))
        waiting.start()
        time.sleep(10 * compiler.LOOK)
        assert not results
        [path.write_bytes(data) for path, data in cached.items()]
    waiting.join()
    assert results == [6] and sum(again.twice.stats.cache_hits.values()) == 1


def test_a_halted_process_is_not_waited_for_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(compiler, "_locks", compiler._Locks())
    monkeypatch.setattr(compiler, "PATIENCE", 0.1)
    first, second = kernel(tmp_path / "a.py"), kernel(tmp_path / "b.py")
    with (tmp_path / "a.py").open() as a, (tmp_path / "b.py").open() as b:
        fcntl.flock(a, fcntl.LOCK_EX)
        fcntl.flock(b, fcntl.LOCK_EX)
        assert first.twice(3) == 6
        monkeypatch.setattr(compiler, "PATIENCE", 1e9)
        assert second.twice(3) == 6


def test_a_lock_is_given_back_if_a_kernel_cannot_be_compiled(tmp_path: Path) -> None:
    fcntl = pytest.importorskip("fcntl")
    with pytest.raises(TypingError):
        kernel(tmp_path / "a.py").twice(None)
    with (tmp_path / "a.py").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


@pytest.mark.parametrize("on", [True, False])
def test_the_collector_rests_while_a_kernel_is_compiled(on: bool) -> None:
    """Afterwards it is as before, even if the kernel cannot be compiled."""

    class Look(event.Listener):
        def __init__(self) -> None:
            self.seen: list[bool] = []

        def on_start(self, event: event.Event) -> None:
            self.seen.append(gc.isenabled())

        on_end = on_start

    def inner(x):
        return x + x

    inner = njit(inner)

    def outer(x):
        return inner(x) + 1

    look, before = Look(), gc.isenabled()
    gc.enable() if on else gc.disable()
    try:
        with event.install_listener("numba:llvm_lock", look):
            njit(outer).compile((types.int64,))
        assert look.seen and not any(look.seen)
        assert gc.isenabled() == on
        with pytest.raises(TypingError):
            njit(outer).compile((types.none,))
        assert gc.isenabled() == on
    finally:
        gc.enable() if before else gc.disable()
