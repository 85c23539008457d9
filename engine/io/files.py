"""Opens and writes every file of the program: checks what it reads, writes all of a file or none of it."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from safetensors import SafetensorError

from engine.errors import InputError

__all__ = [
    "WRITE_ERRORS",
    "ZIP_TIME",
    "LineWriter",
    "atomic",
    "atomic_together",
    "locked_folder",
    "open_file",
    "read_file",
    "reason",
    "remove",
    "remove_leftovers",
    "write_json",
]

MARK = "fruitninja-"
"""Part of the name of each temporary file: users have hidden files of their own, and none of these may be removed."""

LEFTOVER = re.compile(rf"\..+\.{MARK}[0-9a-f]{{8}}(\.\w+)?|\.tmp[A-Za-z0-9]{{6}}")
"""Names of temporary files: those of `atomic`, with eight random digits, and those of safetensors."""

WRITE_ERRORS = (OSError, SafetensorError)
"""Errors of writing: the system's, which Pillow, numpy and plyfile pass on, and those of safetensors."""

ZIP_TIME = (1980, 1, 1, 0, 0, 0)
"""Time stamp of every file in an archive, so that the same contents give the same bytes."""

PATIENCE = 5.0
"""Seconds to wait for a folder's lock: a killed process may hold it until its memory is freed."""


def open_file(path: str | Path) -> BufferedReader:
    """The file, open for reading bytes. Raises InputError if it is missing, not a regular file, or not readable."""
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise InputError(f"{path}: this is a folder; give the file in it")
        if not stat.S_ISREG(mode):  # reading a pipe or a device might block or never end
            raise InputError(f"{path}: this is not a regular file")
        return path.open("rb")
    except InputError:  # it is a ValueError
        raise
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no such file") from error
    except (OSError, ValueError) as error:  # a ValueError for a name with a null character
        raise InputError(f"{path}: cannot be opened ({reason(error)})") from error


def read_file(path: str | Path, limit: int) -> bytes:
    """The content of a file of at most `limit` bytes. Raises InputError as `open_file` does, or if it is larger."""
    with open_file(path) as file:
        try:
            # Memory is set aside for as much as is asked for, which must not be far more than there is.
            data = file.read(min(limit, os.fstat(file.fileno()).st_size) + 1)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({reason(error)})") from error
    if len(data) > limit:
        raise InputError(f"{path}: far too large for what it should be; the most is {limit >> 20} MB")
    return data


def reason(error: Exception) -> str:
    """Why an operation failed, in the words of the system or of the library that reports it."""
    if isinstance(error, shutil.Error):  # one error per file
        return str(error.args[0][0][2])
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`, which replaces `path` when the block ends without an error.

    The content is on disk before the name changes, so a crash at any moment leaves the old file or the new one.
    Raises InputError if the folder cannot be written, and in place of any system error in the block (disk full, say):
    the block should write this file and do nothing else. An InputError passes through.
    """
    with atomic_together(path) as (temporary,):
        yield temporary


@contextmanager
def atomic_together(*paths: str | Path) -> Iterator[tuple[Path, ...]]:
    """Like `atomic`, for files that belong together: all are on disk before the first is replaced.

    If one cannot be replaced, those already replaced get their old content back.
    """
    targets = [Path(path) for path in paths]
    with ExitStack() as cleanup:
        made = [_temporary(path, cleanup) for path in targets]
        path = targets[0]
        try:
            yield tuple(temporary for temporary, _ in made)
            for temporary, mode in made:
                temporary.chmod(mode)  # some libraries replace this file by another
                with temporary.open("rb+") as file:
                    os.fsync(file.fileno())
            with ExitStack() as rollback:
                for path, (temporary, _) in zip(targets, made, strict=True):
                    if path != targets[-1]:
                        rollback.callback(_restore, path, _backup(path, cleanup))
                    temporary.replace(path)
                rollback.pop_all()
        except WRITE_ERRORS as error:
            raise InputError(f"{path}: cannot be written ({reason(error)})") from error


def _temporary(path: Path, cleanup: ExitStack) -> tuple[Path, int]:
    """A new empty file beside `path`, which `cleanup` removes, and the permissions of the user's new files."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = _hidden_name(path)
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    except (OSError, ValueError) as error:  # a ValueError for a name with a null character
        raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
    cleanup.callback(_remove, temporary)
    mode = stat.S_IMODE(os.fstat(handle).st_mode)  # 0o666 without the umask, which can only be read by setting it
    os.close(handle)
    return temporary, mode


def _backup(path: Path, cleanup: ExitStack) -> Path | None:
    """A second name of the file at `path`, which `cleanup` removes; None if there is no file."""
    backup = _hidden_name(path)
    cleanup.callback(_remove, backup)
    try:
        os.link(path, backup)
    except FileNotFoundError:
        return None
    except OSError:  # not every file system has hard links
        shutil.copy2(path, backup)
    return backup


def _restore(path: Path, backup: Path | None) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True) if backup is None else backup.replace(path)


def _hidden_name(path: Path) -> Path:
    """An unused hidden name in the same folder."""
    return path.with_name(f".{path.stem}.{MARK}{secrets.token_hex(4)}{path.suffix}")


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


def write_json(path: str | Path, record: Any) -> None:
    """Replaces a JSON file as a whole. Raises InputError as `atomic` does, and ValueError if a number is not finite."""
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


class LineWriter:
    """Appends whole lines to a text file that other processes follow.

    A line that cannot be written completely is removed again, with an InputError: a follower would wait for nothing, so
    the work ends there, and resumes from its checkpoint once there is room.
    """

    def __init__(self, path: str | Path) -> None:
        """Opens the file and ends an incomplete line of a killed writer. Raises InputError if that fails."""
        self.path = Path(path)
        try:
            self._file = self.path.open("ab", buffering=0)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
        self._is_file = stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)  # it may be a pipe to the follower
        if self._is_file and self._file.tell() and not self._ends_a_line():
            self.write("\n")

    def write(self, text: str) -> None:
        """Appends text that ends with a line break.

        Raises InputError if not all of it can be written, and then writes none of it; BrokenPipeError if the
        reader of a pipe is gone.
        """
        data = text.encode("utf-8", "replace")
        before = os.fstat(self._file.fileno()).st_size
        written = 0
        try:
            while written < len(data):
                written += self._file.write(data[written:]) or 0
        except BrokenPipeError:
            raise
        except OSError as error:
            with suppress(OSError):
                if self._is_file:
                    self._file.truncate(before)
            raise InputError(f"{self.path}: cannot be written ({reason(error)})") from error

    def close(self) -> None:
        """Closes the file."""
        with suppress(OSError):  # every line was written or reported
            self._file.close()

    def _ends_a_line(self) -> bool:
        with open_file(self.path) as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def remove(path: Path) -> None:
    """Removes a file if it exists. Raises InputError if that fails."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be removed ({reason(error)})") from error


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Locks a folder, created if needed, against other processes until the block ends or this process dies.

    Raises InputError if another process holds the lock, or if the folder cannot be written.
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
        with suppress(OSError):  # some systems do not remove open files
            Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()


def remove_leftovers(*folders: Path) -> None:
    """Removes temporary files of killed writers in folders, not below them. No other process may be writing there."""
    for folder in folders:
        for path in folder.glob(".*"):
            if LEFTOVER.fullmatch(path.name) and path.is_file():
                _remove(path)
