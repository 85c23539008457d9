"""3DGS scenes in .ply files: reads any dialect, writes INRIA's layout.

In the file opacity is a logit and scales are logs; in memory they are activated (`Gaussians`).
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from engine.errors import InputError
from engine.io.files import atomic, open_file
from engine.io.ply_header import Element, Header, read_header
from engine.io.splats.compressed_ply import is_compressed, read_compressed_ply
from engine.io.splats.rows import (
    BLOCK_ROWS,
    COLOUR,
    FLATNESS,
    GEOMETRY,
    gaussians_from_rows,
    logits,
    read_rows,
    row_blocks,
    stride_for,
)
from engine.scene.gaussians import Gaussians

__all__ = ["ply_data", "read_ply", "write_ply"]

REST_COUNTS = {0: 0, 9: 1, 24: 2, 45: 3, 72: 4}
"""SH degree of each possible number of f_rest properties, 3 ((d+1)^2 - 1)."""

MOST_RESTS = 45
"""Number of f_rest properties of degree 3, the highest that is drawn."""

THIRD_SCALE = "scale_2"
"""Property that captures of discs (2D Gaussian Splatting) lack."""

FILTER = "filter_3D"
"""Property of captures by Mip-Splatting that are not fused: the standard deviation, world units, of the filter that is
still to be applied to a Gaussian."""

MAX_LOGIT = 16.6
"""Logit of the largest float32 opacity below 1, 1 - 2^-24. Infinite logits break other viewers."""


def read_ply(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of any 3DGS .ply, and one line about each kind of row that had to be dropped.

    SH degree 0..4 (4 is cut to 3), with or without normals and other properties and elements; ascii or binary of
    either endianness; SuperSplat's compressed form too. The discs of 2D Gaussian Splatting are taken as thin Gaussians,
    and those of Mip-Splatting through the filter that they were trained with. With `most`, at most that many, evenly
    chosen, with SH of degree 0. `gaussians_from_rows` says what is dropped. Raises InputError if the file is no 3DGS
    scene or has no usable row.
    """
    path = Path(path)
    header = read_header(path)
    if is_compressed(header):
        return read_compressed_ply(path, header, most)
    vertex = _scene_element(path, header)
    stride = stride_for(vertex.count, most)
    rest = _rest_count(path, vertex) if most is None else 0
    kept, each = min(rest, MOST_RESTS) // 3, rest // 3  # per channel; channels follow one another
    rests = [f"f_rest_{channel * each + i}" for channel in range(3) for i in range(kept)]
    names = [*GEOMETRY, *COLOUR, *rests]
    columns = [name for name in (*names, FILTER) if name in vertex.properties]
    # Map coordinates have more digits than float32: they keep their precision until the scene is moved.
    wide = header.ascii or _wide(vertex, names[:3])
    with open_file(path) as file:
        blocks = (_completed(block, columns) for block in _blocks(path, file, header, vertex, columns, stride))
        gaussians, warnings = gaussians_from_rows(path, blocks, -(-vertex.count // stride), len(names), wide)
    if kept < each:
        warnings.append(f"{path}: spherical harmonics of degree {REST_COUNTS[rest]} cut down to degree 3")
    return gaussians, warnings


def write_ply(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Writes INRIA's layout (binary little endian, with zero normals), which every 3DGS viewer opens.

    f_rest is channel-major: all red coefficients, then green, then blue. Opacities are clamped to [6e-8, 1 - 6e-8],
    so that their logits are finite. Comments become single ASCII lines. Raises InputError if writing fails.
    """
    data = ply_data(gaussians, comments)
    with atomic(path) as temporary:
        data.write(str(temporary))


def ply_data(gaussians: Gaussians, comments: Sequence[str] = ()) -> PlyData:
    """The content of the file that `write_ply` writes."""
    n, rest = len(gaussians), gaussians.sh[:, 1:].shape[1]
    names = ["x", "y", "z", "nx", "ny", "nz", *COLOUR, *(f"f_rest_{i}" for i in range(3 * rest)), *GEOMETRY[3:]]
    table = np.empty((n, len(names)), np.float32)
    table[:, 0:3] = gaussians.means
    table[:, 3:6] = 0
    table[:, 6:9] = gaussians.sh[:, 0]
    table[:, 9 : 9 + 3 * rest] = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(n, 3 * rest)
    table[:, -8] = np.clip(logits(gaussians.opacities.astype(np.float64)), -MAX_LOGIT, MAX_LOGIT)
    table[:, -7:-4] = np.log(gaussians.scales.astype(np.float64))
    table[:, -4:] = gaussians.quats
    rows = table.view(np.dtype([(name, "<f4") for name in names])).reshape(n)
    lines = [" ".join(c.split()).encode("ascii", "backslashreplace").decode("ascii") for c in comments]
    return PlyData([PlyElement.describe(rows, "vertex")], text=False, byte_order="<", comments=lines)


def _scene_element(path: Path, header: Header) -> Element:
    """The element that holds the Gaussians. Raises InputError if the file holds something else."""
    vertex = header.element("vertex")
    if vertex is None:
        raise InputError(f"{path}: no 'vertex' element; this is not a 3DGS scene")
    # Properties that only 3DGS has come first: if one is missing, it shows what the file is instead.
    needed = [name for name in (*GEOMETRY[4:], *COLOUR, *GEOMETRY[:4]) if name not in vertex.properties]
    if needed and needed != [THIRD_SCALE]:
        missing = needed[0]
        kind = "an incomplete" if header.is_splats else "a mesh, not a" if header.faces else "a point cloud, not a"
        raise InputError(f"{path}: no '{missing}' property; this is {kind} 3DGS scene")
    if vertex.dtype is None:
        raise InputError(f"{path}: a vertex property is a list, which no 3DGS scene has; export the scene again")
    if not vertex.count:
        raise InputError(f"{path}: the scene is empty, it has 0 Gaussians")
    return vertex


def _completed(block: NDArray[np.floating], columns: Sequence[str]) -> NDArray[np.floating]:
    """(R, C'). A block (R, C) of these columns as rows of Gaussians: with a third scale, and without a filter."""
    if THIRD_SCALE not in columns:
        third = GEOMETRY.index(THIRD_SCALE)
        block = np.insert(block, third, block[:, third - 2 : third].min(1) + np.log(FLATNESS), 1)
    return _filtered(block) if columns[-1] == FILTER else block


def _filtered(block: NDArray[np.floating]) -> NDArray[np.floating]:
    """(R, C - 1). Rows (R, C) of Gaussians after the filter in their last column: convolved with a Gaussian of that
    standard deviation, as much of them as before (Yu et al. 2024, Mip-Splatting, the 3D smoothing filter)."""
    rows, opacity, scales = block[:, :-1].copy(), GEOMETRY.index("opacity"), slice(4, 7)
    log_scales = block[:, scales].astype(np.float64)
    with np.errstate(all="ignore"):  # files may hold anything; `gaussians_from_rows` drops what makes no sense
        wide = np.logaddexp(2 * log_scales, 2 * np.log(block[:, -1:].astype(np.float64))) / 2
        left = np.exp((log_scales - wide).sum(1)) / (1 + np.exp(-block[:, opacity].astype(np.float64)))
        rows[:, opacity], rows[:, scales] = logits(left), wide
    return rows


def _rest_count(path: Path, vertex: Element) -> int:
    """Number of f_rest properties. Raises InputError if they fit no SH degree."""
    found = {name for name in vertex.properties if name.startswith("f_rest_")}
    missing = next((i for i in range(len(found)) if f"f_rest_{i}" not in found), None)
    if missing is not None:
        raise InputError(f"{path}: {len(found)} 'f_rest' properties, but no 'f_rest_{missing}'; export the scene again")
    if len(found) not in REST_COUNTS:
        raise InputError(
            f"{path}: {len(found)} 'f_rest' properties, where SH of degree 0 to 4 has 0, 9, 24, 45 or 72; "
            "export the scene again"
        )
    return len(found)


def _blocks(
    path: Path, file: BinaryIO, header: Header, vertex: Element, names: list[str], stride: int
) -> Iterator[NDArray[np.floating]]:
    """The named columns of every `stride`-th row of the vertex element in blocks (R, len(names)).

    Raises InputError if the file ends early.
    """
    before = header.elements[: header.elements.index(vertex)]
    filled = 0
    if header.ascii:
        file.seek(header.data)
        columns = [vertex.properties.index(name) for name in names]
        for lines in _ascii_blocks(path, file, sum(e.count for e in before), vertex.count, columns, stride):
            filled += len(lines)
            yield lines
    else:
        assert vertex.dtype is not None
        file.seek(header.data)
        for element in before:
            if element.dtype is None:
                _skip_lists(path, file, element)
            else:
                file.seek(element.count * element.dtype.itemsize, os.SEEK_CUR)
        offset = file.tell()
        for rows in row_blocks(vertex.count, stride):
            block = _columns(read_rows(file, offset, vertex.dtype, rows), names)
            filled += len(block)
            yield block
    if filled < -(-vertex.count // stride):
        there = filled * stride
        raise InputError(f"{path}: truncated: the header promises {vertex.count:,} Gaussians, {there:,} are there")


def _wide(vertex: Element, names: Sequence[str]) -> bool:
    """Whether one of these properties of a binary file needs more than float32."""
    assert vertex.dtype is not None
    return np.result_type(np.float32, *(vertex.dtype[name] for name in names)) != np.float32


def _columns(rows: NDArray[np.void], names: list[str]) -> NDArray[np.floating]:
    """(R, len(names)). These fields of structured rows, float64 if any of them is."""
    block = np.empty((len(rows), len(names)), np.result_type(np.float32, *(rows.dtype[name] for name in names)))
    for i, name in enumerate(names):
        block[:, i] = rows[name]
    return block


def _skip_lists(path: Path, file: BinaryIO, element: Element) -> None:
    """Skips the binary rows of an element that has lists. No memory is allocated for the length of a list."""
    for _ in range(element.count):
        for length, value in element.layout:
            items = 1
            if length is not None:
                data = file.read(length.itemsize)
                if len(data) < length.itemsize:
                    raise InputError(f"{path}: truncated or damaged: it ends within the rows of '{element.name}'")
                items = int(np.frombuffer(data, length)[0])
                if items < 0:
                    raise InputError(f"{path}: damaged: a list in '{element.name}' has a negative length")
            file.seek(items * value.itemsize, os.SEEK_CUR)


def _ascii_blocks(
    path: Path, file: BinaryIO, skip: int, count: int, columns: list[int], stride: int
) -> Iterator[NDArray[np.float64]]:
    """These columns of every `stride`-th of `count` lines after the first `skip`; blank lines do not count."""
    lines = (line for line in file if not line.isspace())
    next(itertools.islice(lines, skip, skip), None)
    chosen = itertools.islice(lines, 0, count, stride)
    while block := list(itertools.islice(chosen, BLOCK_ROWS)):
        try:
            yield np.loadtxt(block, np.float64, comments=None, usecols=columns, ndmin=2, encoding="latin-1")
        except ValueError as error:
            raise InputError(f"{path}: truncated or damaged: a row does not hold the numbers it should") from error
