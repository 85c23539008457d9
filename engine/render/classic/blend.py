"""The pixel loops: front-to-back compositing of the Gaussians of a tile, and its derivative, back to front.

A block, two rows of a tile, has 16 pixels: as many as the widest vector registers hold, and few enough that a small
splat skips the blocks above and below it. The list of pairs says which ones. Computed here, the branch would be
mispredicted for nearly every splat, and resolved only once its record has been loaded.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from engine.render.classic.records import (
    BLUE,
    DEPTH,
    GREEN,
    LOG_OPACITY,
    RED,
    U_FRACTION,
    V_FRACTION,
    WHITEN_XX,
    WHITEN_YX,
    WHITEN_YY,
    U,
    V,
)
from engine.render.classic.tiles import BLOCKS, SIDE, TAIL_BITS
from engine.render.lanes import absolute, any_of, exp2, fma, load16, minimum, row_sums, store, where
from engine.scene.constants import MAX_ALPHA, MIN_TRANSMITTANCE

__all__ = [
    "ADJOINT",
    "BLOCK",
    "ROW",
    "STATE",
    "UNTOUCHED",
    "blend",
    "blend_backward",
    "resolve",
    "start_tile",
]

BLOCK = 2 * SIDE
"""Pixels in a block."""

STATE = 6
"""Numbers per pixel that go from slice to slice, each in a run of BLOCK: 0 transmittance, negative once the pixel has
ended; 1 2 3 colour; 4 depth times weight; 5 median depth, 0 as long as more than half of the light is left."""

ADJOINT = 6
"""Numbers per pixel on the way back, each in a run of BLOCK: 0 transmittance behind the current layer; 1 the derivative
of the loss with respect to it; 2 3 4 5 dL/d(colour, depth times weight)."""

ROW = BLOCK
"""Numbers of the gradient row of a (tile, Gaussian) pair, sums over its pixels; 64 bytes in float32, one cache line.

With p = dL/dalpha * alpha, w the pixel's weight and m, n as in a record: 0 p, 1 p m, 2 p m^2, 3 p n, 4 p n m, 5 p n^2,
then w times the picture's gradient in 6 7 8 colour, 9 depth. The rest is 0."""

UNTOUCHED = -2
"""Last record of a tile without pairs, which shows the background. -1 if it has pairs but none was drawn."""

FIRST = np.array([0] + [(blocks & -blocks).bit_length() - 1 for blocks in range(1, 1 << BLOCKS)])
END = np.array([blocks.bit_length() for blocks in range(1 << BLOCKS)])
"""First and one past last of a pair's blocks, which are adjacent, by its bits."""

BATCH = 64
"""Pairs that go through the blocks of a tile together: a block's pixels stay in registers meanwhile, and a block whose
pixels have all ended is skipped from the next batch on."""


@njit(cache=True, error_model="numpy")
def _centres(kind):
    """((2 + BLOCKS) * BLOCK,) of the float type of `kind`: a tile's pixel centres, from its corner.

    x of a block, the same for all; zeros; then y of each block.
    """
    out = np.zeros((2 + BLOCKS) * BLOCK, kind.dtype)
    for i in range(BLOCK):
        out[i] = i % SIDE + 0.5
        for block in range(BLOCKS):
            out[(2 + block) * BLOCK + i] = 2 * block + i // SIDE + 0.5
    return out


@njit(cache=True, error_model="numpy")
def _columns(across, u, a, b, light):
    """m, the part of n, and the part of log2(alpha) that the columns decide."""
    dx = across - u
    m = dx * a
    return m, dx * b, fma(-m, m, light)


@njit(cache=True, error_model="numpy")
def _rows(down, v, c, n, power):
    """(alpha, n) from the parts of `_columns`; alpha is 2^(light - m^2 - n^2), and 0 where that is under 1/255."""
    n = fma(down - v, c, n)
    power = fma(-n, n, power)
    return where(power >= -TAIL_BITS, minimum(exp2(power), MAX_ALPHA), 0.0), n


