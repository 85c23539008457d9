"""Every file that is opened or written goes through here: read with suspicion, written whole or not at all."""

from __future__ import annotations

import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from filelock import FileLock, Timeout
from safetensors import SafetensorError

from engine.errors import InputError

__all__ = [
    "WRITING",
    "Lines",
    "atomic",
    "atomic_together",
    "claimed",
    "open_file",
    "read_file",
    "reason",
    "remove",
    "sweep",
]

LEFTOVER = re.compile(r"\..+\.[a-z0-9_]{8}(\.\w+)?|\.tmp[A-Za-z0-9]{6}")
"""Names that `atomic` gives its temporary files, with eight letters of chance, and safetensors its own."""

WRITING = (OSError, SafetensorError)
"""What writing fails with: the system's errors, which Pillow, numpy and plyfile pass on, and safetensors' own."""

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
    if isinstance(error, shutil.Error):  # of many files
        return str(error.args[0][0][2])
    return (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__


@contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yields a temporary path beside `path`; it takes the place of `path` when the block ends without an error.

    The content is on disk before the name changes, so a crash at any moment leaves the old file or the new one.
    Raises InputError where the folder cannot be written, and in place of any error of the system in the block (the
    disk is full): so the block should write this file and do nothing else. An InputError goes through as it is.
    """
    with atomic_together(path) as (temporary,):
        yield temporary


@contextmanager
def atomic_together(*paths: str | Path) -> Iterator[tuple[Path, ...]]:
    """As `atomic`, for files that are worth something only together: all are on disk before the first takes its place.

    Where one cannot take its place, those that had get back what was there.
    """
    wanted = [Path(path) for path in paths]
    with ExitStack() as cleared:
        made = [_temporary(path, cleared) for path in wanted]
        path = wanted[0]
        try:
            yield tuple(temporary for temporary, _ in made)
            for temporary, mode in made:
                temporary.chmod(mode)  # some libraries write another file over this one
                with temporary.open("rb+") as file:
                    os.fsync(file.fileno())
            with ExitStack() as undone:
                for path, (temporary, _) in zip(wanted, made, strict=True):
                    if path != wanted[-1]:
                        undone.callback(_put_back, path, _kept(path, cleared))
                    temporary.replace(path)
                undone.pop_all()
        except WRITING as error:
            raise InputError(f"{path}: cannot be written ({reason(error)})") from error


def _temporary(path: Path, cleared: ExitStack) -> tuple[Path, int]:
    """A new empty file beside `path`, which goes when `cleared` does, and the permissions of the user's new files."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = _beside(path)
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
    except (OSError, ValueError) as error:  # a ValueError for a name with a null character
        raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
    cleared.callback(_remove, temporary)
    mode = stat.S_IMODE(os.fstat(handle).st_mode)  # 0o666 less the umask, which cannot be asked for but by setting it
    os.close(handle)
    return temporary, mode


def _kept(path: Path, cleared: ExitStack) -> Path | None:
    """A second name of the file at `path`, which goes when `cleared` does; None where there is no file."""
    kept = _beside(path)
    cleared.callback(_remove, kept)
    try:
        os.link(path, kept)
    except FileNotFoundError:
        return None
    except OSError:  # not every system knows second names
        shutil.copy2(path, kept)
    return kept


def _put_back(path: Path, kept: Path | None) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True) if kept is None else kept.replace(path)


def _beside(path: Path) -> Path:
    """A name that nothing has, hidden, in the same folder."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)


class Lines:
    """A text file that grows by whole lines: what others follow while it is written.

    A line that does not get on the disk is taken back, and an InputError says so: whoever follows a file that stands
    still would wait for nothing, so the work ends there, and goes on from its checkpoint once there is room.
    """

    def __init__(self, path: str | Path) -> None:
        """Opens it, and ends a line of which a killed writer left a part. Raises InputError where that fails."""
        self.path = Path(path)
        try:
            self._file = self.path.open("ab", buffering=0)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be written here ({reason(error)})") from error
        self._is_file = stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)  # it may be a pipe to whoever follows
        if self._is_file and self._file.tell() and not self._ends_a_line():
            self.write("\n")

    def write(self, text: str) -> None:
        """Appends text that ends a line.

        Raises InputError where it cannot all be written, and then none of it is; BrokenPipeError where nobody is left
        at the other end of a pipe.
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
        """Ends writing."""
        with suppress(OSError):  # every line was written, or has been complained about
            self._file.close()

    def _ends_a_line(self) -> bool:
        with open_file(self.path) as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def remove(path: Path) -> None:
    """Removes a file, if it is there. Raises InputError where that is refused."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be removed ({reason(error)})") from error


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
            _remove(path)
