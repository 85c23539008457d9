"""The project file: the documents of a scene's objects and their view, as readable JSON.

Paths are relative to the file's folder. A project that names files outside that folder is refused until the user
allows it: a file from a stranger must not choose what the app reads and writes.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from app.model.camera_control import OrbitCamera
from app.model.document import MARKS, Cut, CutKind, Document, Key, Part, Placement, Training
from app.model.film.project_record import (
    eye_record,
    look_record,
    read_eye,
    read_look,
    read_timeline,
    timeline_record,
)
from app.model.film.timeline import FilmLook, Timeline
from app.model.measure.units import LENGTHS, UNITS, Unit
from app.model.rigid_transform import Motion, Vec3
from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.files import read_file, write_json
from engine.io.strict_json import parse
from engine.isolate.record import isolation_record, read_isolation, read_selection, selection_record
from engine.render.culling.draw_options import SplatLook
from engine.scene.plane import Plane
from training.request import MOST_ITERATIONS, PriorName, family_record, read_family, read_plane
from training.settings import DetailName

__all__ = ["FORMAT", "SUFFIX", "Outside", "Project", "ViewMode", "Viewing", "Work", "load_project", "save_project"]

FORMAT = 8
"""Version of the file format. Files of a later version are refused, so it grows with every change of meaning."""

SINGLE_FORMAT = 2
"""Last version with a single object, whose fields are at the top level of the file."""

FIRST_FORMAT = 1
"""Oldest version that is read: it has no isolation, and is otherwise the same as version 2."""

MOST_OBJECTS = 1000
"""Most objects in a project that is read: more than a capture shows."""

SUFFIX = ".fruitninja"

LIMIT = 1 << 24
"""Bytes of the largest project that is read; a real one has a few KB."""

SPLAT_SIZES = (0.05, 2.0)
"""Least and greatest factor of the splats' size: smaller splats are single pixels, larger ones hide each other."""

ViewMode = str
VIEW_MODES = ("capture", "solid", "interior")


class Outside(InputError):
    """Raised if a project names files outside its folder."""

    def __init__(self, project: Path, paths: tuple[Path, ...]) -> None:
        self.project = project
        self.paths = paths
        more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
        super().__init__(f"{project}: it uses files outside of its folder: {paths[0]}{more}; allow this to open it")


@dataclass(frozen=True)
class Viewing:
    """How the object is viewed. It is saved with the project, but not part of undo."""

    eye: OrbitCamera = field(default_factory=OrbitCamera)
    mode: ViewMode = "solid"
    background: Vec3 | None = None
    """RGB of the viewport's background. Range [0, 1]. None: the theme's own."""
    slices: bool = False
    """Whether three cut faces are shown beside the object."""
    cross: Vec3 | None = None
    """Where these three cross, object space; None: in the middle of the object."""
    unit: Unit = field(default_factory=Unit)
    """What lengths are given in."""
    timeline: bool = False
    """Whether the film's timeline is shown below the object."""
    film: FilmLook = field(default_factory=FilmLook)
    """How the film is saved."""
    splats: SplatLook = field(default_factory=SplatLook)
    """Factors of the splats' sizes and opacities in the viewport; films show splats as they are."""


@dataclass(frozen=True)
class Work:
    """Everything that undo covers."""

    documents: tuple[Document, ...]
    """Documents of the scene's objects, at least one; their numbers differ."""
    film: Timeline = field(default_factory=Timeline)


@dataclass(frozen=True)
class Project:
    """The content of a project file."""

    documents: tuple[Document, ...]
    """Documents of its objects, at least one; all have the same scene, and their numbers differ."""
    viewing: Viewing
    film: Timeline = field(default_factory=Timeline)

    @property
    def work(self) -> Work:
        """The part that undo covers."""
        return Work(self.documents, self.film)


def save_project(path: Path, project: Project) -> None:
    """Writes the file completely or not at all. Raises InputError if that fails, or if `load_project` would refuse it:
    nobody should find that out at the next start."""
    record = _record(project, path.parent.resolve())
    try:
        _Reader(path, allowed=True).project(parse(json.dumps(record).encode()))
    except ValueError as error:
        raise InputError(f"{path}: cannot be saved: {error}") from error
    write_json(path, record)


