"""The manifest of a batch: scenes and their options in TOML, checked as a whole before anything starts.

    [defaults]                                  # for every scene that does not override them
    up = "z"
    exemplar = { horizontal = "slice.png" }     # a picture, a folder of them, or a list

    [[scene]]
    scene = "captures/melon.ply"                # relative to the manifest, as all paths
    name = "melon"                              # folder of the result; the scene's own name if not given
    exemplar = { horizontal = ["a.png", "b.png"], radial = "c.png" }
    family = ["horizontal:40", "radial:30"]

The keys are the options of `fruitninja-train`; a scene's own key replaces the default.
"""

from __future__ import annotations

import os
import re
import tomllib
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast, get_args

from engine.errors import InputError, one_line
from engine.io.files import read_file
from engine.io.picture_file import open_picture
from training.cli import parse_axis, parse_families, parse_pictures
from training.isolation_options import parse_isolation
from training.request import PriorName, Request
from training.settings import DetailName

__all__ = ["ManifestErrors", "Scene", "read_manifest"]

MAX_BYTES = 1 << 21
"""Largest accepted manifest in bytes: ten thousand scenes, parsed in a few seconds at worst."""

MAX_DOTS = 40
"""Largest number of dots in a line outside quotes. tomllib is cubic in the parts of a dotted key: minutes for a hundred
kilobytes. Keys here have at most three parts, and the numbers in a line need fewer dots than this."""

TOKEN = re.compile(
    r"""\"{3}(?:[^"\\]|\\[\s\S]|"(?!""))*+(?:"{3,5}|\Z)|'{3}(?:[^']|'(?!''))*+(?:'{3,5}|\Z)"""
    r"""|"(?:\\.|[^"\\\n])*+"?|'[^'\n]*+'?|\#[^\n]*+|[^."'#\n]++|[\s\S]"""
)
"""Tokens of TOML, as far as needed to find dots; linear in the text, even with unclosed quotes."""

NAME = re.compile(r"\w[\w .+-]{0,99}")
"""Names of results: valid folder names on any system, without separators."""

MAX_NAME_BYTES = 200
"""Longest name in bytes; file systems allow 255, and temporary files add to it."""

DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]) *(\..*)?", re.IGNORECASE)
"""Names that Windows reserves for devices, with any extension."""

RESERVED = re.compile(r"batch\.json|.*\.lock", re.IGNORECASE)
"""Files that a batch writes beside the folders."""

KEYS = ("scene", "name", "exemplar", "family", "prompt", "up", "keep", "remove", "no_surroundings", "no_floor",
        "same", "detail", "prior", "model", "midas", "object", "iterations", "seed", "compact")  # fmt: skip
PER_SCENE_KEYS = ("scene", "name")
"""Keys that scenes cannot share."""


class ManifestErrors(InputError):
    """All errors of a manifest, one line each."""

    def __init__(self, lines: Sequence[str]) -> None:
        ValueError.__init__(self, "\n".join(map(one_line, lines)))


@dataclass(frozen=True)
class Scene:
    """An entry of a manifest."""

    name: str
    """Unique; the folder of the result."""
    request: Request
    """The scene's request, with absolute paths."""


def read_manifest(path: Path) -> list[Scene]:
    """The scenes of a manifest, in order. Raises ManifestErrors with one line per error."""
    raw = read_file(path, MAX_BYTES)
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a manifest: it is no text in UTF-8; write it as TOML") from error
    try:
        _check_dots(path, text)
        fields = tomllib.loads(text)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: no TOML: {' '.join(str(error).split())[:200]}") from error
    return _ManifestReader(path).scenes(fields)


def _check_dots(path: Path, text: str) -> None:
    """Raises InputError if a line has over MAX_DOTS dots, which would take tomllib too long."""
    line, dots = 1, 0
    for token in TOKEN.finditer(text):
        if token[0] == ".":
            dots += 1
            if dots > MAX_DOTS:
                raise InputError(f"{path}: line {line}: over {MAX_DOTS} dots outside of quotes; no key has so many")
        elif lines := token[0].count("\n"):
            line, dots = line + lines, 0


