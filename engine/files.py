"""Files that are either the old one or the new one, never a part of either."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from engine.errors import InputError

__all__ = ["atomic", "claimed", "sweep"]

LEFTOVER = re.compile(r"\..+\.[a-z0-9_]{8}(\.\w+)?|\.tmp[A-Za-z0-9]{6}")
"""Names that `atomic` gives its temporary files, the eight letters being tempfile's, and safetensors its own."""

PATIENCE = 5.0
"""Seconds to wait for a folder: a process that was killed may hold it until its memory is gone."""


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`; it takes the place of `path` when the block ends without an error.

    The content is on disk before the name changes, so a crash at any moment leaves the old file or the new one.
    Raises InputError where the folder cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written here ({error.strerror})") from error
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes private files; these are the user's
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Until the block ends, or its process dies, nobody else gets into such a block with this folder; it is made if
    need be.

    Raises InputError where somebody is in one, or where the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder / ".lock", timeout=PATIENCE)
        lock.acquire()
    except Timeout as error:
        raise InputError(
            f"{folder}: another run is writing there; wait until it has ended, or give another folder"
        ) from error
    except OSError as error:
        raise InputError(f"{folder}: cannot be written here ({error.strerror})") from error
    try:
        yield
    finally:
        with suppress(OSError):  # some systems keep open files
            Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def sweep(folder: Path) -> None:
    """Removes temporary files that killed writers left in a folder and below. Nobody else may be writing there."""
    for path in folder.rglob(".*"):
        if LEFTOVER.fullmatch(path.name) and path.is_file():
            path.unlink(missing_ok=True)
