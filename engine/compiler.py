"""Imports numba so that files in the current folder cannot configure it, and so that no kernel fails due to its cache.

numba reads settings from a .numba_config.yaml in the current folder, on import and again before each compilation. One
of them is the folder of compiled functions, which numba unpickles: that runs code. Settings from the environment
(NUMBA_...) are the user's and stay.

numba caches compiled kernels in files, and raises by default: when a kernel is defined, if neither the program's folder
nor the user's can be written; when it is first called, if the disk is full; and at every start, if a crash has left an
incomplete file. Here such a kernel is simply compiled again at each start.

Processes that start together need the same kernels at the same time: here one compiles and the others load the result.
"""

from __future__ import annotations

import gc
import os
import pickle
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None  # type: ignore[assignment]

__all__: list[str] = []

PATIENCE = 60.0
"""Seconds to wait for another process's kernels: several times what the longest takes. It may have been halted."""

LOOK = 0.02
"""Seconds between looks at a lock."""


@contextmanager
def _without(*names: str) -> Iterator[None]:
    """Hides modules from numba in this block; its warning about that is suppressed."""
    before = {name: sys.modules.get(name) for name in names}
    sys.modules.update(dict.fromkeys(names))  # type: ignore[arg-type]  # makes importing them fail
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for name, module in before.items():
            del sys.modules[name]
            if module is not None:
                sys.modules[name] = module


# Without yaml numba reads no settings file. With colorama it colours thousands of errors that nobody sees, each for a
# form of a function that does not fit: a twenty-fifth of the time of compiling.
with _without("yaml", "colorama"):
    import numba.core.config as config

config._config_fname = ""  # the name of the settings file
config.reload_config()  # drops settings from a file if numba was imported before

from numba.core import caching, dispatcher, event  # noqa: E402 (after its settings)
from numba.core.compiler_lock import global_compiler_lock  # noqa: E402


class _NoCache(caching._SourceFileBackedLocatorMixin, caching._CacheLocator):
    """The last cache locator: a folder that cannot exist, so that nothing is loaded from it or saved to it."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        self._lineno = py_func.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return os.path.join(os.devnull, "kernels")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _NoCache:
        return cls(py_func, py_file)


@contextmanager
def _ignore_cache_errors(_: caching.Cache) -> Iterator[None]:
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        yield


# numba's own hook, which it fills on Windows only
caching.Cache._guard_against_spurious_io_errors = _ignore_cache_errors  # type: ignore[method-assign, assignment]
caching.CacheImpl._locator_classes.append(_NoCache)


class _CollectorRests(event.Listener):
    """Switches Python's garbage collector off while numba compiles, which makes many objects that stay: it would search
    them, and all that is imported, again and again, for a sixth of the time of compiling.

    numba compiles one kernel at a time, and nested in it those that it calls.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.was_on = False

    def on_start(self, event: event.Event) -> None:
        if self.depth == 0:
            self.was_on = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        self.depth -= 1
        if self.depth == 0 and self.was_on:
            gc.enable()


event.register("numba:compile", _CollectorRests())


class _Locks:
    """Locks on source files, so that one process compiles a file's kernels and the others load them.

    A lock ends with the process that holds it, however that ends, and leaves no file behind. Used only by who holds
    numba's own lock; as kernels call each other in one direction only, no two processes wait for each other.
    """

    def __init__(self) -> None:
        self.held: set[str] = set()
        self.patient = fcntl is not None

    @contextmanager
    def on(self, path: str) -> Iterator[None]:
        """Holds the lock in this block. Goes on without it if there can be none, or after PATIENCE."""
        try:
            file = os.open(path, os.O_RDONLY) if self.patient and path not in self.held else None
        except OSError:
            file = None
        if file is None:
            yield
            return
        try:
            self._wait(file)
            self.held.add(path)
            yield
        finally:
            self.held.discard(path)
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_UN)  # closing is not enough if a child was forked meanwhile
            os.close(file)

    def _wait(self, file: int) -> None:
        deadline = time.monotonic() + PATIENCE
        with suppress(OSError):  # a file system without locks
            while self.patient:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    return
                except BlockingIOError:
                    self.patient = time.monotonic() < deadline
                    time.sleep(LOOK)


_locks = _Locks()
_compile = dispatcher.Dispatcher.compile


def _compile_once(kernel: Any, signature: Any) -> Any:
    """As numba's own; a kernel that is cached is compiled by one process at a time."""
    known = isinstance(signature, tuple) and signature in kernel.overloads
    if known or not isinstance(kernel._cache, caching.FunctionCache):
        return _compile(kernel, signature)
    with global_compiler_lock, _locks.on(kernel.py_func.__code__.co_filename):
        return _compile(kernel, signature)


dispatcher.Dispatcher.compile = _compile_once  # type: ignore[method-assign, assignment]
