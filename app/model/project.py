"""The project file: a document and how it was looked at, as JSON that a person can read.

Paths are relative to the file's folder. A project that names files outside of it is refused until the user allows it:
a file from somewhere else should not make the app read or write anywhere it likes.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, get_args

from app.model.camera_control import Eye
from app.model.document import PRIORS, Cut, CutKind, Document, Key, Part, Placement, Training
from app.model.rigid_transform import Motion, Vec3
from engine.errors import InputError
from engine.io.files import atomic, read_file
from engine.io.strict_json import parse
from engine.scene.plane import Plane
from training.families import Family, Kind
from training.settings import DetailName

__all__ = ["SUFFIX", "Outside", "Project", "ViewMode", "Viewing", "load_project", "save_project"]

FORMAT = 1
"""Version of the file. Any other is refused, so it grows with every change of meaning."""

SUFFIX = ".fruitninja"

LIMIT = 1 << 24
"""Bytes of the largest project that is read; a real one has a few KB."""

ViewMode = str
VIEW_MODES = ("capture", "solid", "interior")

T = TypeVar("T")


class Outside(InputError):
    """A project names files outside of its folder."""

    def __init__(self, project: Path, paths: tuple[Path, ...]) -> None:
        self.project = project
        self.paths = paths
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        super().__init__(f"{project}: it uses files outside of its folder: {paths[0]}{more}; allow this to open it")


@dataclass(frozen=True)
class Viewing:
    """How the object is looked at. Saved with the project, not part of undo."""

    eye: Eye = field(default_factory=Eye)
    mode: ViewMode = "solid"
    background: Vec3 | None = None
    """RGB of the viewport. Range [0, 1]. None: the theme's own."""


@dataclass(frozen=True)
class Project:
    """What a project file holds."""

    document: Document
    viewing: Viewing


