"""Imports numba so that files in the current folder cannot configure it, and so that no kernel fails due to its cache.

numba reads settings from a .numba_config.yaml in the current folder, on import and again before each compilation. One
of them is the folder of compiled functions, which numba unpickles: that runs code. Settings from the environment
(NUMBA_...) are the user's and stay.

numba caches compiled kernels in files, and raises by default: when a kernel is defined, if neither the program's folder
nor the user's can be written; when it is first called, if the disk is full; and at every start, if a crash has left an
incomplete file. Here such a kernel is simply compiled again at each start.

What numba does beside compiling takes a good part of its time, and is left out where nothing here needs it.
"""

from __future__ import annotations

import gc
import os
import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

__all__: list[str] = []


@contextmanager
def _without_yaml() -> Iterator[None]:
    """Hides yaml from numba in this block, so that it reads no settings file; its warning about that is suppressed."""
    before = sys.modules.get("yaml")
    sys.modules["yaml"] = None  # type: ignore[assignment]  # makes importing it fail
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        del sys.modules["yaml"]
        if before is not None:
            sys.modules["yaml"] = before


with _without_yaml():
    import numba.core.config as config

config._config_fname = ""  # the name of the settings file
config.reload_config()  # drops settings from a file if numba was imported before

from llvmlite.binding import ffi  # type: ignore[import-untyped]  # noqa: E402 (after numba's settings)
from numba.core import caching, event  # noqa: E402
from numba.core.compiler import Flags  # noqa: E402
from numba.core.targetconfig import TargetConfig  # noqa: E402


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
    """Switches Python's garbage collector off while numba compiles, which makes many objects that stay: it looks
    through them, and through all that is imported, again and again, a sixth of the time of compiling.

    numba compiles one kernel at a time, and what that calls inside it.
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


# Less to do for each kernel; together a sixth of the time of compiling those of a training, which stay bit for bit.

ffi.lib._lock._cblist.clear()  # announced each of a quarter of a million calls into LLVM, to nobody
Flags.options["no_cfunc_wrapper"]._default = True  # a second way to call each kernel, from C


def _same_options(one: Any, other: object) -> bool:
    """Whether two compilations have the same options: numba makes a dictionary of all of them for each of hundreds of
    thousands of comparisons, where mostly none or the same are set."""
    if type(one) is not type(other):
        return NotImplemented
    mine, theirs = one._values, other._values  # type: ignore[attr-defined]
    return mine == theirs or all(getattr(one, name) == getattr(other, name) for name in mine.keys() | theirs.keys())


TargetConfig.__eq__ = _same_options  # type: ignore[method-assign]
TargetConfig.__hash__ = lambda options: hash(type(options))  # type: ignore[method-assign]  # it is that of their names
