"""Autosaves: copies of unsaved work, which a later session offers after a crash."""

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
from engine.io.files import read_file, remove, write_json

__all__ = ["Autosave", "UnsavedWork", "find_unsaved_work"]

EVERY = 10.0
"""Seconds between two autosaves: the most work that a crash can cost."""


@dataclass(frozen=True)
class UnsavedWork:
    """Unsaved work of a session that crashed."""

    file: Path
    project: Path | None
    """Its project file; None if it was never saved."""
    when: float
    """When it was saved, seconds since 1970."""
    name: str = ""
    """Name of the project, or else of its scene."""

    def load(self) -> Project:
        """The work itself. Raises InputError if the file is broken."""
        return load_project(self.file, outside=True)  # the app wrote it itself

    def discard(self) -> None:
        """Removes the autosave."""
        _remove_autosave(self.file)


class Autosave:
    """The autosave of one session."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or state_folder() / "unsaved"
        self.file = self.folder / f"{os.getpid()}-{time.time_ns()}{SUFFIX}"
        self.last: Project | None = None
        self.next = 0.0
        self._taken: list[UnsavedWork] = []
        """Work taken over whose files are still the only ones."""

    def update(self, project: Project, changed: bool, target: Path | None, now: float | None = None) -> bool:
        """Writes the project if an autosave is due and it differs from the last one; True if it was written.

        `changed`: whether there are unsaved changes; without any the autosave is removed. `target`: the project file,
        None if there is none yet. `now`: seconds of the monotonic clock. Raises InputError if the file cannot be
        written.
        """
        now = time.monotonic() if now is None else now
        if not changed:
            self.clear()
            return False
        if now < self.next or project == self.last:
            return False
        self.next = now + EVERY
        save_project(self.file, project)
        named = target or project.documents[0].scene
        note = {"project": None if target is None else str(target), "when": time.time(), **_this_process()}
        note["name"] = named.stem if named else ""
        write_json(_note(self.file), note)
        self.last = project
        self._discard_taken()
        return True

    def take_over(self, work: UnsavedWork) -> None:
        """Goes on with the work of a session that crashed. Its file is removed once this session has written its own,
        which is due at once."""
        self._taken.append(work)
        self.last, self.next = None, 0.0

    def clear(self) -> None:
        """Removes the autosave, since nothing is unsaved."""
        if self.last is not None:
            _remove_autosave(self.file)
            self.last = None
        self._discard_taken()

    def _discard_taken(self) -> None:
        while self._taken:
            self._taken.pop().discard()


NOTE_LIMIT = 1 << 16
"""Bytes of the largest note that is read; a real one has a few hundred."""


def find_unsaved_work(folder: Path | None = None) -> list[UnsavedWork]:
    """The autosaves of sessions that no longer run, the latest first."""
    found = []
    for file in (folder or state_folder() / "unsaved").glob(f"*{SUFFIX}"):
        try:
            note = json.loads(read_file(_note(file), NOTE_LIMIT))
            if _is_running(int(note["pid"]), float(note["started"])):
                continue
            project = None if note["project"] is None else Path(str(note["project"]))
            found.append(UnsavedWork(file, project, float(note["when"]), str(note["name"])))
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            continue
    return sorted(found, key=lambda item: -item.when)


def _remove_autosave(file: Path) -> None:
    """Removes an autosave. If the disk refuses, it is offered again at the next start, which does no harm."""
    with suppress(InputError):
        remove(file)
        remove(_note(file))


def _note(file: Path) -> Path:
    """The file beside an autosave that says which process wrote it, and of which project."""
    return file.with_suffix(".json")


def _this_process() -> dict[str, float]:
    return {"pid": os.getpid(), "started": psutil.Process().create_time()}


def _is_running(pid: int, started: float) -> bool:
    """Whether this very process still runs: a pid may be reused, but a pid with a start time is unique."""
    try:
        return abs(psutil.Process(pid).create_time() - started) < 1.0
    except psutil.Error:
        return False
