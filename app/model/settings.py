"""What stays between sessions on this computer: the look, recent files, running jobs, trusted projects."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from app.model.project import LIMIT
from engine.errors import InputError
from engine.io.files import atomic, read_file

__all__ = ["Settings", "load_settings", "save_settings", "settings_folder", "state_folder"]

RECENT = 10
"""ProjectFiles that the menu lists."""


@dataclass(frozen=True)
class Settings:
    """Plain data; a field that the file lacks or spells wrongly has its default."""

    theme: Literal["dark", "light"] = "dark"
    recent: tuple[str, ...] = ()
    """Absolute paths, the latest first."""
    jobs: tuple[str, ...] = ()
    """Result folders of training jobs that may still run."""
    trusted: tuple[str, ...] = ()
    """Projects outside of whose folder the user allowed to read: SHA-256 of the file, a space, and its path. Another
    file that takes the place of one (the next download of the same name) is not trusted for it."""
    face_light: bool = True
    """A plain light on cut faces."""
    window: tuple[int, int] = (1440, 900)
    seen_hint: bool = False
    """Whether the first cut has been made: then the opening hint has done its work."""

    def with_recent(self, path: Path) -> Settings:
        """With a file at the head of the recent ones."""
        name = str(path.resolve())
        return replace(self, recent=(name, *(other for other in self.recent if other != name))[:RECENT])

    def with_job(self, out: Path) -> Settings:
        """With a result folder whose job may run."""
        name = str(out.resolve())
        return replace(self, jobs=(name, *(other for other in self.jobs if other != name)))

    def without_job(self, out: Path) -> Settings:
        """Without it."""
        return replace(self, jobs=tuple(name for name in self.jobs if name != str(out.resolve())))

    def with_trusted(self, project: Path) -> Settings:
        """With a project that may read outside of its folder, for as long as it is as it is now."""
        mark = _mark(project)
        others = (other for other in self.trusted if other.partition(" ")[2] != mark.partition(" ")[2])
        return replace(self, trusted=(mark, *others))

    def trusts(self, project: Path) -> bool:
        """Whether the user allowed this very file to read outside of its folder."""
        return _mark(project) in self.trusted


def _mark(project: Path) -> str:
    """A project as it is now. Raises InputError where it cannot be read."""
    return f"{hashlib.sha256(read_file(project, LIMIT)).hexdigest()} {project.resolve()}"


def settings_folder() -> Path:
    """Where the platform keeps settings; FRUITNINJA_HOME puts everything into one folder (tests, USB sticks)."""
    return _folder("XDG_CONFIG_HOME", ".config", "Preferences")


def state_folder() -> Path:
    """Where the platform keeps what a program writes for itself: autosaves, results of scenes that stand read-only."""
    return _folder("XDG_STATE_HOME", ".local/state", "Application Support")


def _folder(variable: str, fallback: str, mac: str) -> Path:
    if home := os.environ.get("FRUITNINJA_HOME"):
        return Path(home)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData/Local") / "FruitNinja"
    if sys.platform == "darwin":
        return Path.home() / "Library" / mac / "FruitNinja"
    given = os.environ.get(variable, "")
    return (Path(given) if os.path.isabs(given) else Path.home() / fallback) / "fruitninja"  # as the standard has it


LARGEST = 1 << 20
"""Bytes of the largest settings that are read; real ones have a few KB."""


def load_settings(path: Path | None = None) -> Settings:
    """The settings, defaults for whatever cannot be read: a broken settings file never keeps the app from starting."""
    try:
        raw = json.loads(read_file(path or settings_folder() / "settings.json", LARGEST))
    except (OSError, ValueError, RecursionError):
        return Settings()
    if not isinstance(raw, dict):
        return Settings()
    settings = Settings()
    good = {f.name: value for f in fields(Settings) if (value := _like(raw.get(f.name), getattr(settings, f.name)))}
    good |= {name: raw[name] for name in ("face_light", "seen_hint") if isinstance(raw.get(name), bool)}
    if good.get("theme") not in ("dark", "light"):
        good.pop("theme", None)
    return replace(settings, **good)


def save_settings(settings: Settings, path: Path | None = None) -> None:
    """Writes them; a disk that is full or read-only is not worth stopping for."""
    text = json.dumps(asdict(settings), indent=1) + "\n"
    with suppress(InputError), atomic(path or settings_folder() / "settings.json") as temporary:
        temporary.write_text(text, encoding="utf-8")


def _like(value: Any, default: Any) -> Any:
    """The value if it is of the default's kind, else None."""
    if isinstance(default, str):
        return value if isinstance(value, str) else None
    if isinstance(default, float):
        ok = isinstance(value, int | float) and not isinstance(value, bool) and 0.5 <= value <= 3
        return float(value) if ok else None
    if isinstance(default, tuple) and isinstance(value, list):
        kind = int if default and isinstance(default[0], int) else str
        if not all(type(item) is kind for item in value):
            return None
        if kind is int and (len(value) != 2 or not all(200 <= side < 1 << 15 for side in value)):  # pixels of a window
            return None
        return tuple(value)
    return None