def load_project(path: Path, outside: bool = False) -> Project:
    """Reads a project. `outside`: whether the user has allowed it to name files outside its folder.

    Raises Outside if it names such files without being allowed to, and InputError for anything but a valid project of
    a version from FIRST_FORMAT to FORMAT.
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
    view = project.viewing
    return {
        "fruitninja": FORMAT,
        "scene": _relative(project.documents[0].scene, folder),
        "objects": [_object_record(document, folder) for document in project.documents],
        "view": {
            "mode": view.mode,
            "background": view.background,
            **eye_record(view.eye),
            "slices": view.slices,
            "cross": view.cross,
            "unit": {"name": view.unit.name, "length": view.unit.length},
            "timeline": view.timeline,
            "film_look": look_record(view.film),
            "splats": {"size": view.splats.size, "opacity": view.splats.opacity},
        },
        "film": timeline_record(project.film),
    }


def _object_record(document: Document, folder: Path) -> dict[str, Any]:
    training = document.training
    return {
        "number": document.number,
        "name": document.name,
        "visible": document.visible,
        "up": document.up,
        "isolation": isolation_record(document.isolation),
        "marked": selection_record(document.selection),  # its name since the first such files
        "cuts": [
            {
                "id": cut.id,
                "name": cut.name,
                "kind": cut.kind,
                "on": cut.on,
                "shift": cut.shift,
                "parts": [
                    {"scope": part.scope, "plane": _plane(part.plane), "walls": [_plane(wall) for wall in part.walls]}
                    for part in cut.parts
                ],
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
                "group": placement.group,
                "mark": placement.mark,
            }
            for key, placement in document.placements
        ],
        "families": [
            family_record(family, lambda exemplar: _relative(exemplar, folder)) for family in document.families
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
            "same": training.same,
        },
    }


def _plane(plane: Plane) -> list[float]:
    return [*plane.normal, plane.offset]


def _relative(path: Path | None, folder: Path) -> str | None:
    """A path as written in the file: with forward slashes, and relative unless it is on another drive."""
    if path is None:
        return None
    path = path.absolute()
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return path.as_posix()


# reading


class _Reader(Fields):
    """Turns parsed JSON into a project. Every method raises InputError for unexpected content."""

    def __init__(self, path: Path, allowed: bool) -> None:
        super().__init__(path, "project")
        self.folder = path.parent.resolve()
        self.allowed = allowed
        self.outside: list[Path] = []
        """Paths outside the project's folder, in the order in which the file names them."""

    def project(self, raw: Any) -> Project:
        fields = self.table(raw, "the file")
        version = fields.get("fruitninja")
        if type(version) is not int:
            raise InputError(f"{self.path}: not a project: it has no 'fruitninja' version")
        if not FIRST_FORMAT <= version <= FORMAT:
            raise InputError(f"{self.path}: version {version}, this app reads {FORMAT}; update the app")
        scene = self.file(fields, "scene")
        if version <= SINGLE_FORMAT:
            older = {"number": 0, "name": "", "visible": True, "isolation": [], "marked": []}
            if version == FIRST_FORMAT:
                fields = {key: value for key, value in fields.items() if key not in ("isolation", "marked")}
            documents: tuple[Document, ...] = (self.document(older | fields, scene),)
        else:
            documents = self.each(fields, "objects", lambda raw: self.document(self.table(raw, "an object"), scene))
            self.require(1 <= len(documents) <= MOST_OBJECTS, f"it has not 1 to {MOST_OBJECTS} objects")
            numbers = {document.number for document in documents}
            self.require(len(numbers) == len(documents), "two objects have the same number")
        film = read_timeline(self, {"film": []} | fields)  # not in older projects
        return Project(documents, self.viewing(self.table(fields.get("view"), "'view'")), film)

    def document(self, fields: dict[str, Any], scene: Path | None) -> Document:
        cuts = self.each(fields, "cuts", self.cut)
        self.require(len({cut.id for cut in cuts}) == len(cuts), "two cuts have the same id")
        known = {cut.id for cut in cuts}
        keys = [part.scope for cut in cuts for part in cut.parts]
        placements = self.each(fields, "pieces", self.placement)
        keys += [key for key, _ in placements]
        self.require(all(step in known for key in keys for step, _ in key), "a piece names a cut that is not there")
        self.require(len(dict(placements)) == len(placements), "a piece is listed twice")
        families = self.each(
            fields, "families", lambda raw: read_family(self, raw, lambda name: self.inside(name, "'exemplars'"))
        )
        self.require(len({f.kind for f in families}) == len(families), "a family is listed twice")
        return Document(
            scene=scene,
            up=self.unit(fields, "up"),
            isolation=read_isolation(self, fields.get("isolation")),
            selection=read_selection(self, fields.get("marked")),
            cuts=cuts,
            placements=tuple(sorted(placements, key=lambda item: item[0])),
            families=families,
            training=self.training(self.table(fields.get("training"), "'training'")),
            gap=self.number(fields, "gap", 0, 2),
            explode=self.number(fields, "explode", 0, 2),
            number=self.integer(fields, "number", 0),
            name=self.text(fields, "name"),
            visible=self.flag(fields, "visible"),
        )

    def cut(self, raw: Any) -> Cut:
        fields = self.table(raw, "a cut")
        parts = self.each(fields, "parts", self.part)
        self.require(len(parts) > 0, "a cut has no plane")
        return Cut(
            id=self.integer(fields, "id", 1),
            name=self.text(fields, "name"),
            parts=parts,
            kind=self.choice(fields, "kind", get_args(CutKind)),
            shift=self.number(fields, "shift"),
            on=self.flag(fields, "on"),
        )

    def part(self, raw: Any) -> Part:
        fields = self.table(raw, "a part of a cut")
        walls = self.each({"walls": []} | fields, "walls", lambda wall: read_plane(self, wall))  # not in older projects
        return Part(read_plane(self, fields.get("plane")), self.key(fields.get("scope")), walls)

    def placement(self, raw: Any) -> tuple[Key, Placement]:
        fields = self.table(raw, "a piece")
        w, x, y, z = self.numbers(fields.get("turn"), 4, "'turn'")
        a, b, c = self.numbers(fields.get("shift"), 3, "'shift'")
        self.require(abs(math.hypot(w, x, y, z) - 1) < 1e-6, "'turn' of a piece has not length 1")
        motion = Motion((w, x, y, z), (a, b, c))
        fields = {"group": "", "mark": ""} | fields  # not in older projects
        placement = Placement(
            motion,
            self.flag(fields, "visible"),
            self.flag(fields, "removed"),
            self.text(fields, "name"),
            self.text(fields, "group"),
            self.choice(fields, "mark", ("", *MARKS)),
        )
        return self.key(fields.get("key")), placement

    def training(self, fields: dict[str, Any]) -> Training:
        iterations = fields.get("iterations")
        return Training(
            detail=self.choice(fields, "detail", get_args(DetailName)),
            prior=self.choice(fields, "prior", get_args(PriorName)),
            seed=self.integer(fields, "seed", 0),
            iterations=None if iterations is None else self.integer(fields, "iterations", 0, MOST_ITERATIONS),
            out=self.file(fields, "out"),
            model=self.file(fields, "model"),
            thing=self.text(fields, "thing"),
            same=self.flag({"same": False} | fields, "same"),  # older projects do not have it
        )

    def viewing(self, fields: dict[str, Any]) -> Viewing:
        background = fields.get("background")
        colour = None
        if background is not None:
            r, g, b = self.numbers(background, 3, "'background'")
            self.require(min(r, g, b) >= 0 and max(r, g, b) <= 1, "'background' is outside [0, 1]")
            colour = (r, g, b)
        eye = read_eye(self, fields)
        older = {"slices": False, "cross": None, "unit": {"name": "units", "length": 1.0}, "timeline": False}
        older |= {"film_look": look_record(FilmLook()), "splats": {"size": 1.0, "opacity": 1.0}}
        fields = older | fields
        cross, unit = fields["cross"], self.table(fields["unit"], "'unit'")
        if cross is not None:
            x, y, z = self.numbers(cross, 3, "'cross'")
            cross = (x, y, z)
        length = self.number(unit, "length", *LENGTHS)
        splats = self.table(fields["splats"], "'splats'")
        return Viewing(
            eye,
            self.choice(fields, "mode", VIEW_MODES),
            colour,
            self.flag(fields, "slices"),
            cross,
            Unit(self.choice(unit, "name", UNITS), length),
            self.flag(fields, "timeline"),
            read_look(self, fields["film_look"]),
            SplatLook(self.number(splats, "size", *SPLAT_SIZES), self.number(splats, "opacity", 0, 1)),
        )

    # values

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
        """The path; added to `outside` if it leaves the project's folder by dots, by being absolute, or by a link."""
        path = Path(os.path.normpath(self.folder / self.path_text(value, what)))
        if not path.is_relative_to(self.folder):
            self.outside.append(path)  # not looked up: on Windows that may log in to a server
            return path
        try:
            real = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:  # a ValueError for an impossible name
            raise InputError(f"{self.path}: not a project: {what} is no path") from error
        if not real.is_relative_to(self.folder):
            self.outside.append(path)
        return path
