"""SuperSplat's compressed .ply: four 32-bit words per Gaussian, relative to the bounds of a chunk of 256."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.ply_header import Element, Header
from engine.io.splats.rows import (
    COLOUR,
    GEOMETRY,
    gaussians_from_rows,
    logits,
    read_rows,
    row_blocks,
    stride_for,
)
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh

__all__ = ["is_compressed", "read_compressed_ply", "with_largest"]

Words = NDArray[np.uint32]
Double = NDArray[np.float64]

CHUNK = 256
"""Gaussians that share a row of bounds."""

PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
REST_COUNTS = (9, 24, 45)
REST_RANGE = 8.0
"""Width of the interval around 0 into which SH above degree 0 are packed."""


def is_compressed(header: Header) -> bool:
    """Whether the vertices are packed."""
    vertex = header.element("vertex")
    return vertex is not None and not set(PACKED).isdisjoint(vertex.properties)


def read_compressed_ply(path: Path, header: Header, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of a compressed .ply, and one line about each kind of row that had to be dropped.

    `header` has been checked against the size of the file, so its counts may be allocated. With `most`, at most that
    many, evenly chosen, with SH of degree 0. Raises InputError if an element is missing or of another type, or if the
    counts do not match.
    """
    tables = _elements(path, header)
    vertex, chunk, rest = tables["vertex"], tables["chunk"], tables.get("sh")
    n = vertex.count
    if not n:
        raise InputError(f"{path}: the scene is empty, it has 0 Gaussians")
    if chunk.count != -(-n // CHUNK):
        raise InputError(f"{path}: damaged: {n:,} Gaussians need {-(-n // CHUNK):,} chunks, it has {chunk.count:,}")
    if rest is not None and rest.count != n:
        raise InputError(f"{path}: damaged: it has {n:,} Gaussians but spherical harmonics of {rest.count:,}")
    rest = rest if most is None else None
    stride = stride_for(n, most)
    columns = len(GEOMETRY) + len(COLOUR) + (0 if rest is None else len(rest.dtype.names or ()))
    with open_file(path) as file:
        bounds = chunk.read(path, file, range(chunk.count))
        blocks = (
            _block(
                vertex.read(path, file, rows),
                bounds[np.arange(rows.start, rows.stop, rows.step) // CHUNK],
                None if rest is None else rest.read(path, file, rows),
            )
            for rows in row_blocks(n, stride)
        )
        return gaussians_from_rows(path, blocks, -(-n // stride), columns)


def _block(vertex: NDArray[np.void], chunk: NDArray[np.void], rest: NDArray[np.void] | None) -> NDArray[np.float32]:
    """(R, 14 + SH above degree 0). Rows as in a .ply, from packed rows, the chunk of each, and their SH if any."""
    names = () if rest is None else rest.dtype.names or ()
    table = np.empty((len(vertex), len(GEOMETRY) + len(COLOUR) + len(names)), np.float32)
    colours = _bytes(vertex["packed_color"])
    # Chunks may hold anything; `gaussians_from_rows` drops what makes no sense.
    with np.errstate(over="ignore", invalid="ignore"):
        table[:, :3] = _between(chunk, "{}_x {}_y {}_z", _elevens(vertex["packed_position"]))
        table[:, 3] = logits(colours[:, 3])
        table[:, 4:7] = _between(chunk, "{}_scale_x {}_scale_y {}_scale_z", _elevens(vertex["packed_scale"]))
        table[:, 7:11] = _quaternions(vertex["packed_rotation"])
        if "min_r" in (chunk.dtype.names or ()):
            table[:, 11:14] = rgb_to_sh(_between(chunk, "{}_r {}_g {}_b", colours[:, :3]))
        else:
            table[:, 11:14] = rgb_to_sh(colours[:, :3])
    if rest is not None:
        for i, name in enumerate(names):
            table[:, 14 + i] = _rest(rest[name])
    return table


@dataclass(frozen=True)
class _Table:
    """Where the rows of an element are."""

    name: str
    count: int
    dtype: np.dtype[np.void]
    offset: int
    """Offset of its first row, bytes."""

    def read(self, path: Path, file: BinaryIO, rows: range) -> NDArray[np.void]:
        """These rows. Raises InputError if the file ends within them."""
        table = read_rows(file, self.offset, self.dtype, rows)
        if len(table) < len(rows):
            raise InputError(f"{path}: truncated: it ends within the rows of '{self.name}'")
        return table


def _elements(path: Path, header: Header) -> dict[str, _Table]:
    """The tables 'chunk', 'vertex' and, if present, 'sh', with the properties that the format requires."""
    if header.ascii:
        raise InputError(f"{path}: a compressed .ply must be binary; export the scene again")
    corners = [f"{end}_{what}" for end in ("min", "max") for what in ("x", "y", "z", "scale_x", "scale_y", "scale_z")]
    wanted: dict[str, tuple[list[str], str]] = {"chunk": (corners, "f4"), "vertex": (list(PACKED), "u4")}
    sh = header.element("sh")
    if sh is not None:
        wanted["sh"] = ([f"f_rest_{i}" for i in range(len(sh.properties))], "u1")
        if len(sh.properties) not in REST_COUNTS:
            raise InputError(f"{path}: {len(sh.properties)} 'f_rest' properties; SH of degree 1 to 3 has 9, 24 or 45")
    chunk = header.element("chunk")
    if chunk is not None and "min_r" in chunk.properties:
        corners += [f"{end}_{what}" for end in ("min", "max") for what in "rgb"]
    tables = {}
    offset = header.data
    for element in header.elements:
        if element.dtype is None:
            raise InputError(f"{path}: '{element.name}' holds lists, which no compressed .ply has; export it again")
        if element.name in wanted and element.name not in tables:
            tables[element.name] = _table(path, element, offset, *wanted[element.name])
        offset += element.count * element.dtype.itemsize
    for name in wanted:
        if name not in tables:
            raise InputError(f"{path}: no '{name}' element; this compressed .ply is not whole")
    return tables


def _table(path: Path, element: Element, offset: int, names: list[str], kind: str) -> _Table:
    """Where an element's rows are. Raises InputError if a property is missing or of another type."""
    assert element.dtype is not None
    for name in names:
        if name not in element.properties:
            raise InputError(f"{path}: no '{name}' property in '{element.name}'; this compressed .ply is not whole")
        if element.dtype[name].str[1:] != kind:
            raise InputError(f"{path}: '{name}' is not of the type that a compressed .ply has; export the scene again")
    return _Table(element.name, element.count, element.dtype, offset)


def _between(chunk: NDArray[np.void], names: str, parts: Double) -> Double:
    """(N, 3). Interpolates by `parts` (N, 3) between the two ends of each Gaussian's chunk (N,)."""
    low, high = (
        np.stack([chunk[name] for name in names.format(*[end] * 3).split()], 1).astype(np.float64)
        for end in ("min", "max")
    )
    return low + (high - low) * parts


def _elevens(words: Words) -> Double:
    """(N, 3). Range [0, 1]. Three numbers of 11, 10 and 11 bits, the first in the highest bits."""
    return np.stack([(words >> 21) / 2047, ((words >> 11) & 1023) / 1023, (words & 2047) / 2047], 1)


def _bytes(words: Words) -> Double:
    """(N, 4). Range [0, 1]. Four bytes, the first in the highest bits."""
    return np.stack([(words >> shift & 255) / 255 for shift in (24, 16, 8, 0)], 1)


def _quaternions(words: Words) -> Double:
    """(N, 4), wxyz. Two bits name the largest component; ten bits each hold the others, in +-1 / sqrt(2)."""
    largest = (words >> 30).astype(np.intp)
    others = np.stack([((words >> shift & 1023) / 1023 - 0.5) * np.sqrt(2) for shift in (20, 10, 0)], 1)
    return with_largest(largest, others)


def with_largest(largest: NDArray[np.intp], others: Double) -> Double:
    """(N, 4). Unit quaternions from the index of the largest component (N,), which is positive, and the rest (N, 3)."""
    quats = np.empty((len(others), 4))
    places = np.array([[j for j in range(4) if j != i] for i in range(4)])
    np.put_along_axis(quats, places[largest], others, axis=1)
    rest = np.sqrt(np.maximum(1 - (others**2).sum(1), 0))
    np.put_along_axis(quats, largest[:, None], rest[:, None], axis=1)
    return quats


def _rest(packed: NDArray[np.uint8]) -> Double:
    """(N,). Coefficients from bytes: the middle of each of 256 steps, but the outer end of the first and the last."""
    parts = (packed + 0.5) / 256
    parts[packed == 0], parts[packed == 255] = 0.0, 1.0
    return (parts - 0.5) * REST_RANGE
