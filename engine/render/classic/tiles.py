"""Which tiles of the picture a Gaussian touches, and the lists of Gaussians per tile."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.classic.records import (
    CHORD_SLOPE,
    HALF_CHORD,
    HALF_HEIGHT,
    HALF_WIDTH,
    U_FRACTION,
    V_FRACTION,
    U,
    V,
)
from engine.scene.constants import ALPHA_STEPS

__all__ = ["BLOCKS", "SIDE", "TAIL_BITS", "box_size", "list_pairs", "place_pairs", "sort_pairs", "sum_open"]

SIDE = 8
"""Edge of a tile in pixels. A splat of a detailed scene is a few pixels wide: larger tiles would mostly miss it."""

BLOCKS = SIDE // 2
"""Blocks in a tile: the pixel loops take two rows at a time."""

TAIL_BITS = math.log2(ALPHA_STEPS)
"""alpha = 2^-TAIL_BITS is one step of an 8-bit picture; fainter fragments are skipped."""

SLACK = 1e-3
"""Pixels by which the ellipse is widened, against rounding: an extra tile changes nothing, a missing one would."""

WIDER = 1.0 + 1e-5
"""Factor by which the ellipse is widened too, for the rounding of large splats."""


@njit(cache=True, error_model="numpy")
def _centres(low, high, tiles):
    """(first, one past last) of the pixels with a centre in low..high, in a row of `tiles` tiles."""
    first = math.ceil(min(max(low - 0.5, 0.0), 1e9))
    last = math.floor(min(max(high - 0.5, -1.0), tiles * SIDE - 1.0))
    return int(first), max(int(first), int(last) + 1)


@njit(cache=True, error_model="numpy")
def _covering(first, stop):
    """(first, one past last) tile with one of these pixels."""
    return first // SIDE, (stop + SIDE - 1) // SIDE if stop > first else first // SIDE


@njit(cache=True, error_model="numpy")
def _mean(record):
    """(u, v) of a record in float64, pixels."""
    return (
        np.float64(record[U]) + np.float64(record[U_FRACTION]),
        np.float64(record[V]) + np.float64(record[V_FRACTION]),
    )


@njit(cache=True, error_model="numpy")
def box_size(record, tiles_y, tiles_x):
    """Number of tiles in the box around the record's ellipse."""
    u, v = _mean(record)
    ex, ey = record[HALF_WIDTH] * WIDER + SLACK, record[HALF_HEIGHT] * WIDER + SLACK
    left, right = _centres(u - ex, u + ex, tiles_x)
    top, bottom = _centres(v - ey, v + ey, tiles_y)
    x0, x1 = _covering(left, right)
    y0, y1 = _covering(top, bottom)
    return (x1 - x0) * (y1 - y0)


@njit(cache=True, error_model="numpy")
def sum_open(open_tiles, sums):
    """Summed-area table (tiles_y + 1, tiles_x + 1) of open_tiles (tiles_y, tiles_x)."""
    sums[0, :] = 0
    for y in range(open_tiles.shape[0]):
        run = 0
        sums[y + 1, 0] = 0
        for x in range(open_tiles.shape[1]):
            run += open_tiles[y, x]
            sums[y + 1, x + 1] = sums[y, x + 1] + run


@njit(cache=True, error_model="numpy")
def place_pairs(tile_counts, tile_starts):
    """Turns counts (chunks, tiles) into first places, in place: tile after tile, within a tile chunk after chunk.

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
def list_pairs(
    chunk,
    chunk_size,
    first,
    record_counts,  # [chunks]
    records,
    open_tiles,  # [tiles_y, tiles_x]
    first_places,  # [chunks] where the chunk begins to write its tiles
    pair_tiles,  # out [most pairs] tile << BLOCKS | which of its blocks, of each record in turn
    pair_counts,  # out [V] number of tiles of each record
    tile_counts,  # out [chunks, tiles]
):
    """Finds the open tiles with a pixel centre where a record's alpha may reach 1/255.

    The chord of the ellipse at height dy has its middle at m dy and its half width is h sqrt(1 - (dy/ey)^2): within a
    row of tiles its ends reach farthest where the ellipse is widest, or at the end of the row nearest to there.
    """
    start = first + chunk * chunk_size
    tiles_y, tiles_x = open_tiles.shape
    counts = tile_counts[chunk]
    counts[:] = 0
    at = first_places[chunk]
    for slot in range(start, start + record_counts[chunk]):
        record = records[slot]
        u, v = _mean(record)
        ex, ey = record[HALF_WIDTH] * WIDER + SLACK, record[HALF_HEIGHT] * WIDER + SLACK
        m, h = np.float64(record[CHORD_SLOPE]), record[HALF_CHORD] * WIDER + SLACK
        per_ey = 1.0 / ey
        widest = m * ey * ey / ex
        begin = at
        top, bottom = _centres(v - ey, v + ey, tiles_y)
        y0, y1 = _covering(top, bottom)
        for ty in range(y0, y1):
            low = max(ty * SIDE + 0.5 - v, -ey)
            high = min(ty * SIDE + (SIDE - 0.5) - v, ey)
            right = min(max(widest, low), high)
            left = min(max(-widest, low), high)
            fall_right, fall_left = right * per_ey, left * per_ey
            x1 = u + min(m * right + h * math.sqrt(max(1.0 - fall_right * fall_right, 0.0)) + SLACK, ex)
            x0 = u + max(m * left - h * math.sqrt(max(1.0 - fall_left * fall_left, 0.0)) - SLACK, -ex)
            tx0, tx1 = _centres(x0, x1, tiles_x)
            tx0, tx1 = _covering(tx0, tx1)
            first_block = max(top - ty * SIDE, 0) // 2
            end_block = (min(bottom - ty * SIDE, SIDE) + 1) // 2
            blocks = (1 << end_block) - (1 << first_block)
            for tx in range(tx0, tx1):
                if open_tiles[ty, tx]:
                    tile = ty * tiles_x + tx
                    counts[tile] += 1
                    pair_tiles[at] = (tile << BLOCKS) | blocks
                    at += 1
        pair_counts[slot] = at - begin


@njit(cache=True, error_model="numpy", nogil=True)
def sort_pairs(
    chunk,
    chunk_size,
    first,
    record_counts,  # [chunks]
    first_places,  # [chunks]
    pair_tiles,  # [most pairs]
    pair_counts,  # [V]
    free_places,  # [chunks, tiles] next free place of this chunk in each tile's list
    pair_codes,  # out [pairs] record << BLOCKS | blocks, by place: tile by tile, nearest first
    pair_rows,  # out [pairs] place of the pair in pair_tiles
):
    """Sorts the pairs of one chunk into the lists of their tiles."""
    start = first + chunk * chunk_size
    free = free_places[chunk]
    pair = first_places[chunk]
    for slot in range(start, start + record_counts[chunk]):
        for _ in range(pair_counts[slot]):
            tile = pair_tiles[pair] >> BLOCKS
            place = free[tile]
            free[tile] = place + 1
            pair_codes[place] = (slot << BLOCKS) | (pair_tiles[pair] & ((1 << BLOCKS) - 1))
            pair_rows[place] = pair
            pair += 1