@njit(cache=True, error_model="numpy", nogil=True)
def blend(
    task,
    tiles_per_task,
    part,  # Slice
    frame,  # in out Frame: states, lasts and tile_lasts
    open_tiles,  # in out [tiles_y, tiles_x]
):
    """Composites the pairs of a slice into the tiles of one task; closes tiles that have become opaque."""
    tiles, tile_starts, pair_codes = part.tiles, part.tile_starts, part.pair_codes
    states, lasts, tile_lasts = frame.states, frame.lasts, frame.tile_lasts
    number = states.dtype.type
    tiles_x = open_tiles.shape[1]
    centres = _centres(states)
    listed, counts = np.empty((BLOCKS, BATCH), np.int32), np.empty(BLOCKS, np.int64)
    for index in range(task * tiles_per_task, min((task + 1) * tiles_per_task, len(tiles))):
        tile = tiles[index]
        ty = tile // tiles_x
        tx = tile - ty * tiles_x
        if tile_lasts[tile] == UNTOUCHED:
            start_tile(states[tile], lasts[tile], tx * SIDE, ty * SIDE, frame.width, frame.height)
        left, top = number(tx * SIDE), number(ty * SIDE)
        open_blocks = (1 << BLOCKS) - 1
        end = tile_starts[tile + 1]
        for at in range(tile_starts[tile], end, BATCH):
            _list_blocks(pair_codes[at : min(at + BATCH, end)], listed, counts)
            for block in range(BLOCKS):
                if (open_blocks >> block) & 1 and not _blend_block(
                    listed[block, : counts[block]],
                    frame.records,
                    left,
                    top,
                    load16(centres, 0),
                    load16(centres, (2 + block) * BLOCK),
                    states[tile, block],
                    lasts[tile, block],
                ):
                    open_blocks ^= 1 << block
            if open_blocks == 0:
                open_tiles[ty, tx] = 0
                break
        tile_lasts[tile] = lasts[tile].max()


@njit(cache=True, error_model="numpy")
def start_tile(states, lasts, left, top, width, height):
    """The empty pixels of a tile; those outside the picture count as finished."""
    states[:] = 0
    lasts[:] = -1
    for block in range(BLOCKS):
        for i in range(BLOCK):
            x, y = left + i % SIDE, top + 2 * block + i // SIDE
            states[block, i] = 1 if x < width and y < height else -1


@njit(cache=True, error_model="numpy")
def _list_blocks(codes, listed, counts):
    """Sorts the records of some pairs by the blocks that they touch: listed (BLOCKS, BATCH), counts (BLOCKS,).

    Without a branch, which would be mispredicted half of the time.
    """
    n0 = n1 = n2 = n3 = 0
    for k in range(len(codes)):
        code = codes[k]
        slot = code >> BLOCKS
        listed[0, n0], listed[1, n1], listed[2, n2], listed[3, n3] = slot, slot, slot, slot
        n0 += code & 1
        n1 += (code >> 1) & 1
        n2 += (code >> 2) & 1
        n3 += (code >> 3) & 1
    counts[0], counts[1], counts[2], counts[3] = n0, n1, n2, n3


@njit(cache=True, error_model="numpy")
def _blend_block(slots, records, left, top, across, down, s, last_drawn):
    """Composites records into the state of one block; returns whether any of its pixels is still open."""
    before, last = load16(s, 0), load16(last_drawn, 0)
    red, green, blue = load16(s, BLOCK), load16(s, 2 * BLOCK), load16(s, 3 * BLOCK)
    depth, median = load16(s, 4 * BLOCK), load16(s, 5 * BLOCK)
    for k in range(len(slots)):
        q = records[slots[k]]
        _, n, power = _columns(across, (q[U] - left) + q[U_FRACTION], q[WHITEN_XX], q[WHITEN_YX], q[LOG_OPACITY])
        alpha, _ = _rows(down, (q[V] - top) + q[V_FRACTION], q[WHITEN_YY], n, power)
        after = fma(alpha, -before, before)
        drawn = after >= MIN_TRANSMITTANCE
        w = where(drawn, alpha * before, 0.0)
        median = where(before >= 0.5, where(after < 0.5, q[DEPTH], median), median)
        before = where(drawn, after, -absolute(before))
        red = fma(w, q[RED], red)
        green = fma(w, q[GREEN], green)
        blue = fma(w, q[BLUE], blue)
        depth = fma(w, q[DEPTH], depth)
        last = where(w > 0.0, slots[k], last)
    store(s, 0, before)
    store(s, BLOCK, red)
    store(s, 2 * BLOCK, green)
    store(s, 3 * BLOCK, blue)
    store(s, 4 * BLOCK, depth)
    store(s, 5 * BLOCK, median)
    store(last_drawn, 0, last)
    return any_of(before > 0.0)


