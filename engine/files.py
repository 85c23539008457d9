"""Every file that is opened or written goes through here: read with suspicion, written whole or not at all."""

from __future__ import annotations

import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from filelock import FileLock, Timeout
from safetensors import SafetensorError

from engine.errors import InputError

__all__ = ["atomic", "claimed", "open_file", "read_file", "reason", "sweep"]

LEFTOVER = re.compile(r"\..+\.[a-z0-9_]{8}(\.\w+)?|\.tmp[A-Za-z0-9]{6}")
"""Names that `atomic` gives its temporary files, the eight letters being tempfile's, and safetensors its own."""

PATIENCE = 5.0
"""Seconds to wait for a folder: a process that was killed may hold it until its memory is gone."""


def open_file(path: str | Path) -> BinaryIO:
    """The file, open for reading bytes. Raises InputError for what is not there, no file, or not ours to read."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise InputError(f"{path}: this is a folder; give the file in it")
        if not stat.S_ISREG(mode):  # a pipe or a device would make us wait, or never end
            raise InputError(f"{path}: this is not a regular file")
        return path.open("rb")
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file") from error
    except (OSError, ValueError) as error:  # a ValueError for a name with a null character
        raise InputError(f"{path}: cannot be opened ({reason(error)})") from error


def read_file(path: str | Path, limit: int) -> bytes:
    """The content of a file of at most `limit` bytes. Raises InputError as `open_file`, and where it is larger."""
    with open_file(path) as file:
        try:
            data = file.read(limit + 1)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({reason(error)})") from error
    if len(data) > limit:
        raise InputError(f"{path}: far too large for what it should be; the most is {limit >> 20} MB")
    return data


def reason(error: Exception) -> str:
    """Why the system, or a library on its behalf, would not do it, in its own words."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`; it takes the place of `path` when the block ends without an error.

    The content is on disk before the name changes, so a crash at any moment leaves the old file or the new one.
    Raises InputError where the folder cannot be written, and in place of any error of the system in the block (the
    disk is full): so the block should write this file and do nothing else. An InputError goes through as it is.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
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
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from error
    finally:
        with suppress(OSError):
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
        raise InputError(f"{folder}: cannot be written here ({reason(error)})") from error
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
