"""numba keeps compiled kernels in files; where it cannot, they are compiled anew at each start, and that is all.

Of itself it raises: where a kernel is defined, if neither the program's folder nor the user's own can be written; where
one is first called, if the disk is full; and at every start, if a crash has left half of a file there.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from numba.core import caching

__all__ = ["forgive"]


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


def forgive() -> None:
    """From now on no kernel fails because of its file. Called before the first one is defined."""
    # numba's own hook, which it fills on Windows only
    caching.Cache._guard_against_spurious_io_errors = _forgiven  # type: ignore[method-assign, assignment]
    if _Nowhere not in caching.CacheImpl._locator_classes:
        caching.CacheImpl._locator_classes.append(_Nowhere)
