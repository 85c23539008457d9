"""Which tiles of the picture a Gaussian touches, and the lists of Gaussians per tile."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["SIDE", "SLACK", "TAIL_BITS", "list_pairs", "place_pairs", "row_span", "sum_open", "tile_rows"]

SIDE = 8
"""Pixels along a tile's edge. A splat of a detailed scene is a few pixels wide: larger tiles mostly miss it."""

TAIL_BITS = math.log2(255.0)
"""alpha = 2^-TAIL_BITS is one step of an 8-bit picture; what is fainter is left out."""

SLACK = 1e-3
"""Pixels by which the outline is widened, against rounding: an extra tile changes nothing, a missing one would."""


@njit(cache=True, error_model="numpy")
def tile_rows(record, tiles_y):  # type: ignore[no-untyped-def]
    """(first, one past last) row of tiles with a pixel centre inside the record's box."""
    v = np.float64(record[2]) + np.float64(record[3])
    reach = record[13] * (1.0 + 1e-5) + SLACK
    low = math.ceil(min(max(v - reach - 0.5, 0.0), 1e9))
    high = math.floor(min(max(v + reach - 0.5, -1.0), tiles_y * SIDE - 1.0))
    if low > high:
        return 0, 0
    return int(low) // SIDE, int(high) // SIDE + 1


@njit(cache=True, error_model="numpy")
def row_span(record, ty, tiles_x):  # type: ignore[no-untyped-def]
    """(first, one past last) column of tiles whose pixel centres in tile row ty may see alpha >= 1/255.

    The chord of the ellipse at height dy is centred on m dy and has half width h sqrt(1 - (dy/ey)^2): over a band of
    dy its ends lie where the ellipse is widest or at the end of the band nearest to there.
    """
    u = np.float64(record[0]) + np.float64(record[1])
    v = np.float64(record[2]) + np.float64(record[3])
    ex = record[12] * (1.0 + 1e-5) + SLACK
    ey = record[13] * (1.0 + 1e-5) + SLACK
    low = max(ty * SIDE + 0.5 - v, -ey)
    high = min(ty * SIDE + (SIDE - 0.5) - v, ey)
    a = max(np.float64(record[4]) * record[4] + np.float64(record[5]) * record[5], 1e-30)
    m = -np.float64(record[5]) * record[6] / a
    h = math.sqrt((record[7] + TAIL_BITS) / a) * (1.0 + 1e-5) + SLACK
    widest = m * ey * ey / ex
    right = min(max(widest, low), high)
    left = min(max(-widest, low), high)
    x1 = u + min(m * right + h * math.sqrt(max(1.0 - (right / ey) * (right / ey), 0.0)) + SLACK, ex)
    x0 = u + max(m * left - h * math.sqrt(max(1.0 - (left / ey) * (left / ey), 0.0)) - SLACK, -ex)
    first = math.ceil(min(max(x0 - 0.5, 0.0), 1e9))
    last = math.floor(min(max(x1 - 0.5, -1.0), tiles_x * SIDE - 1.0))
    if first > last:
        return 0, 0
    return int(first) // SIDE, int(last) // SIDE + 1


@njit(cache=True, error_model="numpy")
def sum_open(open_tiles, sums):  # type: ignore[no-untyped-def]
    """Summed-area table (tiles_y + 1, tiles_x + 1) of open_tiles (tiles_y, tiles_x)."""
    sums[0, :] = 0
    for y in range(open_tiles.shape[0]):
        run = 0
        sums[y + 1, 0] = 0
        for x in range(open_tiles.shape[1]):
            run += open_tiles[y, x]
            sums[y + 1, x + 1] = sums[y, x + 1] + run


@njit(cache=True, error_model="numpy")
def place_pairs(tile_counts, tile_starts):  # type: ignore[no-untyped-def]
    """Turns the counts (chunks, tiles) into first places: tile after tile, within a tile chunk after chunk.

    Writes where each tile begins to tile_starts (tiles + 1,).
    """
    total = 0
    for tile in range(tile_counts.shape[1]):
        tile_starts[tile] = total
        for chunk in range(tile_counts.shape[0]):
            count = tile_counts[chunk, tile]
            tile_counts[chunk, tile] = total
            total += count
    tile_starts[tile_counts.shape[1]] = total


@njit(cache=True, error_model="numpy", nogil=True)
def list_pairs(  # type: ignore[no-untyped-def]
    chunk,
    chunk_size,
    first,
    record_counts,  # [chunks]
    records,
    open_tiles,
    places,  # [chunks, tiles] next free place of this chunk in each tile's list
    first_rows,  # [chunks]
    pair_slots,  # out [pairs]
    pair_rows,  # out [pairs] row of the pair among its Gaussian's
):
    """Writes the records of one chunk into the lists of the tiles they touch, nearest first."""
    start = first + chunk * chunk_size
    tiles_y, tiles_x = open_tiles.shape
    free = places[chunk]
    row = first_rows[chunk]
    for slot in range(start, start + record_counts[chunk]):
        record = records[slot]
        y0, y1 = tile_rows(record, tiles_y)
        for ty in range(y0, y1):
            x0, x1 = row_span(record, ty, tiles_x)
            for tx in range(x0, x1):
                if open_tiles[ty, tx]:
                    tile = ty * tiles_x + tx
                    at = free[tile]
                    free[tile] = at + 1
                    pair_slots[at] = slot
                    pair_rows[at] = row
                    row += 1
