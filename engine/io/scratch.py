"""Temporary folders of a process; the next process removes those that a killed one left behind."""

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
from engine.io.files import WRITE_ERRORS, reason

__all__ = ["Scratch", "atomic_folder"]

LOCK = ".scratch.lock"
"""Lock file in every such folder, and in no other. The owner holds it while it lives; the system releases it when the
process dies, for whatever reason."""

ATTEMPTS = 5
"""Another process may remove a folder between its creation and its locking, but never so often in a row."""


class Scratch:
    """A private folder until `close`. Creating one removes those of the same prefix whose owners are dead."""

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        """`parent` is where it is created; by default the system's temporary folder.

        Raises InputError if it cannot be created.
        """
        parent = parent or Path(tempfile.gettempdir())
        _remove_stale(prefix, parent)
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
        """Removes the folder with its content; the next process removes what is left."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._lock.release()
        shutil.rmtree(self.path, ignore_errors=True)  # some systems keep a lock file while it is held


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Like `engine.io.files.atomic`, for a new or empty folder: yields a temporary folder to fill."""
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
                path.rmdir()  # empty; not every system replaces an existing folder
            temporary.replace(path)
        except WRITE_ERRORS as error:
            raise InputError(f"{path}: cannot be written ({reason(error)})") from error


def _remove_stale(prefix: str, parent: Path) -> None:
    """Removes unlocked folders of dead owners, if they are this user's and made by this class."""
    for folder in _folders(prefix, parent):
        with suppress(OSError, Timeout), FileLock(folder / LOCK, timeout=0):
            shutil.rmtree(folder, ignore_errors=True)  # does not follow links
        with suppress(OSError):
            folder.rmdir()


def _folders(prefix: str, parent: Path) -> list[Path]:
    found = []
    with suppress(OSError):
        for path in parent.iterdir():
            named = re.fullmatch(re.escape(prefix) + "[a-z0-9_]{8}", path.name)  # as mkdtemp names them
            if named and _is_own_folder(path) and _is_file(path / LOCK):
                found.append(path)
    return found


def _is_own_folder(path: Path) -> bool:
    """Whether the path is a folder of this user, not a link to one."""
    try:
        status = path.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and (not hasattr(os, "getuid") or status.st_uid == os.getuid())


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False
