"""PlayCanvas' SOG, version 2, in one archive: pictures whose pixels are Gaussians. `engine.io.splats.sog` reads it."""

from __future__ import annotations

import io
import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from engine.io.files import ZIP_TIME, atomic
from engine.io.splats.sog import BANDS, LARGEST_AT, META, PALETTE_COLUMNS
from engine.io.writers.provenance import Provenance
from engine.scene.gaussians import Gaussians
from engine.scene.morton import morton_order

__all__ = ["write_sog"]

PALETTE_LEVELS = 16
"""Times the spherical harmonics are halved: 65,536 entries, all that two bytes can name."""

BOOK_ROUNDS = 20
"""Rounds of Lloyd's iteration for a codebook of 256 numbers; after ten it hardly moves."""

BOOK_SAMPLE = 1 << 20
"""Numbers that a codebook is made from."""

Bytes = NDArray[np.uint8]


def write_sog(path: Path, gaussians: Gaussians, about: Provenance) -> None:
    """Writes Gaussians in the axes of a .ply, in Morton order. Raises InputError if writing fails.

    Coordinates are 16-bit logarithms; sizes, colours and spherical harmonics are the nearest of 256 numbers chosen for
    them; the spherical harmonics of a Gaussian are one of 65,536 sets.
    """
    files = _files(gaussians[morton_order(gaussians.means)], about)
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, ZIP_TIME), data)


def _files(g: Gaussians, about: Provenance) -> dict[str, bytes]:
    """The files in the archive, by name."""
    logs = np.sign(g.means) * np.log1p(np.abs(g.means.astype(np.float64)))
    low, high = logs.min(0), logs.max(0)
    steps = np.rint((logs - low) / np.maximum(high - low, 1e-12) * 65535).astype(np.uint16)
    sizes, size_book = _from_book(np.log(g.scales))
    tints, tint_book = _from_book(g.sh[:, 0])
    opacities = np.rint(255 * g.opacities).astype(np.uint8)
    pictures = {
        "means_l.webp": (steps & 255).astype(np.uint8),
        "means_u.webp": (steps >> 8).astype(np.uint8),
        "scales.webp": sizes,
        "quats.webp": _turns(g.quats),
        "sh0.webp": np.concatenate([tints, opacities[:, None]], axis=1),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": "FruitNinja", "comments": list(about.lines)},
        "count": len(g),
        "antialias": False,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": size_book, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": tint_book, "files": ["sh0.webp"]},
    }
    if g.sh_degree:
        labels, entries = _palette(g.sh[:, 1:].reshape(len(g), -1))
        at = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1).astype(np.uint8)
        packed, book = _from_book(entries)
        pictures["shN_labels.webp"] = at
        k = BANDS[g.sh_degree]
        meta["shN"] = {
            "count": len(entries),
            "bands": g.sh_degree,
            "codebook": book,
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        }
        centroids = _picture(packed.reshape(-1, 3), PALETTE_COLUMNS * k)
    width = 4 * math.ceil(math.sqrt(len(g)) / 4)
    files = {name: _picture(pixels, width) for name, pixels in pictures.items()}
    if g.sh_degree:
        files["shN_centroids.webp"] = centroids
    return {META: json.dumps(meta, allow_nan=False).encode()} | files


def _picture(values: Bytes, width: int) -> bytes:
    """Rows of three or four bytes as the pixels of a lossless WebP."""
    pixels = np.full((-(-len(values) // width) * width, 4), 255, np.uint8)
    pixels[: len(values), : values.shape[1]] = values
    file = io.BytesIO()
    # Method 0 is a third larger than 4, and five times as fast. `exact` keeps colours where alpha is 0.
    image = Image.fromarray(pixels.reshape(-1, width, 4))
    image.save(file, "WEBP", lossless=True, exact=True, method=0, quality=30)
    return file.getvalue()


def _from_book(values: NDArray[np.floating]) -> tuple[Bytes, list[float]]:
    """Bytes in the shape of `values`, and the 256 ascending numbers that they stand for, by Lloyd's iteration."""
    flat = values.astype(np.float64).ravel()
    ordered = np.sort(flat[:: max(1, len(flat) // BOOK_SAMPLE)])
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    # Half of the numbers at quantiles of the values, half evenly spaced, so that rare values are met too.
    ends = np.linspace(flat.min(), flat.max(), 128)
    book = np.sort(np.concatenate([np.quantile(ordered, np.linspace(0, 1, 128)), ends]))
    for _ in range(BOOK_ROUNDS):
        borders = np.concatenate([[0], np.searchsorted(ordered, (book[1:] + book[:-1]) / 2), [len(ordered)]])
        counts = np.diff(borders)
        book = np.where(counts > 0, np.diff(sums[borders]) / np.maximum(counts, 1), book)
    if book[0] < 0 < book[-1]:
        book[np.abs(book).argmin()] = 0.0  # so zero coefficients stay exactly zero
    book = np.sort(book.astype(np.float32)).astype(np.float64)
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8), book.tolist()


def _turns(quats: NDArray[np.float32]) -> Bytes:
    """(N, 4). The three smaller components of quaternions wxyz, in +-1 / sqrt(2), and which one is left out."""
    largest = np.abs(quats).argmax(1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1, 1)[:, None].astype(np.float32)
    places = np.array([[j for j in range(4) if j != i] for i in range(4)])
    others = np.take_along_axis(quats, places[largest], axis=1)
    turned = np.clip(np.rint((others / math.sqrt(2) + 0.5) * 255), 0, 255).astype(np.uint8)
    return np.concatenate([turned, (LARGEST_AT + largest)[:, None].astype(np.uint8)], axis=1)


def _palette(sh: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Each row's entry (N,), and the entries (P, 3 K) in a palette of coefficients (N, 3 K).

    The first entry is zeros, as in all interior atoms. The others are means of groups: each group is halved, again and
    again, at the median of its most varying coefficient.
    """
    labels = np.zeros(len(sh), np.int64)
    rows = np.flatnonzero(sh.any(axis=1))
    values = sh[rows]
    if not len(rows):
        return labels, np.zeros((1, sh.shape[1]), np.float32)
    group = np.zeros(len(rows), np.int64)
    for _ in range(PALETTE_LEVELS):
        counts = np.bincount(group)
        if counts.max() == 1:
            break
        means = _group_means(values, group, counts)
        spread = _group_means((values - means[group]) ** 2, group, counts)
        along = values[np.arange(len(values)), spread.argmax(1)[group]]
        order = np.lexsort((along, group))
        firsts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        rank = np.empty(len(rows), np.int64)
        rank[order] = np.arange(len(rows)) - firsts[group[order]]
        group = 2 * group + (rank >= (counts[group] + 1) // 2)
        _, group = np.unique(group, return_inverse=True)
    if group.max() == 2**PALETTE_LEVELS - 1:  # the entry of zeros needs a place
        group = np.minimum(group, 2**PALETTE_LEVELS - 2)
    entries = _group_means(values, group, np.bincount(group)).astype(np.float32)
    labels[rows] = group + 1
    return labels, np.concatenate([np.zeros((1, sh.shape[1]), np.float32), entries])


def _group_means(
    values: NDArray[np.floating],  # [N, K]
    group: NDArray[np.int64],  # [N]
    counts: NDArray[np.intp],  # [G]
) -> NDArray[np.float64]:
    """(G, K). Mean of the values of each group."""
    return np.stack([np.bincount(group, column) for column in values.T], axis=1) / counts[:, None]
