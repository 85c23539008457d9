"""Niantic's .spz, version 4: a twentieth of the size of a .ply. `engine.io.splats.spz` reads it."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import atomic
from engine.io.splats.rows import row_blocks
from engine.io.splats.spz import COLOUR_SCALE, FLIP, HEADER, MAGIC, MOST, TABLE_AT, flipped_bands
from engine.io.writers.provenance import Provenance
from engine.scene.gaussians import Gaussians

__all__ = ["spz_bytes", "spz_misfit", "spz_unit", "write_spz"]

VERSION = 4

LEVEL = 3
"""zstd level: 12 takes six times as long for a tenth of a per cent of the size."""

FARTHEST = 2**23 - 1
"""Largest coordinate that fits in three bytes."""

STEPS = 256
"""Steps of a place in the size of a detail: moving atoms by a thousandth of the distance to their neighbours changes no
colour of a face by more than rounding colours to bytes does."""

MOST_BITS = 23
"""Most fractional bits of a place: three bytes less the sign."""

MOST_OPACITY = 254
"""Other programs take the logit of a byte, and that of 255 is infinite. Two atoms in a row then transmit 2e-5."""

LOG_SCALES = (-10.0, 255 / 16 - 10)
"""Range of a size byte, natural logarithms of world units: 5e-5 to 376 units in steps of 6 %."""


def write_spz(path: Path, gaussians: Gaussians, about: Provenance) -> None:
    """Writes Gaussians in the axes of an .spz, y and z against those of a .ply; the format has no room for `about`.

    Places are as fine as the details need, colours have 8 bits, sizes steps of 6 %, and spherical harmonics are clamped
    to -1 and 1. Raises InputError for sizes or counts that an .spz cannot hold, and if writing fails.
    """
    misfit = spz_misfit(gaussians)
    if misfit:
        raise InputError(f"{path}: {misfit}")
    data = spz_bytes(gaussians)
    with atomic(path) as temporary:
        temporary.write_bytes(data)


def spz_unit(gaussians: Gaussians) -> float:
    """The power of two, world units, in which an .spz can hold these Gaussians; 1 for all but tiny and huge details."""
    low, high = (float(np.exp(end)) for end in LOG_SCALES)
    detail = _detail(gaussians)
    return 1.0 if 2 * low < detail < high / 2 else 2.0 ** round(math.log2(detail / math.sqrt(low * high)))


def spz_misfit(gaussians: Gaussians) -> str:
    """Why these Gaussians cannot become an .spz, and what to do; empty if they can."""
    if len(gaussians) > MOST:
        return f"{len(gaussians):,} Gaussians; an .spz holds {MOST:,} at most: save a .ply"
    farthest = float(np.abs(gaussians.means).max(initial=0))
    if farthest > FARTHEST:
        return f"places as far as {farthest:.3g} units; an .spz holds {FARTHEST:,} at most: save a .ply"
    if spz_unit(gaussians) != 1:
        low, high = (float(np.exp(end)) for end in LOG_SCALES)
        return f"details of {_detail(gaussians):.2g} units; an .spz holds {low:.1g} to {high:.3g}: save a .ply"
    return ""


def spz_bytes(gaussians: Gaussians) -> bytes:
    """The content of the file."""
    n, degree = len(gaussians), gaussians.sh_degree
    bits = _fractional_bits(gaussians)
    widths = (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1))
    streams = [np.empty((n, width), np.uint8) for width in widths if width]
    for rows in row_blocks(n):
        for stream, block in zip(streams, _block(gaussians[rows.start : rows.stop], bits), strict=False):
            stream[rows.start : rows.stop] = block
    with ThreadPoolExecutor() as pool:
        packed = list(pool.map(_packed, streams))
    table = [size for stream, pack in zip(streams, packed, strict=True) for size in (len(pack), stream.nbytes)]
    head = bytearray(TABLE_AT.size)
    TABLE_AT.pack_into(head, 0, TABLE_AT.size)
    HEADER.pack_into(head, 0, MAGIC, VERSION, n, degree, bits, 0, len(streams))
    return b"".join([head, struct.pack(f"<{len(table)}Q", *table), *packed])


def _block(g: Gaussians, bits: int) -> Iterator[NDArray[np.uint8]]:
    """(R, width) each. The attributes of some rows, in file order."""
    fixed = np.rint(g.means * (np.float64(2.0**bits) * FLIP)).astype("<i4")
    yield fixed.view(np.uint8).reshape(len(g), 3, 4)[..., :3].reshape(len(g), 9)
    yield np.minimum(_bytes(255 * g.opacities), MOST_OPACITY)[:, None]
    yield _bytes((g.sh[:, 0] * COLOUR_SCALE + 0.5) * 255)
    yield _bytes((np.log(g.scales) - LOG_SCALES[0]) * 16)
    yield _smallest_three(g.quats * np.array([1, *FLIP], np.float32))
    rest = g.sh[:, 1:]
    if not rest.any():  # interior atoms, most of a solid
        yield np.full((len(g), 3 * rest.shape[1]), 128, np.uint8)
    else:
        signs = flipped_bands(g.sh_degree)[1:, None].astype(np.float32)
        yield _bytes(rest * (128 * signs) + 128).reshape(len(g), -1)


def _packed(stream: NDArray[np.uint8]) -> bytes:
    """A zstd frame."""
    return zstandard.ZstdCompressor(level=LEVEL).compress(stream.data)


def _detail(gaussians: Gaussians) -> float:
    """The size of a typical Gaussian, world units."""
    return float(np.median(gaussians.scales.max(1))) if len(gaussians) else 1.0


def _fractional_bits(gaussians: Gaussians) -> int:
    """Fractional bits of a place: as many as details need, and no more than leave room for the farthest place."""
    farthest = float(np.abs(gaussians.means).max(initial=1e-30))
    room = math.floor(math.log2(FARTHEST / farthest))
    return int(np.clip(math.ceil(math.log2(STEPS / _detail(gaussians))), 0, min(max(room, 0), MOST_BITS)))


def _bytes(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """The nearest bytes."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def _smallest_three(quats: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(N, 4). Words of quaternions wxyz (N, 4), as `engine.io.splats.spz` reads them."""
    xyzw = quats[:, [1, 2, 3, 0]]
    largest = np.abs(xyzw).argmax(1)
    rows = np.arange(len(xyzw))
    xyzw = xyzw * np.where(xyzw[rows, largest] < 0, -1, 1)[:, None]
    places = np.array([[j for j in range(4) if j != i] for i in range(4)])
    others = np.take_along_axis(xyzw, places[largest], axis=1)
    tens = np.minimum(np.rint(np.abs(others) * (511 * math.sqrt(2))), 511).astype(np.uint32)
    tens |= (others < 0).astype(np.uint32) << 9
    words = largest.astype(np.uint32) << 30 | tens[:, 0] << 20 | tens[:, 1] << 10 | tens[:, 2]
    return np.ascontiguousarray(words.astype("<u4")).view(np.uint8).reshape(-1, 4)
