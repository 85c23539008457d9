"""The pixel loops: front-to-back compositing of the Gaussians of a tile, and its derivative, back to front.

A block, two rows of a tile, has 16 pixels: as many as the widest vector registers hold, so that the compiler turns the
loop over it into straight vector code (it has no branch and a length known when compiling), and few enough that a small
splat skips the blocks above and below it. Which ones is noted in the list of pairs: were it computed here, the branch
would be guessed wrongly at nearly every splat, and known only when the record of the splat has come from memory.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.extending import intrinsic, overload

from engine.cpu.tiles import BLOCKS, SIDE, TAIL_BITS

__all__ = [
    "ADJOINT",
    "BLOCK",
    "MAX_ALPHA",
    "MIN_TRANSMITTANCE",
    "ROW",
    "STATE",
    "blend",
    "blend_backward",
    "resolve",
    "start",
    "start_backward",
]

BLOCK = 2 * SIDE
"""Pixels in a block."""

MAX_ALPHA = float(np.float32(0.99))
"""No Gaussian covers more: its derivative, which divides by 1 - alpha, stays finite. The float32 number in all
precisions: two such layers leave (1 - 0.99)^2, a hair under MIN_TRANSMITTANCE, and all must agree that they end it."""

MIN_TRANSMITTANCE = 1e-4
"""A layer that would leave less light than this is not drawn and ends the pixel, as in INRIA's renderer."""

STATE = 5
"""Numbers per pixel that go from slice to slice, each in a run of BLOCK: 0 transmittance, negative once the pixel has
ended; 1 2 3 colour; 4 depth times weight."""

ADJOINT = 6
"""Numbers per pixel on the way back, each in a run of BLOCK: 0 transmittance behind the current layer; 1 that times
the derivative of the loss by it; 2 3 4 5 dL/d(colour, depth times weight)."""

ROW = BLOCK
"""Numbers that a (tile, Gaussian) pair hands back, sums over its pixels; 64 bytes in float32, one cache line.

With p = dL/dalpha * alpha, w the pixel's weight and m, n as in a record: 0 p, 1 p m, 2 p m^2, 3 p n, 4 p n m, 5 p n^2,
then w times the picture's gradient in 6 7 8 colour, 9 depth. The rest is 0."""

CHECK = 16
"""Pairs between two looks at whether the tile has become opaque."""

ROUND = 12582912.0  # 1.5 * 2^23: adding it to a float32 leaves the nearest whole number in the lowest bits


@intrinsic
def _float_bits(typingctx, x):  # type: ignore[no-untyped-def]
    """The bits of a float32 as int32."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.IntType(32))

    return types.int32(types.float32), codegen


@intrinsic
def _bits_float(typingctx, x):  # type: ignore[no-untyped-def]
    """The float32 of these bits."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.int32), codegen


@intrinsic
def _fold(typingctx, lanes, slope, middle, row):  # type: ignore[no-untyped-def]
    """Writes the sums over lanes (7, BLOCK) that a pair hands back to row (ROW,), in the order of `ROW`.

    The columns' m = slope * (middle + -3.5..3.5) comes in here, as it is the same in every block.

    Halves are added to halves, for all sums at once, until every number of one vector is one of the sums. The compiler
    may not reorder a plain loop of float additions, and would add number after number.
    """

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = context.get_data_type(signature.args[0].dtype)
        vector, align = ir.VectorType(kind, BLOCK), context.get_abi_sizeof(kind)
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        start = builder.bitcast(data, vector.as_pointer())
        p, pn, pnn, *colours = (
            builder.load(builder.gep(start, [ir.Constant(ir.IntType(64), k)]), align=align) for k in range(7)
        )
        columns = ir.Constant(vector, [i % SIDE - 0.5 * (SIDE - 1) for i in range(BLOCK)])
        undefined = ir.Constant(vector, ir.Undefined)
        spread = ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), [0] * BLOCK)
        everywhere = [
            builder.shuffle_vector(
                builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0)), undefined, spread
            )
            for scalar in args[1:3]
        ]
        m = builder.fmul(everywhere[0], builder.fadd(columns, everywhere[1]))
        pm = builder.fmul(p, m)
        vectors = [p, pm, builder.fmul(pm, m), pn, builder.fmul(pn, m), pnn, *colours]
        vectors += [ir.Constant(vector, [0.0] * BLOCK)] * (BLOCK - len(vectors))
        half = BLOCK // 2
        while half:
            low = [k for k in range(2 * BLOCK) if k % (2 * half) < half]
            first, second = (
                ir.Constant(ir.VectorType(ir.IntType(32), BLOCK), [k + shift for k in low]) for shift in (0, half)
            )
            vectors = [
                builder.fadd(builder.shuffle_vector(a, b, first), builder.shuffle_vector(a, b, second))
                for a, b in zip(vectors[::2], vectors[1::2], strict=True)
            ]
            half //= 2
        out = context.make_array(signature.args[3])(context, builder, args[3]).data
        builder.store(vectors[0], builder.bitcast(out, vector.as_pointer()), align=align)
        return context.get_dummy_value()

    return types.none(lanes, lanes.dtype, lanes.dtype, row), codegen


