"""Saves and loads a trained object: a .ply that every 3DGS viewer opens, and a sidecar with what a .ply cannot hold.

A compact object has an .spz in place of the .ply, at a tenth of its size.

`apple.ply` holds the surface atoms, then the interior ones; `apple.fruitninja.json` holds their numbers and how the
object was made. `apple.inside.safetensors`, where there is one, holds the inside as a function, finer than the atoms.
The sidecar identifies both by size and checksum, so that neither a crash between the files nor a mix-up of names joins
parts of different objects.
"""

from __future__ import annotations

import json
import math
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save_file

from engine.errors import InputError
from engine.io.files import atomic_together, open_file, read_file, remove
from engine.io.splats.ply import ply_data, read_ply
from engine.io.splats.spz import MOST, read_spz
from engine.io.splats.spz_sizes import refined_sizes, size_remainders
from engine.io.strict_json import parse
from engine.io.writers.solid_gaussians import ATOM_OPACITY
from engine.io.writers.spz import spz_bytes, spz_unit
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.inside import InsideRecord
from engine.scene.moved import moved
from engine.scene.sh import sh_to_rgb

__all__ = [
    "COMPACT",
    "FORMAT",
    "STANDARD",
    "Meta",
    "find_trained",
    "inside_path",
    "is_trained",
    "load_inside_record",
    "load_trained",
    "provenance",
    "save_trained",
    "sidecar_path",
    "trained_isolation",
]

FORMAT = 1
"""Version of the sidecar. A reader refuses any other, so every change of meaning must increase it."""

STANDARD, COMPACT = ".ply", ".spz"
"""The two forms of an object: the sidecar names the size and the checksum of one."""

FACTS = "facts"
"""Name of the array with an inside's facts, as JSON."""

INSIDE_LIMIT = 1 << 27
"""Most bytes of an inside: forty pictures and their layout."""

SIDECAR_LIMIT = 1 << 24
"""Most bytes of a sidecar; a real one has a few KB, that of a compact object up to a byte an atom."""


@dataclass(frozen=True)
class Meta:
    """How an object was made, as plain data, so that `engine` does not depend on `training`."""

    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Unit vector, world axes."""
    families: tuple[dict[str, Any], ...] = ()
    """The families of cut planes that were trained, each as a JSON object."""
    seed: int = 0
    prior: str = ""
    """Name of the prior that made the labels."""
    source: str = ""
    """Name of the file that the object was made from."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the object's zero in that file's coordinates (engine.io.origin). Old sidecars have none."""
    isolation: tuple[Any, ...] = ()
    """Parts of that file that are left out of the object, as `engine.isolate.record` writes them. Old sidecars have
    none."""


def sidecar_path(path: str | Path) -> Path:
    """The path of a trained object's sidecar: `apple.ply` and `apple.spz` have `apple.fruitninja.json`."""
    return Path(path).with_suffix(".fruitninja.json")


def inside_path(path: str | Path) -> Path:
    """The path of a trained object's inside: `apple.ply` has `apple.inside.safetensors`."""
    return Path(path).with_suffix(".inside.safetensors")


def is_trained(path: str | Path) -> bool:
    """Whether a scene's file is a trained object: the sidecar beside it is for its form, .ply or .spz.

    An object and its capture may lie in one folder, as apple.ply and apple.spz.
    """
    path = Path(path)
    if not sidecar_path(path).exists() or path.suffix.lower() not in (STANDARD, COMPACT):
        return False
    try:
        compact = "spz_bytes" in _Record(sidecar_path(path), path).fields
    except InputError:
        compact = False  # loading the .ply will say what is wrong with it
    return compact == _is_compact(path)


def find_trained(folder: Path, stem: str) -> Path | None:
    """The object of this name in a folder, in either form; None if there is none."""
    paths = (folder / f"{stem}{suffix}" for suffix in (STANDARD, COMPACT))
    return next((path for path in paths if path.is_file() and is_trained(path)), None)


