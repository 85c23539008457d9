"""mkkellogg's .ksplat files: sections of rows, at full precision or at half with places relative to buckets."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.splats.rows import BLOCK_ROWS, gaussians_from_rows, log_sizes, logits, read_rows, stride_for
from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh

__all__ = ["read_ksplat"]

HEADER = struct.Struct("<BBxxI4x4xIH10x4x2f")
"""Version, number of section headers, number of Gaussians, compression, range of SH bytes. The section count and the
greatest number of Gaussians are skipped: writers leave them at 0."""

HEADER_BYTES, SECTION_BYTES = 4096, 1024

SECTION = struct.Struct("<4IfH2xI4x2IH")
"""Gaussians, room for Gaussians, Gaussians in a full bucket, buckets, side of a bucket, bytes of a bucket's centre,
steps to half of the side, full buckets, other buckets, SH degree."""

PLACES = ("<f4", "<u2", "<u2")
FLOATS = ("<f4", "<f2", "<f2")
SH = ("<f4", "<f2", "u1")
"""Types of places, of sizes and rotations, and of spherical harmonics, at each compression."""

SH_RANGE = (-1.5, 1.5)
"""Range that bytes of SH span if the header states none."""

MOST_DEGREE = 3


@dataclass(frozen=True)
class _Section:
    base: int
    """Bytes from the start of the file to its first row."""
    count: int
    degree: int
    buckets: NDArray[np.int64]
    """(B,). The first row of each bucket."""
    centres: NDArray[np.float32]
    """(B, 3). World units."""
    step: float
    """World units per step of a place."""
    zero: int
    """Number of steps that stands for a bucket's centre."""


def read_ksplat(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of a .ksplat, and one line about each kind of row that had to be dropped.

    With `most`, at most that many, evenly chosen, with SH of degree 0. Raises InputError for another version, and if
    the file is damaged or shorter than it says.
    """
    path = Path(path)
    with open_file(path) as file:
        size = os.fstat(file.fileno()).st_size
        head = file.read(HEADER.size)
        if len(head) < HEADER.size or size < HEADER_BYTES:
            raise InputError(f"{path}: truncated, or no .ksplat; copy or export it again")
        major, minor, headers, _, compression, low, high = HEADER.unpack(head)
        if (major, minor) != (0, 1):
            raise InputError(f"{path}: .ksplat version {major}.{minor}; version 0.1 can be opened: convert it again")
        if compression >= len(PLACES):
            raise InputError(f"{path}: damaged: its header holds numbers that no .ksplat has")
        sections = list(_sections(path, file, size, headers, compression))
        count = sum(section.count for section in sections)
        if not count:
            raise InputError(f"{path}: there are no Gaussians in it")
        degree = max(section.degree for section in sections) if most is None else 0
        span = (low, high) if low < high else SH_RANGE
        stride = stride_for(count, most)
        blocks = _blocks(file, sections, compression, degree, span, stride)
        return gaussians_from_rows(path, blocks, -(-count // stride), 14 + 3 * ((degree + 1) ** 2 - 1))


def _row(compression: int, degree: int) -> np.dtype[np.void]:
    """Type of a section's rows."""
    return np.dtype(
        [
            ("means", PLACES[compression], 3),
            ("scales", FLOATS[compression], 3),  # standard deviations
            ("quat", FLOATS[compression], 4),  # wxyz
            ("rgba", "u1", 4),
            ("sh", SH[compression], 3 * ((degree + 1) ** 2 - 1)),
        ]
    )


def _sections(path: Path, file: BinaryIO, size: int, headers: int, compression: int) -> Iterator[_Section]:
    """The sections that have rows. Raises InputError if the file is damaged or too short for them."""
    short = InputError(f"{path}: truncated: it is shorter than it says; copy or export it again")
    base = HEADER_BYTES + SECTION_BYTES * headers
    if base > size:
        raise short
    for k in range(headers):
        file.seek(HEADER_BYTES + SECTION_BYTES * k)
        fields = SECTION.unpack(file.read(SECTION.size))
        count, room, full_size, buckets, side, centre_bytes, steps, full, partial, degree = fields
        if degree > MOST_DEGREE or count > room or full + partial > buckets or (buckets and centre_bytes < 12):
            raise InputError(f"{path}: damaged: its header holds numbers that no .ksplat has")
        first = base + 4 * partial + centre_bytes * buckets
        end = first + _row(compression, degree).itemsize * room
        if end > size:
            raise short
        if compression and count and (not full + partial or not steps or (full and not full_size)):
            raise InputError(f"{path}: damaged: its places are relative to nothing")
        file.seek(base)
        lengths = np.frombuffer(file.read(4 * partial), "<u4").astype(np.int64)
        centres = np.frombuffer(file.read(centre_bytes * buckets), np.uint8).reshape(buckets, centre_bytes)
        starts = np.concatenate([np.arange(full, dtype=np.int64) * full_size, full * full_size + _before(lengths)])
        if count:
            places = np.ascontiguousarray(centres[: full + partial, :12]).view("<f4")
            yield _Section(first, count, degree, starts, places, side / 2 / max(steps, 1), steps)
        base = end


def _before(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each length, the sum of those before it."""
    return np.cumsum(lengths) - lengths


def _blocks(
    file: BinaryIO,
    sections: list[_Section],
    compression: int,
    degree: int,
    span: tuple[float, float],  # of SH bytes
    stride: int,
) -> Iterator[NDArray[np.float32]]:
    """Every `stride`-th row of all sections, in blocks of rows as in a .ply."""
    passed = 0
    for section in sections:
        dtype = _row(compression, section.degree)
        for first in range(-passed % stride, section.count, BLOCK_ROWS * stride):
            chosen = range(first, min(first + BLOCK_ROWS * stride, section.count), stride)
            rows = read_rows(file, section.base, dtype, chosen)
            table = np.empty((len(rows), 14 + 3 * ((degree + 1) ** 2 - 1)), np.float32)
            table[:, :3] = _places(rows["means"], np.asarray(chosen), section) if compression else rows["means"]
            table[:, 3] = logits(rows["rgba"][:, 3] / 255)
            table[:, 4:7] = log_sizes(rows["scales"].astype(np.float32))
            table[:, 7:11] = rows["quat"]
            table[:, 11:14] = rgb_to_sh(rows["rgba"][:, :3] / 255)
            values = rows["sh"] / np.float32(255) * (span[1] - span[0]) + span[0] if compression == 2 else rows["sh"]
            table[:, 14:] = _by_channel(values.astype(np.float32), section.degree, degree)
            yield table
        passed += section.count


def _places(steps: NDArray[np.uint16], rows: NDArray[np.int64], section: _Section) -> NDArray[np.float64]:
    """(R, 3). Places of rows (R,) from their steps (R, 3)."""
    bucket = np.searchsorted(section.buckets, rows, side="right") - 1
    return (steps.astype(np.float64) - section.zero) * section.step + section.centres[bucket]


def _by_channel(values: NDArray[np.float32], degree: int, wanted: int) -> NDArray[np.float32]:
    """(R, 3 K). SH of a degree reordered from band by band, channel by channel in each, to a .ply's: channel by channel
    over all bands of the wanted degree. What it lacks of these is 0."""
    table, first = np.zeros((len(values), 3, (wanted + 1) ** 2 - 1), np.float32), 0
    for band in range(1, min(degree, wanted) + 1):
        width = 2 * band + 1
        table[:, :, band * band - 1 :][..., :width] = values[:, first : first + 3 * width].reshape(-1, 3, width)
        first += 3 * width
    return table.reshape(len(values), -1)
