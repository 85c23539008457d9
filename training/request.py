"""The request of a training run, its file, and the geometry that every run fixes first.

A request file is JSON with every field of `Request`, as `Request.to_json` writes it: the desktop app starts the trainer
with one, and `fruitninja-train --request` runs it. Its paths are absolute.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.fields import UNIT_TOLERANCE, Fields
from engine.io.files import open_file, read_file
from engine.io.strict_json import parse
from engine.io.trained import COMPACT, STANDARD
from engine.isolate.record import isolation_record, read_isolation
from engine.isolate.selection import Isolation
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.plane import Plane
from training.faces.marks import Marks, axis_beside, marks_record, mask_beside, read_marks
from training.families import MAX_PLANES, Family, Kind
from training.settings import DETAILS, Detail, DetailName

__all__ = [
    "Geometry",
    "Interrupted",
    "PriorName",
    "Request",
    "family_record",
    "read_family",
    "read_plane",
    "read_request",
]

PriorName = Literal["exemplar", "stable-diffusion"]

FORMAT = 8
"""Version of the checkpoints, raised with every change to them so that no run resumes from one of another version."""

FILE_VERSION = 5
"""Version of request files. Any other is refused, so it is raised with every change of meaning."""

LIMIT = 1 << 20
"""Bytes of the largest request file that is read; a real one has a few KB."""

MOST_ITERATIONS = 1_000_000
"""More than a run can do in a year."""


class Interrupted(Exception):
    """The user stopped the run; what was done is kept."""


@dataclass(frozen=True)
class Request:
    """Everything that decides the result of a run."""

    scene: Path
    families: tuple[Family, ...]
    detail: DetailName = "standard"
    up: tuple[float, float, float] | None = None
    """None: detected."""
    seed: int = 0
    iterations: int | None = None
    """Most iterations; None: as the detail says, or none where the inside is known as a function."""
    prior: PriorName = "exemplar"
    model: Path | None = None
    """Folder of the diffusion model, for `stable-diffusion`."""
    midas: Path | None = None
    """Folder of a depth estimator whose depth `stable-diffusion` takes in addition to the exact one."""
    thing: str | None = None
    """What the object is called in prompts; None: the name of the scene's file."""
    isolation: Isolation = ()
    """What to leave out of the scene because it is no part of the object; () for nothing."""
    same: bool = False
    """Whether the pictures are known to show one and the same thing; `exemplar` then believes them where they meet."""
    compact: bool = False
    """Whether the result is an .spz, a tenth of a .ply's size."""

    @property
    def result_name(self) -> str:
        """Name of the trained object's file in the result's folder."""
        return f"{self.scene.stem}{COMPACT if self.compact else STANDARD}"

    @property
    def files(self) -> list[Path]:
        """The scene, all pictures, and the masks and axes beside them."""
        pictures = [path for family in self.families for path in family.exemplars]
        beside = [found(path) for found in (mask_beside, axis_beside) for path in pictures]
        return [self.scene, *pictures, *filter(None, beside)]

    @property
    def fineness(self) -> Detail:
        """The numbers behind the detail's name."""
        return DETAILS[self.detail]

    def fingerprint(self) -> str:
        """Hash of the input's content and all settings except the result's file format.

        Equal requests give the same object.
        """
        digest = hashlib.sha256(f"{FORMAT}".encode())
        for path in self.files:
            # By name as well: a mask or an axis is of the picture that it is called like.
            digest.update(f"/{path.name}/".encode(errors="surrogateescape"))
            with open_file(path) as file:
                hashlib.file_digest(file, lambda: digest)  # updates this digest
        for folder in filter(None, (self.model, self.midas)):
            for path in sorted(folder.rglob("*.safetensors")):  # gigabytes: size and time stand in for the content
                digest.update(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}".encode())
        settings = asdict(self)
        del settings["compact"]  # the same object in another file format: a stopped run may end as either
        # Paths by their names alone: their content is in the digest, wherever they lie.
        digest.update(json.dumps(settings, sort_keys=True, default=attrgetter("name")).encode())
        return digest.hexdigest()[:16]

    def to_json(self) -> str:
        """The content of a request file, with absolute paths; `read_request` gives an equal request."""
        record = {
            "fruitninja_request": FILE_VERSION,
            "scene": _absolute(self.scene),
            "families": [family_record(family, _absolute) for family in self.families],
            "detail": self.detail,
            "up": self.up,
            "seed": self.seed,
            "iterations": self.iterations,
            "prior": self.prior,
            "model": _absolute(self.model),
            "midas": _absolute(self.midas),
            "thing": self.thing,
            "isolation": isolation_record(self.isolation),
            "same": self.same,
            "compact": self.compact,
        }
        return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _absolute(path: Path | None) -> str | None:
    return None if path is None else str(path.absolute())