def save_trained(path: str | Path, atoms: Atoms, meta: Meta, inside: InsideRecord | None = None) -> None:
    """Writes `path`, a .ply or an .spz, its sidecar and its inside, all or nothing. All are complete on disk before the
    first is replaced. Without an inside, one that was there is removed, and so is the object's other form.

    Surface atoms come first; interior ones are spheres whose SH above degree 0 are zero. An .spz is rounded as
    `engine.io.writers.spz` says, except for its sizes, whose remainders are in the sidecar. Raises InputError if
    writing fails.
    """
    path = Path(path)
    gaussians = atoms.as_gaussians(ATOM_OPACITY)
    broken = [name for name, values in vars(gaussians).items() if not np.isfinite(values).all()]
    assert not broken, f"NaN or Inf in the atoms' {broken}"
    assert (gaussians.scales > 0).all(), "scales that are not above 0"
    kind, unit, compact = _kind(path), 1.0, _is_compact(path)
    if compact:
        if len(gaussians) > MOST:
            raise InputError(f"{path}: {len(gaussians):,} Gaussians; an .spz holds {MOST:,} at most: save a .ply")
        unit = spz_unit(gaussians)
        packed = spz_bytes(moved(gaussians, np.eye(3), factor=1 / unit))
    else:
        data = ply_data(gaussians, provenance(meta))
    other = _other_form(path)
    more = [] if inside is None else [inside_path(path)]
    with atomic_together(path, sidecar_path(path), *more) as (scene, sidecar, *function):
        if compact:
            scene.write_bytes(packed)
        else:
            data.write(str(scene))
        record = {
            "format": FORMAT,
            f"{kind}_bytes": scene.stat().st_size,
            f"{kind}_crc32": _crc(scene),
            "surface": len(atoms.surface),
            "interior": len(atoms.interior),
            "pitch": float(atoms.pitch),
            "up": [float(v) for v in meta.up],
            "families": list(meta.families),
            "seed": meta.seed,
            "prior": meta.prior,
            "source": meta.source,
        }
        if compact:
            record["sizes"] = size_remainders(np.concatenate(_sizes(gaussians, len(atoms.surface))) / unit)
        if unit != 1:
            record["unit"] = unit
        if inside is not None:
            arrays, facts = inside
            text = np.frombuffer(json.dumps(facts, allow_nan=False).encode(), np.uint8)
            save_file({name: np.ascontiguousarray(a) for name, a in arrays.items()} | {FACTS: text}, function[0])
            record |= {"inside_bytes": function[0].stat().st_size, "inside_crc32": _crc(function[0])}
        if any(meta.origin):
            record["origin"] = [float(v) for v in meta.origin]
        if meta.isolation:
            record["isolation"] = list(meta.isolation)
        sidecar.write_text(json.dumps(record, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    if inside is None:
        remove(inside_path(path))
    if other is not None:
        remove(other)


def _is_compact(path: Path) -> bool:
    return path.suffix.lower() == COMPACT


def _kind(path: Path) -> str:
    """Name of the object's form in the sidecar."""
    return "spz" if _is_compact(path) else "ply"


def _other_form(path: Path) -> Path | None:
    """The file of the object's other form, if the sidecar belongs to it; any other file of that name is kept."""
    other = path.with_suffix(STANDARD if _is_compact(path) else COMPACT)
    try:
        if other.is_file() and _Record(sidecar_path(other), other).is_of(other):
            return other
    except InputError:
        pass
    return None


def load_trained(path: str | Path) -> tuple[Atoms, Meta]:
    """The object that `save_trained` wrote.

    Raises InputError if the file is unreadable, or if its sidecar is missing, malformed or belongs to another file.
    """
    path = Path(path)
    with open_file(path):  # a missing scene is reported before its missing sidecar
        pass
    record = _Record(sidecar_path(path), path)
    surface, interior = (record.count(key) for key in ("surface", "interior"))
    exposed = record.count("exposed") if "exposed" in record.fields else 0
    pitch = record.number("pitch")
    up = record.vector("up")
    meta = Meta(
        up,
        tuple(record.of("families", list)),
        record.count("seed"),
        record.of("prior", str),
        record.of("source", str),
        record.vector("origin") if "origin" in record.fields else (0.0, 0.0, 0.0),
        record.isolation(),
    )
    record.require(pitch > 0, "'pitch' is not above 0")
    record.require(exposed <= interior, "'exposed' is more than 'interior'")
    record.require(abs(math.hypot(*up) - 1) < 1e-3, "'up' has not length 1")
    record.require(all(isinstance(f, dict) for f in meta.families), "'families' holds something else than families")
    unit = record.number("unit") if "unit" in record.fields else 1.0
    record.require(1e-30 < unit < 1e30, "'unit' is no length")
    if not record.is_of(path):
        raise InputError(f"{path}: its sidecar {record.path.name} belongs to another file; train the object again")
    gaussians, _ = read_spz(path) if _is_compact(path) else read_ply(path)
    record.require(len(gaussians) == surface + interior, f"its counts are not those of the .{_kind(path)}")
    if "sizes" in record.fields:
        gaussians = record.refined(gaussians, surface)
    if unit != 1:
        gaussians = moved(gaussians, np.eye(3), factor=unit)
    if any(gaussians.origin):  # an older object, trained far from zero
        x, y, z = (a + b for a, b in zip(meta.origin, gaussians.origin, strict=True))
        meta = replace(meta, origin=(x, y, z))
    surface += exposed  # an older object: its first interior atoms are seen through holes of its skin
    outer, inner = gaussians[:surface], gaussians[surface:]
    return (
        Atoms(
            SurfaceAtoms(outer.means, outer.scales, outer.quats, outer.sh),
            InteriorAtoms(
                inner.means,
                np.ascontiguousarray(inner.scales[:, 0]),
                np.minimum(sh_to_rgb(inner.sh[:, 0]), 1).astype(np.float32),
            ),
            pitch,
        ),
        meta,
    )


def load_inside_record(path: str | Path) -> InsideRecord | None:
    """The record of a trained object's inside; None if it has none or was moved without it.

    Raises InputError if the file is unreadable or belongs to another object.
    """
    path, file = Path(path), inside_path(path)
    record = _Record(sidecar_path(path), path)
    if "inside_crc32" not in record.fields or not file.exists():
        return None
    data = read_file(file, INSIDE_LIMIT)
    if len(data) != record.count("inside_bytes") or zlib.crc32(data) != record.count("inside_crc32"):
        raise InputError(f"{file}: damaged, or of another object than {path.name}; delete it, or train again")
    try:
        arrays = load(data)
        facts = parse(arrays.pop(FACTS).tobytes())
    except (SafetensorError, KeyError, ValueError) as error:
        raise InputError(f"{file}: not the inside of a trained object; delete it, or train again") from error
    return arrays, facts if isinstance(facts, dict) else {}


def trained_isolation(path: Path) -> tuple[Any, ...]:
    """`Meta.isolation` of a trained object, without reading the object. Raises InputError without a valid sidecar."""
    return _Record(sidecar_path(path), path).isolation()


def provenance(meta: Meta) -> list[str]:
    """Comment lines for users of other viewers: the object's source, and the shift back to its coordinates."""
    comments = [f"FruitNinja: made from {meta.source}"] if meta.source else []
    if any(meta.origin):
        comments.append("FruitNinja: add {:.12g} {:.12g} {:.12g} to be back in its coordinates".format(*meta.origin))
    return comments


def _sizes(gaussians: Gaussians, surface: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(3 S,) and (I,). The sizes of the surface's atoms, and of the interior's, which are spheres."""
    return gaussians.scales[:surface].ravel(), gaussians.scales[surface:, 0]


def _crc(path: Path) -> int:
    """CRC-32 of a file, read a megabyte at a time."""
    crc = 0
    with open_file(path) as file:
        while block := file.read(1 << 20):
            crc = zlib.crc32(block, crc)
    return crc


class _Record:
    """The typed fields of a sidecar. Raises InputError with the file's name for a missing or wrong one."""

    def __init__(self, path: Path, ply: Path) -> None:
        self.path = path
        if not path.exists():
            raise InputError(
                f"{ply}: no {path.name} beside it; this is no trained object, or its sidecar was left behind"
            )
        with open_file(path) as file:
            text = file.read(SIDECAR_LIMIT + 1)
        self.require(len(text) <= SIDECAR_LIMIT, "it is far too large")
        try:
            self.fields = parse(text)
        except ValueError as error:
            raise InputError(f"{path}: not a sidecar of a trained object: it is no JSON") from error
        self.require(isinstance(self.fields, dict) and "format" in self.fields, "it has no 'format'")
        if self.fields["format"] != FORMAT:
            raise InputError(f"{path}: format {str(self.fields['format'])[:20]!r}, this version reads {FORMAT}")

    def require(self, condition: bool, wrong: str) -> None:
        """Raises InputError if the condition does not hold."""
        if not condition:
            raise InputError(f"{self.path}: not a sidecar of a trained object: {wrong}")

    def is_of(self, path: Path) -> bool:
        """Whether the file has the size and the checksum of the sidecar's object."""
        kind = _kind(path)
        return path.stat().st_size == self.count(f"{kind}_bytes") and _crc(path) == self.count(f"{kind}_crc32")

    def refined(self, gaussians: Gaussians, surface: int) -> Gaussians:
        """The object with its rounded sizes refined by the sidecar; the first `surface` Gaussians are its surface."""
        try:
            sizes = refined_sizes(np.concatenate(_sizes(gaussians, surface)), self.of("sizes", str))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{self.path}: not a sidecar of a trained object: 'sizes' is damaged") from error
        outer, inner = np.split(sizes, [3 * surface])
        return replace(gaussians, scales=np.concatenate([outer.reshape(-1, 3), np.repeat(inner[:, None], 3, axis=1)]))

    def of(self, key: str, kind: type) -> Any:
        """The field, which must be exactly of this type."""
        self.require(type(self.fields.get(key)) is kind, f"no '{key}' of type {kind.__name__}")
        return self.fields[key]

    def count(self, key: str) -> int:
        """The field, an integer of at least 0."""
        value = self.of(key, int)
        self.require(value >= 0, f"'{key}' is negative")
        return value

    def number(self, key: str) -> float:
        """The field, a finite number."""
        return self._finite(key, self.fields.get(key))

    def vector(self, key: str) -> tuple[float, float, float]:
        """The field, three finite numbers."""
        values = self.of(key, list)
        self.require(len(values) == 3, f"'{key}' has not three numbers")
        x, y, z = (self._finite(key, value) for value in values)
        return x, y, z

    def isolation(self) -> tuple[Any, ...]:
        """The selections that were left out of the capture; none in an older object."""
        return tuple(self.of("isolation", list)) if "isolation" in self.fields else ()

    def _finite(self, key: str, value: Any) -> float:
        number = type(value) in (int, float) and abs(value) < 1e300  # false for NaN, and for integers beyond floats
        self.require(number, f"'{key}' is not a finite number")
        return float(value)
