"""Gaussians in glTF files: the extension `KHR_gaussian_splatting`, as ratified and as in its drafts."""

from __future__ import annotations

import base64
import binascii
import io
import os
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.gltf_tree import BINARY_CHUNK, GAUSSIANS, extensions, read_tree, rows
from engine.io.splats.gltf_nodes import Placement, placements
from engine.io.splats.rows import gaussians_from_rows, log_sizes, logits, row_blocks, stride_for
from engine.light import as_srgb
from engine.scene.gaussians import Gaussians
from engine.scene.moved import rotated_quats, sh_rotation
from engine.scene.sh import basis

__all__ = ["holds_gaussians", "read_gltf"]

MOST = 10_000_000
"""Most Gaussians, as in an .spz: the nodes of a short file can place its points any number of times."""

MOST_DEGREE = 3

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}

UNPACKED = ("KHR_mesh_quantization", GAUSSIANS)
"""Extensions that a file may require: numbers of any type are read."""

SRGB, LINEAR = "srgb_rec709_display", "lin_rec709_display"

MOST_DAMAGED = 0.05
"""Share of Gaussians with a size below 0 from which all sizes are logarithms; fewer are damaged ones."""

LOOKS = 128
"""Number of directions in which a linear colour is turned into sRGB: eight times the unknowns of degree 3."""


def holds_gaussians(path: Path) -> bool:
    """Whether a glTF file holds Gaussians and no faces. Raises InputError if it is damaged."""
    tree, _ = read_tree(path)
    found = [primitive for mesh in rows(tree, "meshes") for primitive in rows(mesh, "primitives")]
    splats = [GAUSSIANS in extensions(primitive) for primitive in found]
    faces = any(primitive.get("mode", 4) in (4, 5) for primitive, splat in zip(found, splats, strict=True) if not splat)
    return any(splats) and not faces