def family_record(family: Family, path_text: Callable[[Path], str | None]) -> dict[str, Any]:
    """A family as JSON; `path_text` writes the paths of its pictures. Project files have the same form."""
    return {
        "kind": family.kind,
        "count": family.count,
        "exemplars": [path_text(exemplar) for exemplar in family.exemplars],
        "prompt": family.prompt,
        "axis": family.axis,
        "range": family.span,
        "planes": [[*plane.normal, plane.offset] for plane in family.custom],
        "marks": [{"picture": path_text(path)} | marks_record(marks) for path, marks in family.marks],
    }


def read_family(reader: Fields, value: Any, read_path: Callable[[Any], Path]) -> Family:
    """The family in a `family_record`. Raises InputError if the record is not valid."""
    record = reader.table(value, "a family")
    kind: Kind = reader.choice(record, "kind", get_args(Kind))
    planes = reader.each(record, "planes", lambda plane: read_plane(reader, plane))
    exemplars = reader.each(record, "exemplars", read_path)
    count = reader.integer(record, "count", 0, MAX_PLANES)
    prompt, axis = reader.text(record, "prompt"), reader.unit(record, "axis")
    low, high = reader.numbers(record.get("range", [0.0, 1.0]), 2, "'range'")  # older projects have none

    def marked(value: Any) -> tuple[Path, Marks]:
        entry = reader.table(value, "a picture's marks")
        path = read_path(entry.get("picture"))
        reader.require(path in exemplars, "marks belong to none of the family's pictures")
        return path, read_marks(reader, entry)

    marks = reader.each({"marks": []} | record, "marks", marked)  # older projects have none
    reader.require(len(dict(marks)) == len(marks), "a picture's marks are listed twice")
    try:
        return Family(kind, count, exemplars, prompt, axis, planes, (low, high), marks)
    except InputError as error:
        raise InputError(f"{reader.path}: not a {reader.kind}: {error}") from error


def read_plane(reader: Fields, value: Any) -> Plane:
    """The plane given as a list a, b, c, d, with a normal of length 1."""
    a, b, c, d = reader.numbers(value, 4, "a plane")
    reader.require(abs(math.hypot(a, b, c) - 1) < UNIT_TOLERANCE, "the normal of a plane has not length 1")
    return Plane((a, b, c), d)


def read_request(path: Path) -> Request:
    """The request in a file. Raises InputError in one line for anything but exactly what `Request.to_json` writes.

    Whether the files that it names exist is not checked here.
    """
    raw = read_file(path, LIMIT)
    reader = Fields(path, "request")
    try:
        value = parse(raw)
    except ValueError as error:
        raise InputError(f"{path}: not a request: it is no JSON") from error
    record = reader.table(value, "the file")
    version = record.get("fruitninja_request")
    reader.require(type(version) is int, "it has no 'fruitninja_request' version")
    if version != FILE_VERSION:
        raise InputError(f"{path}: version {version}, this trainer reads {FILE_VERSION}; update FruitNinja")
    known = {"fruitninja_request", *(field.name for field in fields(Request))}
    reader.require(record.keys() == known, f"its fields are not exactly {', '.join(sorted(known))}")

    def absolute(name: Any, what: str) -> Path:
        result = Path(reader.path_text(name, what))
        reader.require(result.is_absolute(), f"{what} is no absolute path")
        return result

    def optional(key: str) -> Path | None:
        return None if record[key] is None else absolute(record[key], f"'{key}'")

    families = reader.each(
        record, "families", lambda entry: read_family(reader, entry, lambda name: absolute(name, "'exemplars'"))
    )
    reader.require(len(families) > 0, "it has no family")
    reader.require(len({family.kind for family in families}) == len(families), "a family is listed twice")
    request = Request(
        scene=absolute(record["scene"], "'scene'"),
        families=families,
        detail=reader.choice(record, "detail", get_args(DetailName)),
        up=reader.unit(record, "up"),
        seed=reader.integer(record, "seed", 0),
        iterations=None if record["iterations"] is None else reader.integer(record, "iterations", 0, MOST_ITERATIONS),
        prior=reader.choice(record, "prior", get_args(PriorName)),
        model=optional("model"),
        midas=optional("midas"),
        thing=None if record["thing"] is None else reader.text(record, "thing"),
        isolation=read_isolation(reader, record["isolation"]),
        same=reader.flag(record, "same"),
        compact=reader.flag(record, "compact"),
    )
    if request.prior == "exemplar":
        reader.require(not (request.model or request.midas), "'model' and 'midas' belong to prior stable-diffusion")
        reader.require(any(family.exemplars for family in families), "no family has a picture")
    return request


@dataclass(frozen=True)
class Geometry:
    """The part of a run's input that no prior changes."""

    gaussians: Gaussians
    """The capture, without what is not part of the object."""
    skin: SurfaceAtoms
    """Surface atoms in the capture's own colours."""
    pitch: float
    """Pitch of the skin, world units."""
    enclosed: Body
    """What the walls of the capture enclose: the skin is fitted above its core."""
    body: Body
    """The same, out to the front that the skin's atoms show: what is filled."""
    up: NDArray[np.float64]
    """(3,). Unit vector."""

    def filled(self, interior: InteriorAtoms) -> Atoms:
        """The whole object, filled with these interior atoms."""
        return Atoms(self.skin, interior, self.pitch)
