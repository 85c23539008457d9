"""Starting Python processes of this program's own, so that nothing in the folder the user stands in is run.

A person runs `fruitninja` in the folder where a capture was downloaded to, and with a capture comes whatever else is in
its archive. `python -m` and the processes that multiprocessing starts look there first for what they import.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["HOME", "safe_imports", "start_python"]

HOME = Path(__file__).resolve().parents[1]
"""The folder that this program was imported from: what lies there is trusted as much as the program itself."""


def start_python(module: str, arguments: Sequence[str] = (), **options: Any) -> subprocess.Popen[bytes]:
    """Starts a module in a process of its own, in `HOME`. Paths among the arguments must be absolute.

    `options` are those of Popen. -P takes the current folder off the import path; working in `HOME` keeps it from what
    libraries look for in the current folder (settings, shared libraries).
    """
    return subprocess.Popen([sys.executable, "-P", "-m", module, *arguments], cwd=HOME, **options)


@contextmanager
def safe_imports() -> Iterator[None]:
    """Python processes that libraries start in this block (multiprocessing, Dask) import nothing from where we stand.

    They begin as `python -c`, which has the current folder first on its path, before the standard library.
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
