"""Loads numba so that the current folder has no say in it, and so that no kernel fails because of its file.

numba takes its settings from a .numba_config.yaml in the current folder, when it is imported and again before each
function that it compiles. One of them is the folder of compiled functions, and what lies there is unpickled: it runs.
Settings from the environment (NUMBA_...) are the user's and stay.

It keeps compiled kernels in files, and of itself it raises: where a kernel is defined, if neither the program's folder
nor the user's own can be written; where one is first called, if the disk is full; and at every start, if a crash has
left half of a file there. Here such a kernel is compiled anew at each start, and that is all.
"""

from __future__ import annotations

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
    """In this block numba finds no yaml, so it reads no such file; it would warn where there is one."""
    kept = sys.modules.get("yaml")
    sys.modules["yaml"] = None  # type: ignore[assignment]  # so that importing it fails
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        del sys.modules["yaml"]
        if kept is not None:
            sys.modules["yaml"] = kept


with _without_yaml():
    import numba.core.config as config

config._config_fname = ""  # the file is looked for by this name
config.reload_config()  # where numba was imported before, what it took from a file ends here

from numba.core import caching  # noqa: E402 (after its settings)


class _Nowhere(caching._SourceFileBackedLocatorMixin, caching._CacheLocator):
    """The last place to look for a folder: one that cannot be, so that nothing is found there and nothing is kept."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        self._lineno = py_func.__code__.co_firstlineno

    def get_cache_path(self) -> str:
        return os.path.join(os.devnull, "kernels")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Nowhere:
        return cls(py_func, py_file)


@contextmanager
def _forgiven(_: caching.Cache) -> Iterator[None]:
    with suppress(OSError, EOFError, pickle.UnpicklingError):
        yield


# numba's own hook, which it fills on Windows only
caching.Cache._guard_against_spurious_io_errors = _forgiven  # type: ignore[method-assign, assignment]
caching.CacheImpl._locator_classes.append(_Nowhere)
