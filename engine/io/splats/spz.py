"""Niantic's .spz files, versions 1 to 4: quantised, attribute by attribute; gzipped, or each packed by zstd."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import SEEK_END
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.splats.compressed_ply import with_largest
from engine.io.splats.rows import gaussians_from_rows, logits, row_blocks, stride_for
from engine.scene.gaussians import Gaussians
from engine.scene.sh import basis

__all__ = ["COLOUR_SCALE", "FLIP", "GZIP", "HEADER", "MAGIC", "MOST", "TABLE_AT", "flipped_bands", "read_spz"]

GZIP = b"\x1f\x8b"
"""First bytes of a gzipped file."""

MAGIC = b"NGSP"
"""First bytes of an .spz once it is unpacked; of version 4, which is packed inside, as it is."""

HEADER = struct.Struct("<4sIIBBBB")
"""Magic, version, count, SH degree, fractional bits of positions, flags, and a byte: the number of streams in version
4, 0 before."""

TABLE_AT = struct.Struct("<16xQ8x")
"""A header of version 4 goes on with the offset of the table of contents, which has the packed and the unpacked bytes
of each stream. The streams follow the table."""

POSITIONS = {1: 6, 2: 9, 3: 9, 4: 9}
"""Bytes of a position, by version: half floats in version 1, else fixed point."""

ROTATIONS = {1: 3, 2: 3, 3: 4, 4: 4}
"""Bytes of a rotation, by version."""

WIDEST = 1 << 27
"""Widest window of a zstd stream, bytes, as in zstd's own program: a reader keeps that much in memory."""

MOST = 10_000_000
"""Most Gaussians, as in Niantic's own reader. A few kilobytes of gzip could claim any number."""

EXTENDED = 2
"""Flag: other programs' private data follow the Gaussians."""

BLOCK = 1 << 20
"""Compressed bytes read at once."""

ATTRIBUTES = ("places", "opacities", "colours", "sizes", "rotations", "spherical harmonics")
"""The attributes in file order, each for all Gaussians."""

DEGREES = (0, 9, 24, 45, 72)
"""Bytes of a Gaussian's SH above degree 0, by degree."""

COLOUR_SCALE = 0.15
"""A byte of colour spans 1 / 0.15 of the degree-0 coefficient, with its middle at 0."""

FLIP = np.array([1.0, -1.0, -1.0])
"""An .spz has axes right, up, back; the usual .ply of a capture has right, down, forward."""


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    bits: int
    """Fractional bits of positions."""
    flags: int
    streams: int
    """0 before version 4."""

    def sizes(self, with_sh: bool) -> tuple[int, ...]:
        """Bytes of each of a Gaussian's attributes."""
        return POSITIONS[self.version], 1, 3, 3, ROTATIONS[self.version], DEGREES[self.degree] if with_sh else 0


