"""Temporary folders that do not outlive their process for long: what a killed one left is removed by the next."""

from __future__ import annotations

import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from engine.errors import InputError
from engine.io.files import WRITING, reason

__all__ = ["Scratch", "atomic_folder"]

LOCK = ".scratch.lock"
"""In every such folder, and in no other. The owner holds it as long as it lives: the system lets go of it when the
process dies, however that comes."""

ATTEMPTS = 5
"""A folder may be swept in the instant between its making and its locking; never so often in a row."""


class Scratch:
    """A private folder until `close`. Making one removes those of the same prefix whose owners are dead."""

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        """`parent`: where it is made; the system's temporary folder unless given.

        Raises InputError where it cannot be made.
        """
        parent = parent or Path(tempfile.gettempdir())
        _sweep(prefix, parent)
        for _ in range(ATTEMPTS):
            try:
                self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
            except OSError as error:
                raise InputError(f"{parent}: cannot be written here ({reason(error)})") from error
            # Any thread may close it.
            self._lock = FileLock(self.path / LOCK, thread_local=False)
            with suppress(OSError):
                self._lock.acquire()
                if (self.path / LOCK).exists():
                    return
            self._lock.release()
        raise InputError(f"{parent}: cannot be written here (no folder stays in it)")

    def close(self) -> None:
        """Removes it and all that is in it; what cannot be removed is left to the next process."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.release()
        shutil.rmtree(self.path, ignore_errors=True)  # some systems keep the lock's file while it is held


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """As `engine.io.files.atomic`, for a folder that is new or empty: yields one beside it, to be filled."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
    with closing(Scratch(f".{path.name}.", path.parent)) as scratch:
        temporary = scratch.path / path.name
        try:
            temporary.mkdir()
            yield temporary
            for part in temporary.rglob("*"):
                if part.is_file():
                    with part.open("rb+") as file:
                        os.fsync(file.fileno())
            if path.is_dir():
                path.rmdir()  # empty; not every system replaces one
            temporary.replace(path)
        except WRITING as error:
            raise InputError(f"{path}: cannot be written ({reason(error)})") from error


def _sweep(prefix: str, parent: Path) -> None:
    """Removes folders of dead owners: real folders of this user, made by this class, that nobody holds."""
    for folder in _folders(prefix, parent):
        with suppress(OSError, Timeout), FileLock(folder / LOCK, timeout=0):
            shutil.rmtree(folder, ignore_errors=True)  # follows no link
        with suppress(OSError):
            folder.rmdir()


def _folders(prefix: str, parent: Path) -> list[Path]:
    found = []
    with suppress(OSError):
        for path in parent.iterdir():
            named = re.fullmatch(re.escape(prefix) + "[a-z0-9_]{8}", path.name)  # as mkdtemp names them
            if named and _ours(path) and _is_file(path / LOCK):
                found.append(path)
    return found


def _ours(path: Path) -> bool:
    """Whether it is a folder, not a link to one, of this user."""
    try:
        facts = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(facts.st_mode) and (not hasattr(os, "getuid") or facts.st_uid == os.getuid())


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False
