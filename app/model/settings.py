"""Settings that persist between sessions on this computer: appearance, recent files, running jobs, trusted projects."""

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
from engine.io.files import read_file, write_json

__all__ = ["Settings", "cache_folder", "load_settings", "save_settings", "settings_folder", "state_folder"]

RECENT = 10
"""Files that the menu of recent ones lists."""


@dataclass(frozen=True)
class Settings:
    """The settings. A field that is missing or invalid in the file has its default."""

    theme: Literal["dark", "light"] = "dark"
    recent: tuple[str, ...] = ()
    """Absolute paths of recent files, the latest first."""
    jobs: tuple[str, ...] = ()
    """Result folders of training jobs that may still be running."""
    trusted: tuple[str, ...] = ()
    """Projects that the user has allowed to read outside their folders: SHA-256 of the file, a space, and its path.
    Another file at the same path (the next download of the same name) is not trusted."""
    face_light: bool = True
    """Whether cut faces are lit."""
    motion: bool = True
    """Whether pieces and the camera glide to new places or jump there."""
    names: bool = True
    """Whether names and marks of pieces are drawn on them."""
    statistics: bool = False
    """Whether the viewport shows how much it draws and how long a frame takes."""
    wires: bool = False
    """Whether the body is drawn as a net of lines over the object."""
    scale: float = 1.0
    """Scale of the interface; 1 is the usual size. Range [0.75, 2]."""
    window: tuple[int, int] = (1440, 900)
    """Size of the window at 96 DPI, pixels."""
    seen_hint: bool = False
    """Whether the user has made a first cut, after which the knife's hint is no longer shown."""

    def with_recent(self, path: Path) -> Settings:
        """With a file as the most recent one."""
        name = str(path.resolve())
        return replace(self, recent=(name, *(other for other in self.recent if other != name))[:RECENT])

    def without_recent(self, name: str) -> Settings:
        """Without a recent file, named by its path as listed."""
        return replace(self, recent=tuple(other for other in self.recent if other != name))

    def with_job(self, out: Path) -> Settings:
        """With a result folder whose job may still be running."""
        name = str(out.resolve())
        return replace(self, jobs=(name, *(other for other in self.jobs if other != name)))

    def without_job(self, out: Path) -> Settings:
        """Without this result folder."""
        return replace(self, jobs=tuple(name for name in self.jobs if name != str(out.resolve())))

    def with_trusted(self, project: Path) -> Settings:
        """With a project that may read outside its folder until its content changes."""
        identity = _identity(project)
        others = (other for other in self.trusted if other.partition(" ")[2] != identity.partition(" ")[2])
        return replace(self, trusted=(identity, *others))

    def trusts(self, project: Path) -> bool:
        """Whether the user has allowed the project, with this content, to read outside its folder."""
        return _identity(project) in self.trusted


def _identity(project: Path) -> str:
    """Hash and path of a project file. Raises InputError if it cannot be read."""
    return f"{hashlib.sha256(read_file(project, LIMIT)).hexdigest()} {project.resolve()}"


def settings_folder() -> Path:
    """The platform's folder for settings; FRUITNINJA_HOME puts everything into one folder (tests, USB sticks)."""
    return _folder("XDG_CONFIG_HOME", ".config", "Preferences")


def state_folder() -> Path:
    """The platform's folder for a program's own data: autosaves, jobs, results of scenes in read-only folders."""
    return _folder("XDG_STATE_HOME", ".local/state", "Application Support")


def cache_folder() -> Path:
    """The platform's folder for files that can be made again."""
    return _folder("XDG_CACHE_HOME", ".cache", "Caches")


def _folder(variable: str, fallback: str, mac: str) -> Path:
    if home := os.environ.get("FRUITNINJA_HOME"):
        return Path(home)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData/Local") / "FruitNinja"
    if sys.platform == "darwin":
        return Path.home() / "Library" / mac / "FruitNinja"
    given = os.environ.get(variable, "")
    base = Path(given) if os.path.isabs(given) else Path.home() / fallback  # XDG says to ignore relative paths
    return base / "fruitninja"


FLAGS = ("face_light", "motion", "names", "statistics", "wires", "seen_hint")

SMALLEST, GREATEST = 0.75, 2.0
"""Least and greatest scale of the interface: smaller is unreadable, larger leaves no room for the object."""

LARGEST = 1 << 20
"""Bytes of the largest settings file that is read; a real one has a few KB."""


def load_settings(path: Path | None = None) -> Settings:
    """The settings, with defaults for whatever cannot be read: a broken file never keeps the app from starting."""
    try:
        raw = json.loads(read_file(path or settings_folder() / "settings.json", LARGEST))
    except (OSError, ValueError, RecursionError):
        return Settings()
    if not isinstance(raw, dict):
        return Settings()
    settings = Settings()
    good = {f.name: value for f in fields(Settings) if (value := _like(raw.get(f.name), getattr(settings, f.name)))}
    good |= {name: raw[name] for name in FLAGS if isinstance(raw.get(name), bool)}
    scale = raw.get("scale")
    if isinstance(scale, (int, float)) and SMALLEST <= scale <= GREATEST:
        good["scale"] = float(scale)
    if good.get("theme") not in ("dark", "light"):
        good.pop("theme", None)
    return replace(settings, **good)


def save_settings(settings: Settings, path: Path | None = None) -> None:
    """Writes the settings. A full or read-only disk is ignored: losing them does little harm."""
    with suppress(InputError):
        write_json(path or settings_folder() / "settings.json", asdict(settings))


def _like(value: Any, default: Any) -> Any:
    """The value if it has the type and range of the default, else None."""
    if isinstance(default, str):
        return value if isinstance(value, str) else None
    if isinstance(default, tuple) and isinstance(value, list):
        kind = int if default and isinstance(default[0], int) else str
        if not all(type(item) is kind for item in value):
            return None
        if kind is int and (len(value) != 2 or not all(200 <= side < 1 << 15 for side in value)):  # pixels of a window
            return None
        return tuple(value)
    return None
