"""Niantic's .spz files, versions 2 and 3: gzipped, quantised, one attribute after another."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.splats.compressed_ply import with_largest
from engine.io.splats.rows import gaussians_from_rows, logits, row_blocks, stride_for
from engine.scene.gaussians import Gaussians
from engine.scene.sh import basis

__all__ = ["GZIP", "read_spz"]

GZIP = b"\x1f\x8b"
"""How a gzipped file begins."""

MAGIC = b"NGSP"
HEADER = struct.Struct("<4sIIBBBB")
"""Magic, version, count, SH degree, fractional bits of positions, flags, and a byte that is 0."""

VERSIONS = {2: 3, 3: 4}
"""Bytes of a rotation in each version that is read."""

MOST = 10_000_000
"""Most Gaussians, as in Niantic's own reader. A few kilobytes of gzip could claim any number."""

EXTENDED = 2
"""Flag: other programs' private data follow the Gaussians."""

BLOCK = 1 << 20
"""Compressed bytes read at once."""

ATTRIBUTES = ("places", "opacities", "colours", "sizes", "rotations", "spherical harmonics")
"""The attributes in file order, each for all Gaussians."""

DEGREES = (0, 9, 24, 45, 72)
"""Bytes of SH above degree 0 of a Gaussian."""

COLOUR_SCALE = 0.15
"""A byte of colour spans 1 / 0.15 of the degree-0 coefficient, with its middle at 0."""

FLIP = np.array([1.0, -1.0, -1.0])
"""Axes are right, up, back in an .spz, and right, down, forward in the .ply that a capture comes as elsewhere."""


def read_spz(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of an .spz in the axes of a .ply, and a line on each thing left out.

    With `most` no more than so many, evenly chosen, with SH of degree 0; the other SH are not even unpacked. Raises
    InputError for other versions, and if the file is damaged or does not hold what its header promises. Memory grows
    with the data that are there, never with the header's counts.
    """
    path = Path(path)
    with open_file(path) as file:
        stream = _inflated(path, file)
        start = next(stream, b"")
        if start[:4] != MAGIC:
            other = "a .ply" if start[:3] == b"ply" else "something else"
            raise InputError(f"{path}: not an .spz scene; it is gzipped, but {other} is in it; unpack it with gunzip")
        if len(start) < HEADER.size:
            raise InputError(f"{path}: truncated: it ends within its header; copy or export it again")
        _, version, count, degree, bits, flags, zero = HEADER.unpack_from(start)
        if version not in VERSIONS:
            raise InputError(
                f"{path}: .spz version {version}; versions 2 and 3 can be opened, export it as one of them"
            )
        if degree >= len(DEGREES) or bits > 23 or zero:
            raise InputError(f"{path}: damaged: its header holds numbers that no .spz has")
        if not 0 < count <= MOST:
            raise InputError(f"{path}: {count:,} Gaussians; an .spz holds from 1 to {MOST:,}")
        sizes = (9, 1, 3, 3, VERSIONS[version], DEGREES[degree] if most is None else 0)
        data = bytearray()
        for block in chain([start[HEADER.size :]], stream):
            data += block
            if most is not None and len(data) >= count * sum(sizes):
                break
            if len(data) > count * sum(sizes) and not flags & EXTENDED:
                raise InputError(f"{path}: damaged: there is more in it than the {count:,} Gaussians it promises")
    if len(data) < count * sum(sizes):
        within = int(np.searchsorted(np.cumsum(sizes) * count, len(data), side="right"))
        raise InputError(
            f"{path}: truncated: {count:,} Gaussians are promised, it ends within their {ATTRIBUTES[within]}; "
            "copy or export it again"
        )
    parts = np.split(np.frombuffer(data, np.uint8, count * sum(sizes)), np.cumsum(sizes)[:-1] * count)
    attributes = [part.reshape(count, -1) for part in parts]
    kept, stride = (min(degree, 3) if most is None else 0), stride_for(count, most)
    blocks = (
        _table([a[rows.start : rows.stop : rows.step] for a in attributes], version, bits, kept)
        for rows in row_blocks(count, stride)
    )
    columns = 14 + 3 * ((kept + 1) ** 2 - 1)
    gaussians, warnings = gaussians_from_rows(path, blocks, -(-count // stride), columns)
    if most is None and kept < degree:
        warnings.append(f"{path}: spherical harmonics of degree {degree} cut down to degree {kept}")
    return gaussians, warnings


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


def _table(attributes: list[NDArray[np.uint8]], version: int, bits: int, degree: int) -> NDArray[np.float32]:
    """(N, 14 + 3 ((d+1)^2 - 1)). Rows as in a .ply."""
    positions, alphas, colours, scales, rotations, rest = attributes
    n, bands = len(positions), (degree + 1) ** 2
    table = np.empty((n, 14 + 3 * (bands - 1)), np.float32)
    parts = positions.reshape(n, 3, 3).astype(np.int32)
    fixed = parts[..., 0] | parts[..., 1] << 8 | parts[..., 2] << 16
    fixed -= (fixed & 0x800000) << 1  # 24 bits with a sign
    table[:, :3] = fixed / 2.0**bits * FLIP
    table[:, 3] = logits(alphas[:, 0] / 255)
    table[:, 4:7] = scales / 16.0 - 10.0
    table[:, 7:11] = (_signs_first if version == 2 else _smallest_three)(rotations) * (1.0, *FLIP)
    table[:, 11:14] = (colours / 255 - 0.5) / COLOUR_SCALE
    coefficients = (rest[:, : 3 * (bands - 1)].reshape(n, bands - 1, 3) - 128.0) / 128.0
    coefficients *= _flipped_bands(degree)[1:, None]
    table[:, 14:] = coefficients.transpose(0, 2, 1).reshape(n, -1)  # channel-major, as a .ply has them
    return table


def _signs_first(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(N, 4), wxyz, of version 2: x, y and z as bytes about 127.5; w completes the unit quaternion and is positive."""
    xyz = packed / 127.5 - 1
    return np.concatenate([np.sqrt(np.maximum(1 - (xyz**2).sum(1), 0))[:, None], xyz], 1)


def _smallest_three(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(N, 4), wxyz, of version 3: of a little-endian word the top two bits name the largest of xyzw; the others follow
    from the low end, the last first, nine bits each over 1 / sqrt(2) and a bit for the sign."""
    words = np.ascontiguousarray(packed).view("<u4")[:, 0].astype(np.uint32)
    tens = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], 1).astype(np.float64)
    others = np.where(tens >= 512, -(tens - 512), tens) / 511 / np.sqrt(2)
    return with_largest((words >> 30).astype(np.intp), others)[:, [3, 0, 1, 2]]


def _flipped_bands(degree: int) -> NDArray[np.float64]:
    """((d+1)^2,). 1 or -1: the factor of each SH coefficient when the axes are flipped."""
    direction = np.array([[0.36, 0.48, 0.8]])
    return np.sign(basis(direction, degree) * basis(direction * FLIP, degree))[0]
