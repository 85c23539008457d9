"""Work that has not been saved, kept where a crash cannot reach it."""

from __future__ import annotations

import json
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from app.model.project import SUFFIX, Project, load_project, save_project
from app.model.settings import state_folder
from engine.errors import InputError
from engine.io.files import atomic, read_file, remove

__all__ = ["Autosave", "UnsavedWork", "find_unsaved_work"]

EVERY = 10.0
"""Seconds between two autosaves: what a crash may cost."""


@dataclass(frozen=True)
class UnsavedWork:
    """Unsaved work of a session that ended without saying goodbye."""

    file: Path
    project: Path | None
    """Where it was to be saved, if it ever was."""
    when: float
    """Seconds since 1970."""
    name: str = ""
    """Of the project, or of its scene."""

    def load(self) -> Project:
        """The work. Raises InputError where the file is broken."""
        return load_project(self.file, outside=True)  # the app wrote it itself

    def discard(self) -> None:
        """Forgets it."""
        _forget(self.file)


class Autosave:
    """One session's copy of unsaved work."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or state_folder() / "unsaved"
        self.file = self.folder / f"{os.getpid()}-{time.time_ns()}{SUFFIX}"
        self.last: Project | None = None
        self.next = 0.0

    def keep(self, project: Project, changed: bool, target: Path | None, now: float | None = None) -> bool:
        """Writes the work if it is due and differs from what was written; True where it did.

        Work without unsaved changes needs no copy: the old one goes. Raises InputError where the disk refuses.
        """
        now = time.monotonic() if now is None else now
        if not changed:
            self.clear()
            return False
        if now < self.next or project == self.last:
            return False
        self.next = now + EVERY
        save_project(self.file, project)
        named = target or project.document.scene
        note = {"project": None if target is None else str(target), "when": time.time(), **_me()}
        note["name"] = named.stem if named else ""
        text = json.dumps(note)
        with atomic(_note(self.file)) as temporary:
            temporary.write_text(text, encoding="utf-8")
        self.last = project
        return True

    def clear(self) -> None:
        """Nothing is unsaved."""
        if self.last is not None:
            _forget(self.file)
            self.last = None


NOTE_LIMIT = 1 << 16
"""Bytes of the largest note that is read; a real one has a few hundred."""


def find_unsaved_work(folder: Path | None = None) -> list[UnsavedWork]:
    """Unsaved work whose session no longer runs, the latest first."""
    found = []
    for file in (folder or state_folder() / "unsaved").glob(f"*{SUFFIX}"):
        try:
            note = json.loads(read_file(_note(file), NOTE_LIMIT))
            if _alive(int(note["pid"]), float(note["started"])):
                continue
            project = None if note["project"] is None else Path(str(note["project"]))
            found.append(UnsavedWork(file, project, float(note["when"]), str(note["name"])))
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            continue
    return sorted(found, key=lambda item: -item.when)


def _forget(file: Path) -> None:
    """Removes an autosave; one that the disk keeps is offered once more, which is not worth stopping for."""
    with suppress(InputError):
        remove(file)
        remove(_note(file))


def _note(file: Path) -> Path:
    """Beside an autosave: whose it is."""
    return file.with_suffix(".json")


def _me() -> dict[str, float]:
    return {"pid": os.getpid(), "started": psutil.Process().create_time()}


def _alive(pid: int, started: float) -> bool:
    """Whether the process that wrote it runs; a number is used again, a number and a start time are not."""
    try:
        return abs(psutil.Process(pid).create_time() - started) < 1.0
    except psutil.Error:
        return False
