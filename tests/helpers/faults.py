"""A failing disk: the k-th of all operations that write under a folder raises the system's error."""

from __future__ import annotations

import builtins
import errno
import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import safetensors.numpy

ERRORS = (errno.ENOSPC, errno.EIO, errno.EACCES)


class Faults:
    """Counts writes under a folder, and fails those that it is told to."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        self.folder = str(folder.resolve())
        self.done: list[tuple[str, str]] = []
        """Operation and file name of every write since the last `arm`."""
        self.fails: Callable[[str, str], bool] = lambda operation, name: False
        self.code = errno.ENOSPC
        self.real: dict[str, Any] = {"open": io.open}
        patch.setattr(io, "open", self._open)  # used by pathlib
        patch.setattr(builtins, "open", self._open)
        for name, place in (("open", 0), ("mkdir", 0), ("link", 1), ("replace", 1), ("rmdir", 0), ("chmod", 0)):
            patch.setattr(os, name, self._watched(name, getattr(os, name), place))
        patch.setattr(os, "fsync", self._watched("fsync", os.fsync, None))
        serialize = safetensors.numpy.serialize_file
        patch.setattr(safetensors.numpy, "serialize_file", self._watched("serialize", serialize, 1))

    def arm(self, fails: int | Callable[[str, str], bool] | None, code: int = errno.ENOSPC) -> None:
        """Makes the operation of this number fail, or all for which the predicate holds; None: none fails."""
        self.done.clear()
        self.code = code
        if fails is None:
            self.fails = lambda operation, name: False
        elif isinstance(fails, int):
            self.fails = lambda operation, name: len(self.done) == fails
        else:
            self.fails = fails

    def check(self, operation: str, path: str | os.PathLike[str] | None) -> None:
        """Counts an operation. Raises OSError if it is to fail."""
        if path is not None and not os.path.realpath(os.fspath(path)).startswith(self.folder):
            return
        name = "" if path is None else os.path.basename(os.fspath(path))
        self.done.append((operation, name))
        if self.fails(operation, name):
            raise OSError(self.code, os.strerror(self.code), None if path is None else str(path))

    def _watched(self, operation: str, function: Callable[..., Any], place: int | None) -> Callable[..., Any]:
        def watched(*args: Any, **more: Any) -> Any:
            if operation == "open" and not args[1] & os.O_CREAT:
                return function(*args, **more)
            try:
                self.check(operation, None if place is None else args[place])
            except OSError as error:
                if operation == "serialize":  # with the library's own message, and half of the file written
                    with self.real["open"](args[1], "wb") as half:
                        half.write(b"half")
                    raise safetensors.SafetensorError(f"Error while serializing: I/O error: {error.strerror}") from None
                raise
            return function(*args, **more)

        return watched

    def _open(self, file: Any, mode: str = "r", *args: Any, **more: Any) -> Any:
        if isinstance(file, int) or not set(mode) & set("wax+"):
            return self.real["open"](file, mode, *args, **more)
        try:
            self.check("write", file)
        except OSError:
            if "w" in mode:
                with self.real["open"](file, "wb") as half:
                    half.write(b"half")
            raise
        if "a" in mode:
            return _Appending(file, self)
        return self.real["open"](file, mode, *args, **more)


class _Appending(io.FileIO):
    """A file whose disk fills up in the middle of a line."""

    def __init__(self, path: Any, faults: Faults) -> None:
        super().__init__(path, "ab")
        self.faults = faults
        self.full: OSError | None = None

    def write(self, data: Any) -> int:
        if self.full:
            raise self.full
        try:
            self.faults.check("append", self.name)
        except OSError as error:
            self.full = error
            return super().write(data[: len(data) // 2])
        return super().write(data)
