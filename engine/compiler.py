"""Loads numba so that the current folder has no say in it.

numba takes its settings from a .numba_config.yaml in the current folder, when it is imported and again before each
function that it compiles. One of them is the folder of compiled functions, and what lies there is unpickled: it runs.
Settings from the environment (NUMBA_...) are the user's and stay.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

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