class _ManifestReader:
    """Converts parsed fields to scenes and collects their errors."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.folder = path.parent.resolve()
        self.errors: list[str] = []

    def scenes(self, fields: dict[str, Any]) -> list[Scene]:
        """All scenes. Raises ManifestErrors."""
        for key in fields.keys() - {"defaults", "scene"}:
            self.add_error(
                "the file", f"unknown key '{_abbreviate(key)}'; it has [defaults] and a [[scene]] for each scene"
            )
        defaults, entries = fields.get("defaults", {}), fields.get("scene", [])
        if not isinstance(defaults, dict):
            self.add_error("defaults", "write it as a table: [defaults]")
            defaults = {}
        for key in defaults.keys() & set(PER_SCENE_KEYS):
            self.add_error("defaults", f"'{key}' belongs to each [[scene]] alone; move it there")
        self.check_keys("defaults", defaults)
        if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
            self.add_error("the file", "no scenes; add a [[scene]] with scene = 'capture.ply' for each")
            entries = []
        scenes: list[Scene] = []
        seen: dict[str, str] = {}
        for number, entry in enumerate(entries, start=1):
            name = entry.get("name", entry.get("scene"))
            where = f"scene {number}" + (f" ({_abbreviate(name)})" if isinstance(name, str) else "")
            self.check_keys(where, entry)
            try:
                scene = self.scene({k: v for k, v in defaults.items() if k not in PER_SCENE_KEYS} | entry)
            except (InputError, ValueError, OSError) as error:
                # The messages are those of fruitninja-train, whose options have dashes.
                self.add_error(where, re.sub(r"(?<!\S)--(?=[a-z])", "", " ".join(str(error).split())))
                continue
            first = seen.setdefault(_folder_key(scene.name), where)
            if first != where:
                self.add_error(
                    where, f"its result would be '{scene.name}', as that of {first}; give one of them a name"
                )
            scenes.append(scene)
        if self.errors:
            raise ManifestErrors(self.errors)
        return scenes

    def scene(self, fields: dict[str, Any]) -> Scene:
        """One scene with the defaults filled in. Raises InputError for its first error."""
        path = self.file(fields, "scene")
        if path is None:
            raise InputError("no 'scene'; give the capture as scene = 'capture.ply'")
        name = unicodedata.normalize("NFC", _string(fields, "name", path.stem))  # some systems normalise names
        if not NAME.fullmatch(name) or name.endswith((".", " ")) or len(name.encode()) > MAX_NAME_BYTES:
            raise InputError(f"name '{_abbreviate(name)}': cannot be a folder; use letters, digits, blanks and . + - _")
        if DEVICE.fullmatch(name):
            raise InputError(f"name '{name}': a device on Windows, so it cannot be a folder; give another name")
        if RESERVED.fullmatch(name):
            raise InputError(f"name '{name}': the batch writes a file of this name itself; give another name")
        detail, prior = _string(fields, "detail", "standard"), _string(fields, "prior", "exemplar")
        for key, value, allowed in (("detail", detail, DetailName), ("prior", prior, PriorName)):
            if value not in get_args(allowed):
                raise InputError(f"{key} '{_abbreviate(value)}': unknown; choose {', '.join(get_args(allowed))}")
        takes_model = prior == "stable-diffusion"
        model, midas = self.file(fields, "model", folder=True), self.file(fields, "midas", folder=True)
        if takes_model != (model is not None) or (midas and not takes_model):
            raise InputError("model and midas belong to prior = 'stable-diffusion', which needs a model")
        up = fields.get("up")
        axis = ",".join(map(str, up)) if isinstance(up, list) else up
        if axis is not None and not isinstance(axis, str):
            raise InputError("up: give 'z', '-y' or three numbers as [0, 0, 1]")
        return Scene(
            name,
            Request(
                path,
                parse_families(self.exemplars(fields), _strings(fields, "family"), _prompts(fields), not takes_model),
                cast(DetailName, detail),
                None if axis is None else parse_axis(axis, "up"),
                _integer(fields, "seed") or 0,
                _integer(fields, "iterations"),
                cast(PriorName, prior),
                model,
                midas,
                _string(fields, "object", "") or None,
                parse_isolation(
                    _strings(fields, "keep"),
                    _strings(fields, "remove"),
                    _flag(fields, "no_floor"),
                    _flag(fields, "no_surroundings"),
                ),
                _flag(fields, "same"),
                _flag(fields, "compact"),
            ),
        )

    def exemplars(self, fields: dict[str, Any]) -> list[str]:
        """The pictures as family=path, each opened to check that it is a picture."""
        table = _table(fields, "exemplar", "{ horizontal = 'cut.png' }")
        result = []
        for kind, names in table.items():
            for name in names if isinstance(names, list) else [names]:
                if not isinstance(name, str) or not name:
                    raise InputError(f"exemplar of {_abbreviate(kind)}: give a picture or a list of pictures")
                path = self.resolved(name)
                for pictures in parse_pictures([f"{kind}={path}"]).values():
                    for picture in pictures:
                        with open_picture(picture):
                            pass
                result.append(f"{kind}={path}")
        return result

    def file(self, fields: dict[str, Any], key: str, folder: bool = False) -> Path | None:
        """The absolute path of an existing file or folder, None without the key."""
        name = _string(fields, key, "")
        if not name:
            return None
        path = self.resolved(name)
        if not (os.path.isdir(path) if folder else os.path.isfile(path)):  # pathlib raises for a name that is too long
            raise InputError(f"{path}: no such {'folder' if folder else 'file'}")
        return path

    def resolved(self, name: str) -> Path:
        """A path in the manifest, made absolute."""
        if "\0" in name or len(name) > 4096:
            raise InputError(f"'{_abbreviate(name)}' is no path")
        return (self.folder / Path(name).expanduser()).absolute()

    def check_keys(self, where: str, fields: dict[str, Any]) -> None:
        """Records unknown keys as errors."""
        for key in fields.keys() - set(KEYS):
            self.add_error(where, f"unknown key '{_abbreviate(key)}'; there are {', '.join(KEYS)}")

    def add_error(self, where: str, what: str) -> None:
        self.errors.append(f"{self.path}: {where}: {what}")


def _folder_key(name: str) -> str:
    """A key that is equal for names of the same folder on systems that ignore case or Unicode normalisation."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())