@njit(cache=True, error_model="numpy", nogil=True)
def blend_backward(
    task,
    tiles_per_task,
    part,  # Slice
    frame,  # Frame
    gradient,  # PictureGradient
    begun,  # in out [all tiles] whether the tile's adjoints are set
    adjoints,  # in out [all tiles, BLOCKS, ADJOINT * BLOCK]
    rows,  # out [most pairs, ROW], unchanged if the tile was closed before the pair
):
    """Walks back through the pairs of a slice in the tiles of one task and writes each pair's sums over its pixels.

    A record's rows are adjacent: scattered writes cost nothing beside this much arithmetic, scattered reads would.

    With s_i = c_i . dL/dC + z_i dL/dD and R_i = dL/d(transmittance behind layer i), which for the last layer is
    bg . dL/dC - dL/dA: dL/dalpha_i = T_i (s_i - R_i), and R_(i-1) = R_i + alpha_i (s_i - R_i).
    """
    tiles, tile_starts, pair_codes = part.tiles, part.tile_starts, part.pair_codes
    lasts, tile_lasts = frame.lasts, frame.tile_lasts
    tiles_x = (frame.width + SIDE - 1) // SIDE
    number = adjoints.dtype.type
    centres = _centres(adjoints)
    across, nothing = load16(centres, 0), load16(centres, BLOCK)
    block_last = np.empty(BLOCKS, np.int32)
    for index in range(task * tiles_per_task, min((task + 1) * tiles_per_task, len(tiles))):
        tile = tiles[index]
        ty = tile // tiles_x
        tx = tile - ty * tiles_x
        if not begun[tile]:
            begun[tile] = 1
            _start_backward(frame.states[tile], gradient, tx * SIDE, ty * SIDE, adjoints[tile])
        left, top = number(tx * SIDE), number(ty * SIDE)
        for block in range(BLOCKS):
            block_last[block] = lasts[tile, block].max()
        for at in range(tile_starts[tile + 1] - 1, tile_starts[tile] - 1, -1):
            slot = pair_codes[at] >> BLOCKS
            if slot > tile_lasts[tile]:
                continue
            blocks = pair_codes[at]
            q = frame.records[slot]
            v = (q[V] - top) + q[V_FRACTION]
            m, n_part, power = _columns(
                across, (q[U] - left) + q[U_FRACTION], q[WHITEN_XX], q[WHITEN_YX], q[LOG_OPACITY]
            )
            p_sum, pn_sum, pnn_sum = nothing, nothing, nothing
            red, green, blue, depth = nothing, nothing, nothing, nothing
            for block in range(FIRST[blocks & (len(FIRST) - 1)], END[blocks & (len(END) - 1)]):
                if slot > block_last[block]:
                    continue
                s = adjoints[tile, block]
                alpha, n = _rows(load16(centres, (2 + block) * BLOCK), v, q[WHITEN_YY], n_part, power)
                alpha = where(load16(lasts[tile, block], 0) >= slot, alpha, 0.0)
                g_red, g_green, g_blue = load16(s, 2 * BLOCK), load16(s, 3 * BLOCK), load16(s, 4 * BLOCK)
                before = load16(s, 0) / (1.0 - alpha)
                behind = load16(s, BLOCK)
                w = alpha * before
                shade = fma(g_red, q[RED], fma(g_green, q[GREEN], g_blue * q[BLUE]))
                if gradient.has_depth:
                    g_far = load16(s, 5 * BLOCK)
                    shade = fma(g_far, q[DEPTH], shade)
                    depth = fma(w, g_far, depth)
                more = shade - behind
                store(s, 0, before)
                store(s, BLOCK, fma(alpha, more, behind))
                p = where(alpha < MAX_ALPHA, w * more, 0.0)
                pn = p * n
                p_sum = p_sum + p
                pn_sum = pn_sum + pn
                pnn_sum = fma(pn, n, pnn_sum)
                red = fma(w, g_red, red)
                green = fma(w, g_green, green)
                blue = fma(w, g_blue, blue)
            pm_sum = p_sum * m
            sums = row_sums((p_sum, pm_sum, pm_sum * m, pn_sum, pn_sum * m, pnn_sum, red, green, blue, depth))
            store(rows[part.pair_rows[at]], 0, sums)


