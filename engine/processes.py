"""Starts Python child processes that run no code from the current folder; the memory and the priority of this process.

Users run `fruitninja` in the folder of a downloaded capture, together with whatever else its archive contained.
`python -m` and the processes that multiprocessing starts would import from there first.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

__all__ = ["HOME", "peak_memory", "safe_imports", "start_python", "yield_to_others"]

HOME = Path(__file__).resolve().parents[1]
"""The folder of this program, which is trusted as much as the program itself."""


def start_python(module: str, arguments: Sequence[str] = (), **options: Any) -> subprocess.Popen[bytes]:
    """Starts a module in a new process that works in `HOME`. Paths among the arguments must be absolute.

    `options` are those of Popen. -P removes the current folder from the import path; working in `HOME` keeps libraries
    from finding settings or shared libraries in the user's folder.
    """
    return subprocess.Popen([sys.executable, "-P", "-m", module, *arguments], cwd=HOME, **options)


def yield_to_others() -> None:
    """Gives other processes precedence over this one, and over the threads that it starts from now on."""
    psutil.Process().nice(psutil.BELOW_NORMAL_PRIORITY_CLASS if sys.platform == "win32" else 10)


@contextmanager
def safe_imports() -> Iterator[None]:
    """Makes Python processes that libraries (multiprocessing, Dask) start in this block ignore the current folder.

    They start as `python -c`, which has the current folder first on its path, before the standard library.
    """
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


def peak_memory() -> int:
    """The most memory that this process has had so far, bytes."""
    if sys.platform == "win32":
        return int(psutil.Process().memory_info().peak_wset)
    import resource  # not on Windows; psutil has no peak anywhere else

    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else 1024 * most
