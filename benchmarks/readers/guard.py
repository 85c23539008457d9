"""What opening a file must never do: start a process, use the network, write, load a library, or read other files.

Python announces all of it to an audit hook before it happens. Native code is not seen; `benchmarks.readers.corpus`
looks at what that leaves behind.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

__all__ = ["Forbidden", "guarded"]

STARTED = {"os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.startfile", "os.system", "pty.spawn",
           "subprocess.Popen", "webbrowser.open"}  # fmt: skip
NETWORK = {"socket.bind", "socket.connect", "socket.getaddrinfo", "socket.sendto", "urllib.Request"}
CHANGED = {"os.chmod", "os.chown", "os.link", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink",
           "os.truncate", "os.utime", "shutil.copyfile", "shutil.move", "shutil.rmtree"}  # fmt: skip
LOADED = {"ctypes.dlopen", "pickle.find_class"}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_TRUNC

PROGRAM = (
    *(str(Path(p).resolve()) + os.sep for p in (sys.prefix, sys.base_prefix, Path(__file__).parents[2])),
    *("/proc/", "/sys/", "/dev/", "/usr/", "/lib", "/etc/localtime", "/etc/mime.types", "/etc/ld"),
)
"""Where programs and the system keep their own files: late imports read from there."""


class Forbidden(BaseException):
    """Raised in place of the forbidden action. No `except Exception` of a reader swallows it."""


class _Watch:
    """One hook for the whole process, as hooks cannot be removed; it does nothing while nothing is guarded."""

    installed = False
    near: tuple[str, ...] | None = None
    """Folders that may be read; None if nothing is guarded."""
    seen: list[str]

    @classmethod
    def hook(cls, event: str, args: tuple[Any, ...]) -> None:
        near = cls.near
        if near is None:
            return
        if event in LOADED and _compiling():
            return
        if event in STARTED or event in NETWORK or event in LOADED:
            what = f"{event} {str(args[0] if args else '')[:100]}"
        elif event == "open" or event in CHANGED:
            if not args or not isinstance(args[0], str | bytes | os.PathLike):
                return  # an already open descriptor
            cls.near = None  # resolving a path triggers the hook again
            try:
                path = os.path.realpath(os.fsdecode(args[0]))
            except ValueError:  # a null character: the system refuses to open it, too
                return
            finally:
                cls.near = near
            writes = event != "open" or bool((args[2] or 0) & WRITING)
            if writes and (path == os.devnull or ("__pycache__" in path and path.startswith(PROGRAM))):
                return  # compiled modules and kernels
            if not writes and path.startswith((*PROGRAM, *near)):
                return
            what = f"{event} {path} to {'change' if writes else 'read'} it"
        else:
            return
        cls.seen.append(what)
        raise Forbidden(what)


def _compiling() -> bool:
    """Whether the call comes from numba, which keeps compiled kernels as pickles beside the program."""
    frame: FrameType | None = sys._getframe(2)
    while frame is not None:
        if f"{os.sep}numba{os.sep}" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False


@contextmanager
def guarded(*near: Path) -> Iterator[list[str]]:
    """Forbids the block to start, send, change or load anything, and to read outside these folders.

    Yields the list of attempts, in words; each attempt raises Forbidden as well.
    """
    if not _Watch.installed:
        sys.addaudithook(_Watch.hook)
        _Watch.installed = True
    before = _Watch.near, getattr(_Watch, "seen", [])
    _Watch.seen = []
    _Watch.near = tuple(os.path.realpath(folder) + os.sep for folder in near)
    try:
        yield _Watch.seen
    finally:
        _Watch.near, _Watch.seen = before