@njit(cache=True, error_model="numpy")
def _start_backward(states, gradient, left, top, out):
    """The picture's gradient for a tile: states (BLOCKS, STATE * BLOCK), out (BLOCKS, ADJOINT * BLOCK)."""
    g_rgb, g_alpha, g_depth = gradient.rgb, gradient.alpha, gradient.depth
    height, width = g_alpha.shape
    if top + SIDE > height or left + SIDE > width:
        out[:] = 0
    for y in range(top, min(top + SIDE, height)):
        block, shift = (y - top) // 2, np.uintp((y - top) % 2 * SIDE)
        _start_backward_row(
            states[block], gradient.background, g_rgb[y, left:], g_alpha[y, left:], g_depth[y, left:], shift, out[block]
        )


@njit(cache=True, error_model="numpy")
def _start_backward_row(states, background, g_rgb, g_alpha, g_depth, shift, out):
    """Fills the ADJOINT runs of a tile's row of pixels, which begins at `shift` in each."""
    for x in range(np.uintp(min(SIDE, len(g_alpha)))):
        i = shift + x
        red, green, blue = g_rgb[x, 0], g_rgb[x, 1], g_rgb[x, 2]
        behind = background[0] * red + background[1] * green + background[2] * blue - g_alpha[x]
        left = abs(states[i])
        out[i] = left
        out[np.uintp(BLOCK) + i] = behind
        out[np.uintp(2 * BLOCK) + i] = red
        out[np.uintp(3 * BLOCK) + i] = green
        out[np.uintp(4 * BLOCK) + i] = blue
        out[np.uintp(5 * BLOCK) + i] = g_depth[x]


@njit(cache=True, error_model="numpy", nogil=True)
def resolve(task, rows_per_task, states, tile_lasts, background, rgb, alpha, depth, median):
    """Writes the rows of tiles of one task to rgb (H, W, 3), over the background (3,), alpha, depth times weight and
    median depth (H, W)."""
    height, width = alpha.shape
    tiles_x = (width + SIDE - 1) // SIDE
    one = states.dtype.type(1)
    first = task * rows_per_task * tiles_x
    for tile in range(first, min(first + rows_per_task * tiles_x, len(states))):
        top, corner = tile // tiles_x * SIDE, tile % tiles_x * SIDE
        if tile_lasts[tile] == UNTOUCHED:
            # Number by number: for whole slices numba would also compile an error message, which takes seconds.
            for line in range(top, min(top + SIDE, height)):
                for column in range(corner, min(corner + SIDE, width)):
                    for c in range(3):
                        rgb[line, column, c] = background[c]
            alpha[top : top + SIDE, corner : corner + SIDE] = 0
            depth[top : top + SIDE, corner : corner + SIDE] = 0
            median[top : top + SIDE, corner : corner + SIDE] = 0
            continue
        for y in range(top, min(top + SIDE, height)):
            part, shift = states[tile, (y - top) // 2], np.uintp((y - top) % 2 * SIDE)
            row_rgb, row_alpha = rgb[y, corner:], alpha[y, corner:]
            row_depth, row_median = depth[y, corner:], median[y, corner:]
            for x in range(np.uintp(min(SIDE, len(row_alpha)))):
                i = shift + x
                left = abs(part[i])
                row_rgb[x, 0] = part[np.uintp(BLOCK) + i] + left * background[0]
                row_rgb[x, 1] = part[np.uintp(2 * BLOCK) + i] + left * background[1]
                row_rgb[x, 2] = part[np.uintp(3 * BLOCK) + i] + left * background[2]
                row_alpha[x] = one - left
                row_depth[x] = part[np.uintp(4 * BLOCK) + i]
                row_median[x] = part[np.uintp(5 * BLOCK) + i]
