"""PlayCanvas' SOG captures, version 2: a meta.json and pictures whose pixels are Gaussians, side by side or zipped."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.files import open_file, read_file
from engine.io.picture_file import open_picture
from engine.io.splats.compressed_ply import with_largest
from engine.io.splats.rows import gaussians_from_rows, logits, row_blocks, stride_for
from engine.io.strict_json import parse
from engine.scene.gaussians import Gaussians

__all__ = ["META", "is_zipped_sog", "read_sog"]

META = "meta.json"
"""The file that names the others."""

MOST_META = 1 << 24
"""Most bytes of a meta.json: a hundred times what codebooks take."""

MOST_PICTURE = 1 << 30
"""Most bytes of a packed picture."""

LARGEST_AT = 252
"""Alpha of a quaternion whose largest component is w; x, y and z follow."""

PALETTE_COLUMNS = 64
"""Palette entries in a row of its picture."""

BANDS = (0, 3, 8, 15)
"""SH coefficients of a channel above degree 0, by degree."""

Bytes = NDArray[np.uint8]


class _Files:
    """The files of a capture: beside its meta.json, or in an archive. Nothing is unpacked to the disk."""

    def __init__(self, path: Path, archive: zipfile.ZipFile | None) -> None:
        self.path, self.archive = path, archive
        names = [] if archive is None else [n for n in archive.namelist() if n.rsplit("/", 1)[-1] == META]
        self.prefix = min(names, key=len).removesuffix(META) if names else ""

    def read(self, name: object, most: int) -> bytes:
        """The content of a file of at most `most` bytes."""
        if not isinstance(name, str) or not name or Path(name).name != name or "\\" in name:
            raise InputError(f"{self.path}: damaged: it names a file in another folder")
        if self.archive is None:
            return read_file(self.path.with_name(name), most)
        try:
            with self.archive.open(self.prefix + name) as file:
                data = file.read(most + 1)
        except KeyError as error:
            raise InputError(f"{self.path}: {name} is missing in it; export the capture again") from error
        except (
            zipfile.BadZipFile,
            zlib.error,
            lzma.LZMAError,
            NotImplementedError,
            RuntimeError,
            EOFError,
            OSError,
        ) as error:
            raise InputError(f"{self.path}: damaged: it cannot be unpacked; copy or export it again") from error
        if len(data) > most:
            raise InputError(f"{self.path}: {name} in it is too large; export the capture again")
        return data

    def pixels(self, name: object, least: int) -> Bytes:
        """(P, 4). The pixels of a picture row by row; there must be at least `least`."""
        data = self.read(name, MOST_PICTURE)
        with open_picture(data, f"{self.path}: its picture {name}") as image:
            pixels = np.asarray(image.convert("RGBA")).reshape(-1, 4)
        if len(pixels) < least:
            raise InputError(f"{self.path}: damaged: {name} has {len(pixels):,} pixels where {least:,} are promised")
        return pixels


@dataclass(frozen=True)
class _Palette:
    """Spherical harmonics above degree 0."""

    labels: NDArray[np.int64]
    """(N,). The entry of each Gaussian."""
    entries: NDArray[np.float32]
    """(P, K, 3). Coefficients of each entry."""


def is_zipped_sog(path: Path) -> bool:
    """Whether a file is an archive with a meta.json in it."""
    try:
        with open_file(path) as file, zipfile.ZipFile(file) as archive:
            return any(name.rsplit("/", 1)[-1] == META for name in archive.namelist())
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError):
        return False


def read_sog(path: str | Path, most: int | None = None) -> tuple[Gaussians, list[str]]:
    """The Gaussians of an .sog, or of a meta.json with its pictures beside it, and a line on each thing left out.

    With `most`, at most that many, evenly chosen, with SH of degree 0. Raises InputError for another version, and if
    a file is missing, damaged, or holds less than is promised.
    """
    path = Path(path)
    with ExitStack() as opened:
        archive = None
        if path.suffix.lower() != ".json":
            archive = opened.enter_context(zipfile.ZipFile(opened.enter_context(open_file(path))))
        files = _Files(path, archive)
        try:
            meta = parse(files.read(path.name if archive is None else META, MOST_META))
        except ValueError as error:
            raise InputError(f"{path}: damaged: its {META} cannot be read; export the capture again") from error
        if not isinstance(meta, dict) or not isinstance(meta.get("means"), dict):
            raise InputError(f"{path}: not an SOG scene; export the capture again")
        if meta.get("version") != 2:
            raise InputError(f"{path}: SOG of another version than 2; convert it again, to a .ply or to SOG 2")
        try:
            count, blocks, columns = _contents(files, meta, most)
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
            raise InputError(f"{path}: damaged: its {META} lacks what an SOG has; export the capture again") from error
    return gaussians_from_rows(path, blocks, count, columns)


def _contents(files: _Files, meta: dict[str, Any], most: int | None) -> tuple[int, Iterator[NDArray[np.float32]], int]:
    """The number of rows, the rows as in a .ply, and the number of their columns."""
    count = meta["count"]
    if not isinstance(count, int) or count < 1:
        raise ValueError(count)
    means, scales, quats, sh0 = (meta[name] for name in ("means", "scales", "quats", "sh0"))
    low, high = (files.pixels(name, count)[:, :3] for name in means["files"][:2])
    least, range_ = np.array(means["mins"], float), np.array(means["maxs"], float) - np.array(means["mins"], float)
    if least.shape != (3,) or range_.shape != (3,):
        raise ValueError(least.shape)
    sizes, turns, colours = (files.pixels(part["files"][0], count) for part in (scales, quats, sh0))
    size_book, colour_book = _codebook(scales), _codebook(sh0)
    palette = _palette(files, meta["shN"], count) if most is None and "shN" in meta else None
    stride = stride_for(count, most)
    columns = 14 + (3 * palette.entries.shape[1] if palette is not None else 0)

    def rows() -> Iterator[NDArray[np.float32]]:
        for chosen in row_blocks(count, stride):
            part = slice(chosen.start, chosen.stop, chosen.step)
            table = np.empty((len(chosen), columns), np.float32)
            logs = least + range_ * ((high[part].astype(np.uint16) << 8 | low[part]) / 65535)
            table[:, :3] = np.sign(logs) * np.expm1(np.abs(logs))
            table[:, 3] = logits(colours[part, 3] / 255)
            table[:, 4:7] = size_book[sizes[part, :3]]
            table[:, 7:11] = _quats(turns[part])
            table[:, 11:14] = colour_book[colours[part, :3]]
            if palette is not None:
                entries = palette.entries[palette.labels[part]]
                table[:, 14:] = entries.transpose(0, 2, 1).reshape(len(chosen), -1)  # channel-major
            yield table

    return len(range(0, count, stride)), rows(), columns


def _codebook(part: dict[str, Any]) -> NDArray[np.float32]:
    """(256,). The numbers that bytes stand for."""
    book = np.array(part["codebook"], np.float32)
    if book.shape != (256,):
        raise ValueError(book.shape)
    return book


def _quats(pixels: Bytes) -> NDArray[np.float64]:
    """(R, 4), wxyz. Alpha names the largest component; red, green and blue hold the others, in +-1 / sqrt(2)."""
    others = (pixels[:, :3] / 255 - 0.5) * np.sqrt(2)
    largest = pixels[:, 3].astype(np.intp) - LARGEST_AT
    quats = with_largest(np.maximum(largest, 0), others)
    quats[largest < 0] = 0  # no quaternion has such an alpha: dropped as zero
    return quats


def _palette(files: _Files, part: dict[str, Any], count: int) -> _Palette:
    """The palette, and each Gaussian's entry in it."""
    size, k = part["count"], BANDS[part["bands"]]
    if not isinstance(size, int) or size < 1 or not k:
        raise ValueError(size)
    centroids, labels = part["files"][:2]
    pixels = files.pixels(centroids, -(-size // PALETTE_COLUMNS) * PALETTE_COLUMNS * k)[:, :3]
    entries = _codebook(part)[pixels[: len(pixels) // k * k]].reshape(-1, k, 3)[:size]
    at = files.pixels(labels, count)[:count].astype(np.int64)
    return _Palette(np.minimum(at[:, 0] + (at[:, 1] << 8), len(entries) - 1), entries)
