"""What the kernels of the classic renderer read and write. Named tuples, which numba can read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.render.projection import CameraRecord

__all__ = [
    "BLUE",
    "CHORD_SLOPE",
    "DEPTH",
    "GREEN",
    "HALF_CHORD",
    "HALF_HEIGHT",
    "HALF_WIDTH",
    "LOG_OPACITY",
    "RECORD",
    "RED",
    "U_FRACTION",
    "V_FRACTION",
    "WHITEN_XX",
    "WHITEN_YX",
    "WHITEN_YY",
    "Frame",
    "PictureGradient",
    "Scene",
    "Slice",
    "U",
    "V",
]

RECORD = 16
"""Numbers in a record, 64 bytes in float32: one cache line. Their places are the constants below."""

U, U_FRACTION, V, V_FRACTION = 0, 1, 2, 3
"""Integer and fractional part of the mean, pixels: together they keep the digits that one float32 would lose."""

WHITEN_XX, WHITEN_YX, WHITEN_YY, LOG_OPACITY = 4, 5, 6, 7
"""alpha = 2^(LOG_OPACITY - m^2 - n^2) with m = WHITEN_XX dx, n = WHITEN_YX dx + WHITEN_YY dy: squares lose no digits
on long needles, as a dx^2 + 2 b dx dy + c dy^2 does."""

RED, GREEN, BLUE, DEPTH = 8, 9, 10, 11
"""RGB as the camera sees it; depth, world units."""

HALF_WIDTH, HALF_HEIGHT = 12, 13
"""Half the box around the ellipse outside which alpha is below 1/255, pixels."""

CHORD_SLOPE, HALF_CHORD = 14, 15
"""dx per dy along the middles of the ellipse's horizontal chords; half the chord through the mean, pixels."""


class Scene(NamedTuple):
    """N Gaussians of one float type, contiguous; or their gradients."""

    means: NDArray[np.floating]
    """(N, 3). World units."""
    scales: NDArray[np.floating]
    """(N, 3). Standard deviations, world units."""
    quats: NDArray[np.floating]
    """(N, 4). wxyz, any length."""
    opacities: NDArray[np.floating]
    """(N,). Range [0, 1]."""
    colours: NDArray[np.floating]
    """(N, K, 3). Spherical harmonics; or RGB, K = 1."""
    plain: bool
    """Whether colours are RGB."""


class Frame(NamedTuple):
    """A picture while it is composited, still in tiles. V Gaussians are in front of the near plane."""

    cam: CameraRecord
    eye: NDArray[np.float64]
    """(3,). World units."""
    records: NDArray[np.floating]
    """(V, RECORD). Projected Gaussians; a chunk's are packed from the chunk's first place on."""
    owners: NDArray[np.int32]
    """(V,). Index of each record's Gaussian."""
    pair_counts: NDArray[np.int32]
    """(V,). Tiles that each record touches."""
    states: NDArray[np.floating]
    """(tiles, BLOCKS, STATE * BLOCK). The pixels, as `blend.STATE` describes."""
    lasts: NDArray[np.int32]
    """(tiles, BLOCKS, BLOCK). Place of the last record drawn in each pixel."""
    tile_lasts: NDArray[np.int32]
    """(tiles,). Largest of a tile's `lasts`, or UNTOUCHED."""
    width: int
    """Pixels."""
    height: int


class Slice(NamedTuple):
    """A run of the depth order, and its (tile, Gaussian) pairs."""

    first: int
    """Place of its first Gaussian in the order."""
    chunk_size: int
    """Gaussians in a task."""
    record_counts: NDArray[np.int64]
    """(chunks,). Records of each chunk."""
    first_places: NDArray[np.int64]
    """(chunks,). Where each chunk's pairs begin in `pair_tiles`."""
    tiles: NDArray[np.int64]
    """(T,). Tiles that have pairs."""
    tile_starts: NDArray[np.int64]
    """(tiles + 1,). Where each tile's pairs begin in `pair_codes`."""
    pair_codes: NDArray[np.int32]
    """(pairs,). record << BLOCKS | blocks, tile by tile, nearest first."""
    pair_tiles: NDArray[np.int32]
    """(most pairs,). tile << BLOCKS | blocks, record by record."""
    pair_rows: NDArray[np.int32]
    """(pairs,). Place of each pair of `pair_codes` in `pair_tiles`."""


class PictureGradient(NamedTuple):
    """Derivatives of a loss with respect to a picture."""

    rgb: NDArray[np.floating]
    """(H, W, 3)."""
    alpha: NDArray[np.floating]
    """(H, W)."""
    depth: NDArray[np.floating]
    """(H, W). With respect to depth times alpha."""
    has_depth: bool
    """Whether any of `depth` is not 0."""
    background: NDArray[np.floating]
    """(3,). RGB that the picture was made over."""