def read_gltf(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of a .glb or .gltf where its nodes place them, and a line on each thing that was changed.

    Sizes below zero, which only drafts of the extension had, are logarithms. Linear colours become sRGB: exactly, or as
    closely as spherical harmonics of the same degree can. With `most`, at most that many, evenly chosen, with SH of
    degree 0. Raises InputError if the file is damaged or packed, and for a node that mirrors or stretches.
    """
    path = Path(path)
    tree, after = read_tree(path)
    _refuse_packed(path, tree)
    with ExitStack() as opened:
        buffers = _Buffers(path, tree, after, opened)
        fields: list[_SplatPrimitive] = []
        known: dict[int, _SplatPrimitive] = {}
        for place in placements(path, tree):
            shared = known.get(id(place.primitive))
            field = _SplatPrimitive.of(path, tree, buffers, place) if shared is None else replace(shared, place=place)
            known[id(place.primitive)] = field
            fields.append(field)
        count = sum(field.count for field in fields)
        if not count:
            raise InputError(f"{path}: the scene is empty, it has 0 Gaussians")
        if count > MOST:
            raise InputError(f"{path}: {count:,} Gaussians where its nodes place them; the most is {MOST:,}")
        degree = max(field.degree for field in fields) if most is None else 0
        stride = stride_for(count, most)
        starts = np.cumsum([0, *(field.count for field in fields)])
        chosen = [
            range(int(-start % stride), field.count, stride) for field, start in zip(fields, starts, strict=False)
        ]
        below = [(field.scales.read(part) < 0).any(1) for field in fields for part in row_blocks(field.count, stride)]
        logs = bool(np.concatenate(below).mean() > MOST_DAMAGED)
        blocks = (
            field.table(part, degree, logs)
            for field, rows_ in zip(fields, chosen, strict=True)
            for part in _blocks(rows_)
        )
        columns = 14 + 3 * ((degree + 1) ** 2 - 1)
        gaussians, lines = gaussians_from_rows(path, blocks, sum(map(len, chosen)), columns, wide=True)
    warnings = [f"{path}: sizes below 0, as drafts of {GAUSSIANS} had them, are read as logarithms"] if logs else []
    spaces = {field.space for field in fields}
    if LINEAR in spaces:
        warnings.append(f"{path}: its linear colours are turned into sRGB; blended ones differ a little")
    for space in sorted(spaces - {SRGB, LINEAR}):
        warnings.append(f"{path}: colour space {space[:40]!r} is not known; its numbers are taken for sRGB")
    return gaussians, [*warnings, *lines]


def _blocks(chosen: range) -> Iterator[range]:
    """The rows of a range, in blocks."""
    for part in row_blocks(len(chosen)):
        yield chosen[part.start : part.stop]


def _refuse_packed(path: Path, tree: dict[str, Any]) -> None:
    """Raises InputError if the file needs an extension that is not read here."""
    required, used = (
        {name for name in names if isinstance(name, str)} if isinstance(names := tree.get(key), list) else set()
        for key in ("extensionsRequired", "extensionsUsed")
    )
    required |= {name for name in used if "compression" in name}  # some exporters forget to list it as required
    unknown = sorted(name for name in required if name not in UNPACKED and not name.startswith("KHR_materials_"))
    if unknown:
        names = ", ".join(unknown)[:80]
        raise InputError(f"{path}: its Gaussians need {names}, which cannot be read; export it without")


class _Buffers:
    """The bytes of a glTF's buffers: in the file, in its JSON, or in files beside it."""

    def __init__(self, path: Path, tree: dict[str, Any], after: int, opened: ExitStack) -> None:
        self.path, self.after, self.opened = path, after, opened
        self.buffers = rows(tree, "buffers")
        self.open: dict[int, tuple[BinaryIO, int, int]] = {}

    def span(self, index: int) -> tuple[BinaryIO, int, int]:
        """The file that a buffer is in, where it begins there, and its length in bytes."""
        if index not in self.open:
            self.open[index] = self._span(index)
        return self.open[index]

    def _span(self, index: int) -> tuple[BinaryIO, int, int]:
        uri = self.buffers[index].get("uri")
        if uri is None:
            file = self.opened.enter_context(open_file(self.path))
            size = os.fstat(file.fileno()).st_size
            file.seek(self.after)
            head = np.frombuffer(file.read(8), "<u4")
            if index or not self.after or len(head) < 2 or head[1] != BINARY_CHUNK:
                raise _damaged(self.path)
            return file, self.after + 8, min(int(head[0]), size - self.after - 8)
        if not isinstance(uri, str):
            raise _damaged(self.path)
        if uri.startswith("data:"):
            try:
                data = base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error as error:
                raise _damaged(self.path) from error
            return io.BytesIO(data), 0, len(data)
        name = unquote(uri)
        if Path(name).name != name or "\\" in name or "\0" in name:
            raise InputError(f"{self.path}: damaged: it names a file in another folder")
        if not self.path.with_name(name).is_file():
            raise InputError(f"{self.path}: its file '{' '.join(name.split())[:80]}' is missing; put it beside it")
        file = self.opened.enter_context(open_file(self.path.with_name(name)))
        return file, 0, os.fstat(file.fileno()).st_size


@dataclass(frozen=True)
class _Column:
    """The rows of one attribute."""

    file: BinaryIO
    start: int
    """Offset of the first row, bytes."""
    stride: int
    """Bytes from row to row."""
    dtype: np.dtype[Any]
    width: int
    scale: float
    """Divisor of the numbers: the largest of their type if they are normalised, else 1."""
    count: int

    @staticmethod
    def of(path: Path, tree: dict[str, Any], buffers: _Buffers, index: Any, kinds: tuple[str, ...]) -> _Column:
        """The column of an accessor of one of these types. Raises InputError unless all of its rows are there."""
        accessor = rows(tree, "accessors")[_index(index)]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError(f"{path}: sparse or empty arrays, which cannot be read here; export it again without")
        view = rows(tree, "bufferViews")[_index(accessor["bufferView"])]
        if extensions(view):
            raise InputError(f"{path}: its arrays are packed by {next(iter(extensions(view)))[:40]}; export it without")
        dtype, kind = np.dtype(COMPONENTS[accessor["componentType"]]), accessor["type"]
        if kind not in kinds:
            raise ValueError(kind)
        width, count = WIDTHS[kind], _index(accessor["count"])
        size = dtype.itemsize * width
        stride = _index(view.get("byteStride", size))
        offset, within, length = (
            _index(x) for x in (view.get("byteOffset", 0), accessor.get("byteOffset", 0), view["byteLength"])
        )
        file, base, end = buffers.span(_index(view["buffer"]))
        if stride < size or (count and within + stride * (count - 1) + size > length) or offset + length > end:
            raise InputError(f"{path}: truncated or damaged: {count:,} Gaussians are promised, it ends before them")
        scale = float(np.iinfo(dtype).max) if accessor.get("normalized") is True and dtype.kind != "f" else 1.0
        return _Column(file, base + offset + within, stride, dtype, width, scale, count)

    def read(self, part: range) -> NDArray[np.float64]:
        """(R, width). These rows."""
        size = self.dtype.itemsize * self.width
        if part.step == 1 and len(part):
            self.file.seek(self.start + part.start * self.stride)
            data = self.file.read(self.stride * (len(part) - 1) + size).ljust(self.stride * len(part), b"\0")
            cells = np.frombuffer(data, np.uint8).reshape(len(part), self.stride)[:, :size]
        else:
            found = []
            for row in part:
                self.file.seek(self.start + row * self.stride)
                found.append(self.file.read(size))
            cells = np.frombuffer(b"".join(found), np.uint8).reshape(len(part), size)
        with np.errstate(invalid="ignore"):  # of a signalling nan, which files may hold too
            values = np.ascontiguousarray(cells).view(self.dtype).astype(np.float64) / self.scale
        return np.maximum(values, -1) if self.scale > 1 else values  # -128 and -127 both mean -1


@dataclass(frozen=True)
class _SplatPrimitive:
    """The Gaussians of one primitive, where a node places them."""

    places: _Column
    turns: _Column
    scales: _Column
    opacities: _Column
    sh: tuple[_Column, ...]
    """One column for each coefficient."""
    space: str
    """Colour space."""
    place: Placement

    @property
    def count(self) -> int:
        return self.places.count

    @property
    def degree(self) -> int:
        return round(len(self.sh) ** 0.5) - 1

    @staticmethod
    def of(path: Path, tree: dict[str, Any], buffers: _Buffers, place: Placement) -> _SplatPrimitive:
        """The field of a primitive. Raises InputError if it lacks something, or is damaged."""
        attributes = place.primitive.get("attributes")
        look = extensions(place.primitive)[GAUSSIANS]
        if not isinstance(attributes, dict) or not isinstance(look, dict):
            raise _damaged(path)
        if extensions(look):
            raise InputError(
                f"{path}: its Gaussians are kept as {next(iter(extensions(look)))[:60]}; export it without"
            )

        def column(name: str, *kinds: str) -> _Column:
            if name not in attributes:
                raise InputError(f"{path}: no '{name}' of its Gaussians; export the capture again")
            return _Column.of(path, tree, buffers, attributes[name], kinds)

        try:
            degree = 0
            while degree < MOST_DEGREE and f"{GAUSSIANS}:SH_DEGREE_{degree + 1}_COEF_0" in attributes:
                degree += 1
            names = [f"SH_DEGREE_{d}_COEF_{k}" for d in range(degree + 1) for k in range(2 * d + 1)]
            field = _SplatPrimitive(
                column("POSITION", "VEC3"),
                column(f"{GAUSSIANS}:ROTATION", "VEC4"),
                column(f"{GAUSSIANS}:SCALE", "VEC3"),
                column(f"{GAUSSIANS}:OPACITY", "SCALAR"),
                tuple(column(f"{GAUSSIANS}:{name}", "VEC3") for name in names),
                str(look.get("colorSpace", SRGB)),
                place,
            )
        except InputError:  # it is a ValueError, too
            raise
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise _damaged(path) from error
        if any(c.count != field.count for c in (field.turns, field.scales, field.opacities, *field.sh)):
            raise InputError(f"{path}: damaged: its arrays are of different lengths; export it again")
        return field

    def table(self, part: range, degree: int, logs: bool) -> NDArray[np.float64]:
        """(R, 14 + 3 ((d+1)^2 - 1)). Rows as in a .ply, in the world's axes."""
        bands = (degree + 1) ** 2
        table = np.zeros((len(part), 14 + 3 * (bands - 1)))
        place, quats = self.place, self.turns.read(part)[:, [3, 0, 1, 2]]
        sizes = self.scales.read(part)
        with np.errstate(all="ignore"):  # files may hold anything; `gaussians_from_rows` drops nonsense
            table[:, :3] = self.places.read(part) @ place.linear.T + place.shift
            table[:, 3] = logits(np.clip(self.opacities.read(part)[:, 0], 0, 1))
            table[:, 4:7] = (sizes if logs else log_sizes(sizes)) + np.log(place.factor)
            table[:, 7:11] = rotated_quats(quats, place.rotation)
            sh = np.zeros((len(part), bands, 3))
            for k, coefficient in enumerate(self.sh[:bands]):
                sh[:, k] = coefficient.read(part)
            if self.space == LINEAR:
                sh = _display(sh, min(degree, self.degree))
            if degree:
                sh = np.einsum("jk,nkc->njc", sh_rotation(place.rotation, degree), sh)
        table[:, 11:14] = sh[:, 0]
        table[:, 14:] = sh[:, 1:].transpose(0, 2, 1).reshape(len(part), -1)  # channel-major
        return table


def _display(sh: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """(N, K, 3). Turns spherical harmonics of linear colours into those of sRGB, by least squares over
    directions; exact for degree 0."""
    directions = np.random.default_rng(0).normal(size=(LOOKS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    if not degree:
        directions = directions[:1]
    looks, used = basis(directions, degree), (degree + 1) ** 2
    linear = np.maximum(0.5 + np.einsum("dk,nkc->ndc", looks, sh[:, :used]), 0)
    result = sh.copy()
    result[:, :used] = np.einsum("kd,ndc->nkc", np.linalg.pinv(looks), as_srgb(linear) - 0.5)
    return result


def _index(value: Any) -> int:
    """The value, if it is an integer of at least 0. Raises ValueError otherwise."""
    if type(value) is not int or value < 0:
        raise ValueError(value)
    return value


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: damaged: its Gaussians cannot be found in it; copy or export it again")