def save_project(path: Path, project: Project) -> None:
    """Writes the file whole or not at all. Raises InputError where that fails."""
    folder = path.parent.resolve()
    text = json.dumps(_record(project, folder), indent=1, allow_nan=False)
    with atomic(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def load_project(path: Path, outside: bool = False) -> Project:
    """The project in a file. `outside`: the user allows it to name files outside of its folder.

    Raises Outside where it does so without, and InputError for anything that is not exactly a project of this version.
    """
    raw = read_file(path, LIMIT)
    try:
        record = parse(raw)
    except ValueError as error:
        raise InputError(f"{path}: not a project: it is no JSON") from error
    reader = _Reader(path, outside)
    project = reader.project(record)
    if reader.outside and not outside:
        raise Outside(path, tuple(dict.fromkeys(reader.outside)))
    return project


# writing


def _record(project: Project, folder: Path) -> dict[str, Any]:
    document, view = project.document, project.viewing
    training = document.training
    return {
        "fruitninja": FORMAT,
        "scene": _relative(document.scene, folder),
        "up": document.up,
        "cuts": [
            {
                "id": cut.id,
                "name": cut.name,
                "kind": cut.kind,
                "on": cut.on,
                "shift": cut.shift,
                "parts": [{"scope": part.scope, "plane": _plane(part.plane)} for part in cut.parts],
            }
            for cut in document.cuts
        ],
        "pieces": [
            {
                "key": key,
                "turn": placement.motion.turn,
                "shift": placement.motion.shift,
                "visible": placement.visible,
                "removed": placement.removed,
                "name": placement.name,
            }
            for key, placement in document.placements
        ],
        "families": [
            {
                "kind": family.kind,
                "count": family.count,
                "exemplars": [_relative(exemplar, folder) for exemplar in family.exemplars],
                "prompt": family.prompt,
                "axis": family.axis,
                "range": family.span,
                "planes": [_plane(plane) for plane in family.custom],
            }
            for family in document.families
        ],
        "gap": document.gap,
        "explode": document.explode,
        "training": {
            "detail": training.detail,
            "prior": training.prior,
            "seed": training.seed,
            "iterations": training.iterations,
            "out": _relative(training.out, folder),
            "model": _relative(training.model, folder),
            "thing": training.thing,
        },
        "view": {
            "mode": view.mode,
            "background": view.background,
            "target": view.eye.target,
            "azimuth": view.eye.azimuth,
            "elevation": view.eye.elevation,
            "distance": view.eye.distance,
            "fov": view.eye.fov,
            "orthographic": view.eye.orthographic,
        },
    }


def _plane(plane: Plane) -> list[float]:
    return [*plane.normal, plane.offset]


def _relative(path: Path | None, folder: Path) -> str | None:
    """A path as the file has it: with forward slashes, relative where that is possible at all."""
    if path is None:
        return None
    path = path.absolute()
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


# reading


class _Reader:
    """Turns a parsed file into a project, or says in one line what is wrong where."""

    def __init__(self, path: Path, allowed: bool) -> None:
        self.path = path
        self.folder = path.parent.resolve()
        self.allowed = allowed
        self.outside: list[Path] = []

    def project(self, raw: Any) -> Project:
        fields = self.table(raw, "the file")
        version = fields.get("fruitninja")
        if type(version) is not int:
            raise InputError(f"{self.path}: not a project: it has no 'fruitninja' version")
        if version != FORMAT:
            raise InputError(f"{self.path}: version {version}, this app reads {FORMAT}; update the app")
        cuts = self.each(fields, "cuts", self.cut)
        self.require(len({cut.id for cut in cuts}) == len(cuts), "two cuts have the same id")
        known = {cut.id for cut in cuts}
        keys = [part.scope for cut in cuts for part in cut.parts]
        placements = self.each(fields, "pieces", self.placement)
        keys += [key for key, _ in placements]
        self.require(all(step in known for key in keys for step, _ in key), "a piece names a cut that is not there")
        self.require(len(dict(placements)) == len(placements), "a piece is listed twice")
        families = self.each(fields, "families", self.family)
        self.require(len({f.kind for f in families}) == len(families), "a family is listed twice")
        document = Document(
            scene=self.file(fields, "scene"),
            up=self.unit(fields, "up"),
            cuts=cuts,
            placements=tuple(sorted(placements, key=lambda item: item[0])),
            families=families,
            training=self.training(self.table(fields.get("training"), "'training'")),
            gap=self.number(fields, "gap", 0, 2),
            explode=self.number(fields, "explode", 0, 2),
        )
        return Project(document, self.viewing(self.table(fields.get("view"), "'view'")))

    def cut(self, raw: Any) -> Cut:
        fields = self.table(raw, "a cut")
        parts = self.each(fields, "parts", self.part)
        self.require(len(parts) > 0, "a cut has no plane")
        return Cut(
            id=self.whole(fields, "id", 1),
            name=self.text(fields, "name"),
            parts=parts,
            kind=self.choice(fields, "kind", get_args(CutKind)),
            shift=self.number(fields, "shift"),
            on=self.flag(fields, "on"),
        )

    def part(self, raw: Any) -> Part:
        fields = self.table(raw, "a part of a cut")
        return Part(self.plane(fields.get("plane")), self.key(fields.get("scope")))

    def placement(self, raw: Any) -> tuple[Key, Placement]:
        fields = self.table(raw, "a piece")
        w, x, y, z = self.numbers(fields.get("turn"), 4, "'turn'")
        a, b, c = self.numbers(fields.get("shift"), 3, "'shift'")
        self.require(abs(math.hypot(w, x, y, z) - 1) < 1e-6, "'turn' of a piece has not length 1")
        motion = Motion((w, x, y, z), (a, b, c))
        placement = Placement(
            motion, self.flag(fields, "visible"), self.flag(fields, "removed"), self.text(fields, "name")
        )
        return self.key(fields.get("key")), placement

    def family(self, raw: Any) -> Family:
        fields = self.table(raw, "a family")
        kind: Kind = self.choice(fields, "kind", get_args(Kind))
        planes = self.each(fields, "planes", self.plane)
        pictures = self.each(fields, "exemplars", lambda name: self.inside(name, "'exemplars'"))
        count = self.whole(fields, "count", 0, 10_000)
        prompt, axis = self.text(fields, "prompt"), self.unit(fields, "axis")
        low, high = self.numbers(fields.get("range", [0.0, 1.0]), 2, "'range'")  # projects of before have none
        try:
            return Family(kind, count, pictures, prompt, axis, planes, (low, high))
        except InputError as error:
            raise InputError(f"{self.path}: not a project: {error}") from error

    def training(self, fields: dict[str, Any]) -> Training:
        iterations = fields.get("iterations")
        return Training(
            detail=self.choice(fields, "detail", get_args(DetailName)),
            prior=self.choice(fields, "prior", PRIORS),
            seed=self.whole(fields, "seed", 0),
            iterations=None if iterations is None else self.whole(fields, "iterations", 0, 1_000_000),
            out=self.file(fields, "out"),
            model=self.file(fields, "model"),
            thing=self.text(fields, "thing"),
        )

    def viewing(self, fields: dict[str, Any]) -> Viewing:
        x, y, z = self.numbers(fields.get("target"), 3, "'target'")
        distance = self.number(fields, "distance")
        self.require(distance > 0, "'distance' is not above 0")
        background = fields.get("background")
        colour = None
        if background is not None:
            r, g, b = self.numbers(background, 3, "'background'")
            self.require(min(r, g, b) >= 0 and max(r, g, b) <= 1, "'background' is outside [0, 1]")
            colour = (r, g, b)
        eye = Eye(
            (x, y, z),
            self.number(fields, "azimuth"),
            self.number(fields, "elevation", -90, 90),
            distance,
            self.number(fields, "fov", 5, 120),
            self.flag(fields, "orthographic"),
        )
        return Viewing(eye, self.choice(fields, "mode", VIEW_MODES), colour)

    # values

    def require(self, condition: bool, wrong: str) -> None:
        if not condition:
            raise InputError(f"{self.path}: not a project: {wrong}")

    def table(self, value: Any, what: str) -> dict[str, Any]:
        self.require(isinstance(value, dict), f"{what} is no table")
        return value

    def each(self, fields: dict[str, Any], key: str, read: Callable[[Any], T]) -> tuple[T, ...]:
        values = fields.get(key)
        self.require(isinstance(values, list), f"no list '{key}'")
        return tuple(read(value) for value in values or ())

    def text(self, fields: dict[str, Any], key: str) -> str:
        value = fields.get(key)
        text = value if isinstance(value, str) else "\0"
        # Neither a null nor half a character, which JSON can say, can be shown or handed to another program.
        whole = not any(c == "\0" or "\ud800" <= c <= "\udfff" for c in text)
        self.require(whole and len(text) <= 10_000, f"no text '{key}'")
        return text

    def choice(self, fields: dict[str, Any], key: str, allowed: tuple[Any, ...]) -> Any:
        value = fields.get(key)
        self.require(isinstance(value, str) and value in allowed, f"'{key}' is none of {', '.join(allowed)}")
        return value

    def flag(self, fields: dict[str, Any], key: str) -> bool:
        value = fields.get(key)
        self.require(isinstance(value, bool), f"'{key}' is neither true nor false")
        return bool(value)

    def whole(self, fields: dict[str, Any], key: str, low: int, high: int = 1 << 53) -> int:
        value = fields.get(key)
        self.require(type(value) is int and low <= value <= high, f"'{key}' is no whole number from {low} to {high}")
        return value if isinstance(value, int) else 0

    def number(self, fields: dict[str, Any], key: str, low: float = -1e12, high: float = 1e12) -> float:
        value = self.numbers([fields.get(key)], 1, f"'{key}'")[0]
        self.require(low <= value <= high, f"'{key}' is not between {low:g} and {high:g}")
        return value

    def numbers(self, values: Any, count: int, what: str) -> list[float]:
        ok = isinstance(values, list) and len(values) == count
        ok = ok and all(type(v) in (int, float) and abs(v) <= 1e12 for v in values)  # false for NaN
        self.require(ok, f"{what} is not {'a number' if count == 1 else f'{count} numbers'}")
        return [float(v) for v in values]

    def plane(self, value: Any) -> Plane:
        a, b, c, d = self.numbers(value, 4, "a plane")
        self.require(abs(math.hypot(a, b, c) - 1) < 1e-6, "the normal of a plane has not length 1")
        return Plane((a, b, c), d)

    def unit(self, fields: dict[str, Any], key: str) -> Vec3 | None:
        if fields.get(key) is None:
            return None
        x, y, z = self.numbers(fields[key], 3, f"'{key}'")
        self.require(abs(math.hypot(x, y, z) - 1) < 1e-6, f"'{key}' has not length 1")
        return x, y, z

    def key(self, value: Any) -> Key:
        self.require(isinstance(value, list), "a piece has no list of cuts")
        steps = []
        for step in value:
            ok = isinstance(step, list) and len(step) == 2 and all(type(part) is int for part in step)
            self.require(ok and step[1] in (-1, 1), "a piece names no side of a cut")
            steps.append((step[0], step[1]))
        self.require(len(dict(steps)) == len(steps), "a piece names a cut twice")
        return tuple(steps)

    def file(self, fields: dict[str, Any], key: str) -> Path | None:
        value = fields.get(key)
        return None if value is None else self.inside(value, f"'{key}'")

    def inside(self, value: Any, what: str) -> Path:
        """The path, noted where it leads out of the project's folder, by dots, as absolute, or through a link."""
        self.require(isinstance(value, str) and 0 < len(value) < 4096 and "\0" not in value, f"{what} is no path")
        path = Path(os.path.normpath(self.folder / value))
        if not path.is_relative_to(self.folder):
            self.outside.append(path)  # and not looked at: on Windows a look may greet a server, with a password
            return path
        try:
            real = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a ValueError for what no file can be called
            raise InputError(f"{self.path}: not a project: {what} is no path") from error
        if not real.is_relative_to(self.folder):
            self.outside.append(path)
        return path