def _abbreviate(text: str) -> str:
    """A value of the manifest, printable and short enough for one line."""
    plain = "".join(c if c.isprintable() else "?" for c in text)
    return plain if len(plain) <= 60 else plain[:57] + "..."


def _string(fields: dict[str, Any], key: str, default: str) -> str:
    value = fields.get(key, default)
    if not isinstance(value, str) or len(value) > 10_000:
        raise InputError(f"{key}: give it as text, in quotes")
    return value


def _strings(fields: dict[str, Any], key: str) -> list[str]:
    value = fields.get(key, [])
    values = [value] if isinstance(value, str) else value
    if not isinstance(values, list) or not all(isinstance(item, str) for item in values):
        raise InputError(f"{key}: give a list of texts, as ['horizontal:40', 'radial:30']")
    return values


def _table(fields: dict[str, Any], key: str, example: str) -> dict[str, Any]:
    value = fields.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"{key}: give one for each family, as {key} = {example}")
    return value


def _prompts(fields: dict[str, Any]) -> list[str]:
    table = _table(fields, "prompt", "{ radial = 'a halved melon' }")
    if not all(isinstance(words, str) for words in table.values()):
        raise InputError("prompt: give words in quotes for each family")
    return [f"{kind}={words}" for kind, words in table.items()]


def _flag(fields: dict[str, Any], key: str) -> bool:
    value = fields.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{key}: give true or false")
    return value


def _integer(fields: dict[str, Any], key: str) -> int | None:
    value = fields.get(key)
    if value is not None and (type(value) is not int or not 0 <= value < 1 << 53):
        raise InputError(f"{key}: give a whole number of at least 0")
    return value