def exp2(x):  # type: ignore[no-untyped-def]
    """2^x for -100 < x < 100. In float32 a polynomial, because the library's is a call and stops vectorisation."""
    return 2.0**x


@overload(exp2)
def _exp2(x):  # type: ignore[no-untyped-def]
    if x is not types.float32:
        return lambda x: math.exp(x * 0.6931471805599453)

    def exp2_float32(x):  # type: ignore[no-untyped-def]
        shifted = x + np.float32(ROUND)
        r = x - (shifted - np.float32(ROUND))  # -0.5 .. 0.5
        y = np.float32(1.5353362e-4)
        y = y * r + np.float32(1.3398874e-3)
        y = y * r + np.float32(9.6184373e-3)
        y = y * r + np.float32(5.5503324e-2)
        y = y * r + np.float32(2.4022648e-1)
        y = y * r + np.float32(6.9314720e-1)
        y = y * r + np.float32(1.0)
        bits = _float_bits(y) + (_float_bits(shifted) << np.int32(23))  # type: ignore[call-arg]
        return _bits_float(bits)

    return exp2_float32


@njit(cache=True, error_model="numpy", nogil=True)
def blend(  # type: ignore[no-untyped-def]
    task,
    tiles_per_task,
    tiles,  # [T] tiles that have pairs
    tile_starts,  # [all tiles + 1]
    pair_codes,  # [pairs]
    records,  # [V, RECORD]
    states,  # in out [all tiles, BLOCKS, STATE * BLOCK]
    lasts,  # in out [all tiles, BLOCKS, BLOCK] place of the last record drawn
    open_tiles,  # in out [tiles_y, tiles_x]
):
    """Goes on compositing the tiles of one task with the pairs of a slice; closes tiles that have become opaque."""
    number = states.dtype.type
    zero, half, one = number(0), number(0.5), number(1)
    least, most, dark = number(-TAIL_BITS), number(MAX_ALPHA), number(MIN_TRANSMITTANCE)
    tiles_x = open_tiles.shape[1]
    for index in range(task * tiles_per_task, min((task + 1) * tiles_per_task, len(tiles))):
        tile = tiles[index]
        ty = tile // tiles_x
        tx = tile - ty * tiles_x
        left, top = number(tx * SIDE), number(ty * SIDE)
        open_blocks = (1 << BLOCKS) - 1
        at = tile_starts[tile]
        end = tile_starts[tile + 1]
        while at < end:
            batch = min(at + CHECK, end)
            while at < batch:
                slot = pair_codes[at] >> BLOCKS
                blocks = pair_codes[at] & open_blocks
                at += 1
                q = records[slot]
                u, v = (q[0] - left) + q[1], (q[2] - top) + q[3]
                a, b, c, light = q[4], q[5], q[6], q[7]
                red, green, blue, depth = q[8], q[9], q[10], q[11]
                for block in range(BLOCKS):
                    if not (blocks >> block) & 1:
                        continue
                    s = states[tile, block]
                    last_drawn = lasts[tile, block]
                    y = number(2 * block) + half - v
                    for i in range(BLOCK):
                        dx = number(i & (SIDE - 1)) + half - u
                        m = a * dx
                        n = b * dx + c * (y + number(i // SIDE))
                        power = light - (m * m + n * n)
                        alpha = min(exp2(power), most)
                        alpha = alpha if power >= least else zero
                        before = s[i]
                        after = before * (one - alpha)
                        going = after >= dark
                        w = alpha * before if going else zero
                        s[i] = after if going else min(before, -before)
                        s[BLOCK + i] += w * red
                        s[2 * BLOCK + i] += w * green
                        s[3 * BLOCK + i] += w * blue
                        s[4 * BLOCK + i] += w * depth
                        last_drawn[i] = slot if w > zero else last_drawn[i]
            open_blocks = 0
            for block in range(BLOCKS):
                open_pixels = 0
                for i in range(BLOCK):
                    open_pixels += states[tile, block, i] > zero
                open_blocks |= (open_pixels > 0) << block
            if open_blocks == 0:
                open_tiles[ty, tx] = 0
                break


@njit(cache=True, error_model="numpy", nogil=True)
def blend_backward(  # type: ignore[no-untyped-def]
    task,
    tiles_per_task,
    tiles,  # [T] tiles that have pairs
    tiles_x,
    tile_starts,  # [all tiles + 1]
    pair_codes,  # [pairs]
    records,  # [V, RECORD]
    lasts,  # [all tiles, BLOCKS, BLOCK]
    tile_lasts,  # [all tiles] greatest of them
    adjoints,  # in out [all tiles, BLOCKS, ADJOINT * BLOCK]
    rows,  # out [pairs, ROW], left alone where the tile was closed before the pair
):
    """Walks back through the pairs of a slice in the tiles of one task and writes each pair's sums over its pixels.

    With s_i = c_i . dL/dC + z_i dL/dD the loss is sum w_i s_i + T_end (bg . dL/dC - dL/dA) + const, hence
    dL/dalpha_i = T_i s_i - B_i / (1 - alpha_i), B_i the same sum over the layers behind i and the background.
    """
    number = adjoints.dtype.type
    zero, half, one = number(0), number(0.5), number(1)
    least, most = number(-TAIL_BITS), number(MAX_ALPHA)
    lanes = np.empty((7, BLOCK), adjoints.dtype)
    block_last = np.empty(BLOCKS, np.int32)
    for index in range(task * tiles_per_task, min((task + 1) * tiles_per_task, len(tiles))):
        tile = tiles[index]
        ty = tile // tiles_x
        left, top = number((tile - ty * tiles_x) * SIDE), number(ty * SIDE)
        for block in range(BLOCKS):
            block_last[block] = lasts[tile, block].max()
        for at in range(tile_starts[tile + 1] - 1, tile_starts[tile] - 1, -1):
            slot = pair_codes[at] >> BLOCKS
            if slot > tile_lasts[tile]:
                continue
            blocks = pair_codes[at]
            q = records[slot]
            u, v = (q[0] - left) + q[1], (q[2] - top) + q[3]
            a, b, c, light = q[4], q[5], q[6], q[7]
            red, green, blue, depth = q[8], q[9], q[10], q[11]
            lanes[:] = zero
            for block in range(BLOCKS):
                if not (blocks >> block) & 1 or slot > block_last[block]:
                    continue
                s = adjoints[tile, block]
                last_drawn = lasts[tile, block]
                y = number(2 * block) + half - v
                for i in range(BLOCK):
                    m = a * (number(i & (SIDE - 1)) + half - u)
                    n = b * (number(i & (SIDE - 1)) + half - u) + c * (y + number(i // SIDE))
                    power = light - (m * m + n * n)
                    alpha = min(exp2(power), most)
                    alpha = alpha if (power >= least) & (slot <= last_drawn[i]) else zero
                    share = one / (one - alpha)
                    before = s[i] * share
                    w = alpha * before
                    shade = s[2 * BLOCK + i] * red + s[3 * BLOCK + i] * green + s[4 * BLOCK + i] * blue
                    shade = shade + s[5 * BLOCK + i] * depth
                    behind = s[BLOCK + i]
                    p = (before * shade - behind * share) * (alpha if alpha < most else zero)
                    s[i] = before
                    s[BLOCK + i] = behind + w * shade
                    lanes[0, i] += p
                    lanes[1, i] += p * n
                    lanes[2, i] += p * n * n
                    lanes[3, i] += w * s[2 * BLOCK + i]
                    lanes[4, i] += w * s[3 * BLOCK + i]
                    lanes[5, i] += w * s[4 * BLOCK + i]
                    lanes[6, i] += w * s[5 * BLOCK + i]
            _fold(lanes, a, number(0.5 * SIDE) - u, rows[at])  # type: ignore[call-arg]


@njit(cache=True, error_model="numpy", nogil=True)
def start_backward(  # type: ignore[no-untyped-def]
    task,
    rows_per_task,  # rows of tiles
    states,  # [all tiles, BLOCKS, STATE * BLOCK]
    background,  # [3]
    g_rgb,  # [H, W, 3]
    g_alpha,  # [H, W]
    g_depth,  # [H, W]
    adjoints,  # out [all tiles, BLOCKS, ADJOINT * BLOCK]
):
    """The picture's gradient for the rows of tiles of one task, in the order of the tiles."""
    height, width = g_alpha.shape
    tiles_x = (width + SIDE - 1) // SIDE
    first = task * rows_per_task
    adjoints[first * tiles_x : (first + rows_per_task) * tiles_x] = 0
    for y in range(first * SIDE, min((first + rows_per_task) * SIDE, height)):
        for x in range(width):
            tile, block = (y // SIDE) * tiles_x + x // SIDE, (y % SIDE) // 2
            i = (y % 2) * SIDE + x % SIDE
            s = adjoints[tile, block]
            left = abs(states[tile, block, i])
            red, green, blue = g_rgb[y, x, 0], g_rgb[y, x, 1], g_rgb[y, x, 2]
            s[i] = left
            s[BLOCK + i] = left * (background[0] * red + background[1] * green + background[2] * blue - g_alpha[y, x])
            s[2 * BLOCK + i], s[3 * BLOCK + i], s[4 * BLOCK + i] = red, green, blue
            s[5 * BLOCK + i] = g_depth[y, x]


@njit(cache=True, error_model="numpy", nogil=True)
def start(task, rows_per_task, states, lasts, width, height):  # type: ignore[no-untyped-def]
    """Empty pixels for the rows of tiles of one task; those outside of the picture count as finished."""
    number = states.dtype.type
    tiles_x = (width + SIDE - 1) // SIDE
    first = task * rows_per_task * tiles_x
    for tile in range(first, min(first + rows_per_task * tiles_x, len(states))):
        ty = tile // tiles_x
        tx = tile - ty * tiles_x
        for block in range(BLOCKS):
            s = states[tile, block]
            s[:] = number(0)
            for i in range(BLOCK):
                x = tx * SIDE + i % SIDE
                y = ty * SIDE + 2 * block + i // SIDE
                s[i] = number(1) if x < width and y < height else number(-1)
                lasts[tile, block, i] = -1


@njit(cache=True, error_model="numpy", nogil=True)
def resolve(task, rows_per_task, states, background, rgb, alpha, depth):  # type: ignore[no-untyped-def]
    """Writes the rows of tiles of one task to rgb (H, W, 3), over the background (3,), alpha and depth (H, W)."""
    height, width = alpha.shape
    tiles_x = (width + SIDE - 1) // SIDE
    one = states.dtype.type(1)
    first = task * rows_per_task * SIDE
    for y in range(first, min(first + rows_per_task * SIDE, height)):
        for x in range(width):
            s = states[(y // SIDE) * tiles_x + x // SIDE, (y % SIDE) // 2]
            i = (y % 2) * SIDE + x % SIDE
            left = abs(s[i])
            rgb[y, x, 0] = s[BLOCK + i] + left * background[0]
            rgb[y, x, 1] = s[2 * BLOCK + i] + left * background[1]
            rgb[y, x, 2] = s[3 * BLOCK + i] + left * background[2]
            alpha[y, x] = one - left
            depth[y, x] = s[4 * BLOCK + i]