def read_spz(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of an .spz in the axes of a .ply, and a line on each thing left out.

    With `most`, at most that many, evenly chosen, with SH of degree 0; the other SH are not even unpacked. Raises
    InputError for other versions, and if the file is damaged or does not hold what its header promises. Memory grows
    with the data that are there, never with the header's counts.
    """
    path = Path(path)
    with open_file(path) as file:
        start = file.read(HEADER.size)
        file.seek(0)
        if start[:4] == MAGIC and len(start) == HEADER.size and HEADER.unpack(start)[1] >= 4:
            header = _header(path, start)
            attributes = _streams(path, file, header, header.sizes(most is None))
        else:
            pieces = _inflated(path, file) if start[:2] == GZIP else iter(lambda: file.read(BLOCK), b"")
            first = next(pieces, b"")
            header = _header(path, first)
            if header.version >= 4:
                raise InputError(f"{path}: an .spz of version {header.version} that is gzipped; unpack it with gunzip")
            pieces = chain([first[HEADER.size :]], pieces)
            attributes = _one_after_another(path, pieces, header, header.sizes(most is None), most is None)
    kept, stride = (min(header.degree, 3) if most is None else 0), stride_for(header.count, most)
    blocks = (
        _table([a[rows.start : rows.stop : rows.step] for a in attributes], header, kept)
        for rows in row_blocks(header.count, stride)
    )
    columns = 14 + 3 * ((kept + 1) ** 2 - 1)
    gaussians, warnings = gaussians_from_rows(path, blocks, -(-header.count // stride), columns)
    if most is None and kept < header.degree:
        warnings.append(f"{path}: spherical harmonics of degree {header.degree} cut down to degree {kept}")
    return gaussians, warnings


def _header(path: Path, start: bytes) -> _Header:
    """The unpacked header. Raises InputError if its numbers are impossible."""
    if start[:4] != MAGIC:
        other = "a .ply" if start[:3] == b"ply" else "something else"
        raise InputError(f"{path}: not an .spz scene; it is gzipped, but {other} is in it; unpack it with gunzip")
    if len(start) < HEADER.size:
        raise InputError(f"{path}: truncated: it ends within its header; copy or export it again")
    header = _Header(*HEADER.unpack_from(start)[1:])
    if header.version not in POSITIONS:
        raise InputError(
            f"{path}: .spz version {header.version}; versions 1 to 4 can be opened, export it as one of them"
        )
    streams_fit = header.streams >= 5 + (header.degree > 0) if header.version >= 4 else header.streams == 0
    if header.degree >= len(DEGREES) or header.bits > 23 or not streams_fit:
        raise InputError(f"{path}: damaged: its header holds numbers that no .spz has")
    if not 0 < header.count <= MOST:
        raise InputError(f"{path}: {header.count:,} Gaussians; an .spz holds from 1 to {MOST:,}")
    return header


def _one_after_another(
    path: Path, pieces: Iterator[bytes], header: _Header, sizes: tuple[int, ...], to_the_end: bool
) -> list[NDArray[np.uint8]]:
    """(count, size) each. The attributes of a version before 4."""
    data, promised = bytearray(), header.count * sum(sizes)
    for block in pieces:
        data += block
        if not to_the_end and len(data) >= promised:
            break
        if len(data) > promised and not header.flags & EXTENDED:
            raise InputError(f"{path}: damaged: there is more in it than the {header.count:,} Gaussians it promises")
    if len(data) < promised:
        raise _too_short(path, header, int(np.searchsorted(np.cumsum(sizes) * header.count, len(data), side="right")))
    parts = np.split(np.frombuffer(data, np.uint8, promised), np.cumsum(sizes)[:-1] * header.count)
    return [part.reshape(header.count, -1) for part in parts]


def _streams(path: Path, file: BinaryIO, header: _Header, sizes: tuple[int, ...]) -> list[NDArray[np.uint8]]:
    """(count, size) each. The attributes of version 4, each a zstd frame."""
    end = file.seek(0, SEEK_END)
    file.seek(0)
    start = file.read(TABLE_AT.size)
    at = TABLE_AT.unpack(start)[0] if len(start) == TABLE_AT.size else end
    table = struct.Struct(f"<{2 * header.streams}Q")
    if at + table.size > end:
        raise InputError(f"{path}: truncated: it ends within its table of contents; copy or export it again")
    file.seek(at)
    numbers = table.unpack(file.read(table.size))
    attributes, place = [], at + table.size
    for what, (size, packed, unpacked) in enumerate(zip(sizes, numbers[::2], numbers[1::2], strict=False)):
        if size and unpacked != header.count * size:
            raise InputError(
                f"{path}: damaged: {unpacked:,} bytes of {ATTRIBUTES[what]}, "
                f"where {header.count:,} Gaussians have {header.count * size:,}"
            )
        if place + packed > end:
            raise _too_short(path, header, what)
        data = bytearray()
        if size:
            file.seek(place)
            data = _unpacked(path, file.read(packed), unpacked)
            if len(data) < unpacked:
                raise _too_short(path, header, what)
            if len(data) > unpacked:
                raise InputError(f"{path}: damaged: there is more in its {ATTRIBUTES[what]} than is promised")
        place += packed
        attributes.append(np.frombuffer(data, np.uint8).reshape(header.count, size))
    if len(attributes) < len(sizes):  # without SH their stream may be absent
        attributes.append(np.empty((header.count, 0), np.uint8))
    return attributes


def _unpacked(path: Path, packed: bytes, size: int) -> bytearray:
    """The first zstd frame in `packed`: no more than a byte beyond `size` of it."""
    data = bytearray()
    try:
        with zstandard.ZstdDecompressor(max_window_size=WIDEST).stream_reader(packed) as reader:
            while piece := reader.read(min(8 * BLOCK, size + 1 - len(data))):
                data += piece
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: damaged: it cannot be unpacked; copy or export it again") from error
    return data


def _too_short(path: Path, header: _Header, within: int) -> InputError:
    return InputError(
        f"{path}: truncated: {header.count:,} Gaussians are promised, it ends within their {ATTRIBUTES[within]}; "
        "copy or export it again"
    )


def _inflated(path: Path, file: BinaryIO) -> Iterator[bytes]:
    """The unpacked data in pieces of bounded size, whatever the compression ratio."""
    inflate = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        while not inflate.eof:
            packed = inflate.unconsumed_tail or file.read(BLOCK)
            if not packed:
                raise InputError(f"{path}: truncated: it ends in the middle; copy or export it again")
            if piece := inflate.decompress(packed, 8 * BLOCK):
                yield piece
    except zlib.error as error:
        raise InputError(f"{path}: damaged: it cannot be unpacked; copy or export it again") from error


def _table(attributes: list[NDArray[np.uint8]], header: _Header, degree: int) -> NDArray[np.float32]:
    """(N, 14 + 3 ((d+1)^2 - 1)). Rows as in a .ply."""
    positions, alphas, colours, scales, rotations, rest = attributes
    n, bands = len(positions), (degree + 1) ** 2
    table = np.empty((n, 14 + 3 * (bands - 1)), np.float32)
    table[:, :3] = _halves(positions) if header.version == 1 else _fixed_point(positions, header.bits)
    table[:, :3] *= FLIP
    table[:, 3] = logits(alphas[:, 0] / 255)
    table[:, 4:7] = scales / 16.0 - 10.0
    table[:, 7:11] = (_signs_first if header.version < 3 else _smallest_three)(rotations) * (1.0, *FLIP)
    table[:, 11:14] = (colours / 255 - 0.5) / COLOUR_SCALE
    coefficients = (rest[:, : 3 * (bands - 1)].reshape(n, bands - 1, 3) - 128.0) / 128.0
    coefficients *= flipped_bands(degree)[1:, None]
    table[:, 14:] = coefficients.transpose(0, 2, 1).reshape(n, -1)  # channel-major, as a .ply has them
    return table


def _halves(packed: NDArray[np.uint8]) -> NDArray[np.float16]:
    """(N, 3). Positions of version 1."""
    return np.ascontiguousarray(packed).view("<f2")


def _fixed_point(packed: NDArray[np.uint8], bits: int) -> NDArray[np.float64]:
    """(N, 3). Positions since version 2: 24 bits, signed, `bits` of them after the point."""
    parts = packed.reshape(-1, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    fixed -= (fixed & 0x800000) << 1
    return fixed / 2.0**bits


def _signs_first(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(N, 4), wxyz, up to version 2: x, y, z as bytes around 127.5; w completes the unit quaternion, positive."""
    xyz = packed / 127.5 - 1
    return np.concatenate([np.sqrt(np.maximum(1 - (xyz**2).sum(1), 0))[:, None], xyz], 1)


def _smallest_three(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(N, 4), wxyz, since version 3: the top two bits of a little-endian word name the largest of xyzw; the others
    follow from the low end, the last first, nine bits each for 0 to 1 / sqrt(2), and a bit for the sign."""
    words = np.ascontiguousarray(packed).view("<u4")[:, 0].astype(np.uint32)
    tens = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], 1).astype(np.float64)
    others = np.where(tens >= 512, -(tens - 512), tens) / 511 / np.sqrt(2)
    return with_largest((words >> 30).astype(np.intp), others)[:, [3, 0, 1, 2]]


def flipped_bands(degree: int) -> NDArray[np.float64]:
    """((d+1)^2,). 1 or -1: the factor of each SH coefficient when the axes are flipped."""
    direction = np.array([[0.36, 0.48, 0.8]])
    return np.sign(basis(direction, degree) * basis(direction * FLIP, degree))[0]
