"""The frame where the processor draws: colours of the splats, layers put together by depth, half floats."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.cpu.opaque_splats import project
from engine.formula import MIN_WEIGHT
from engine.gl.software_faces import BAND
from engine.sh import C0

__all__ = ["compose", "gather", "pack"]


@njit(cache=True, error_model="numpy", nogil=True)
def gather(  # type: ignore[no-untyped-def]
    chunk,
    chunk_size,
    rows,  # [N]
    geometry,  # [A, 10] mean, scales, quat
    packed,  # [A, 4 V] coefficients of spherical harmonics, three channels each
    degree,
    enlarge,
    eye,  # [3] object space; orthographic: the viewing direction
    parallel,
    means,  # out [N, 3]
    scales,  # out [N, 3]
    quats,  # out [N, 4]
    colours,  # out [N, 3]
    cam,
    planes,  # [P, 4] camera space, and which of them (first and end) bound these splats
    lot,
    records,  # out [N, RECORD]
    spans,  # out [N, 6]
):
    """Copies some splats to where they are drawn from, with the colour that they show to the eye, and projects them."""
    basis = np.zeros(16)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(rows))):
        g, f = geometry[rows[i]], packed[rows[i]]
        x, y, z = eye[0], eye[1], eye[2]
        if not parallel:
            x, y, z = g[0] - x, g[1] - y, g[2] - z
            length = max(math.sqrt(x * x + y * y + z * z), 1e-30)
            x, y, z = x / length, y / length, z / length
        basis[0] = C0
        if degree >= 1:
            basis[1], basis[2], basis[3] = -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x
        if degree >= 2:
            basis[4], basis[5] = 1.0925484305920792 * x * y, -1.0925484305920792 * y * z
            basis[6] = 0.31539156525252005 * (2.0 * z * z - x * x - y * y)
            basis[7], basis[8] = -1.0925484305920792 * x * z, 0.5462742152960396 * (x * x - y * y)
        if degree >= 3:
            basis[9] = -0.5900435899266435 * y * (3.0 * x * x - y * y)
            basis[10] = 2.890611442640554 * x * y * z
            basis[11] = -0.4570457994644658 * y * (4.0 * z * z - x * x - y * y)
            basis[12] = 0.3731763325901154 * z * (2.0 * z * z - 3.0 * x * x - 3.0 * y * y)
            basis[13] = -0.4570457994644658 * x * (4.0 * z * z - x * x - y * y)
            basis[14] = 1.445305721320277 * z * (x * x - y * y)
            basis[15] = -0.5900435899266435 * x * (x * x - 3.0 * y * y)
        red, green, blue = 0.5, 0.5, 0.5
        for k in range((degree + 1) * (degree + 1)):
            red += basis[k] * f[3 * k]
            green += basis[k] * f[3 * k + 1]
            blue += basis[k] * f[3 * k + 2]
        colours[i, 0], colours[i, 1], colours[i, 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
        for c in range(3):
            means[i, c] = g[c]
            scales[i, c] = g[3 + c] * enlarge
        for c in range(4):
            quats[i, c] = g[6 + c]
    project(chunk, chunk_size, cam, planes, lot, means, scales, quats, records, spans)


@njit(cache=True, error_model="numpy", nogil=True)
def compose(  # type: ignore[no-untyped-def]
    band,
    x0,
    y0,
    sums,  # [h, w, 5] weight, sharpness, RGB
    front,  # [h, w]
    faces,  # whether there are any
    face,  # [h, w, 4]
    depths,  # [h, w]
    tolerance,
    background,
    group,
    below,  # whether something is in the frame already
    frame,  # in and out [H, W, 3]
    info,  # in and out [H, W, 2] as in shaders/resolve.frag.glsl
    nothing,
):
    """Resolves a band of one group and puts it into the frame: shaders/resolve.frag.glsl, line by line."""
    for at in range(band * BAND * sums.shape[1], min((band + 1) * BAND, len(sums)) * sums.shape[1]):
        row, k = at // sums.shape[1], at % sums.shape[1]
        y, x = y0 + row, x0 + k
        weight = sums[row, k, 0]
        z = front[row, k] if front[row, k] < nothing else nothing
        alpha, red, green, blue = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
        one, half = np.float32(1), np.float32(0.5)
        if weight > MIN_WEIGHT:
            alpha = min(max(half + (weight - half) * sums[row, k, 1] / weight, np.float32(0)), one)
            each = alpha / weight
            red, green, blue = each * sums[row, k, 2], each * sums[row, k, 3], each * sums[row, k, 4]
        if faces and face[row, k, 3] > 0:
            cover = face[row, k, 3]
            first = depths[row, k] <= z + tolerance
            over, under = (cover, one - cover) if first else ((one - alpha) * cover, one)
            red = over * face[row, k, 0] + under * red
            green = over * face[row, k, 1] + under * green
            blue = over * face[row, k, 2] + under * blue
            if cover >= half and (first or alpha < half):
                z = depths[row, k]
            alpha = one - (one - cover) * (one - alpha)
        if below:
            before_z = info[y, x, 0]
            before_group = np.floor(info[y, x, 1] * half)
            before = info[y, x, 1] - 2 * before_group
            if z <= before_z:
                frame[y, x, 0] = red + (one - alpha) * frame[y, x, 0]
                frame[y, x, 1] = green + (one - alpha) * frame[y, x, 1]
                frame[y, x, 2] = blue + (one - alpha) * frame[y, x, 2]
            else:
                frame[y, x, 0] += (one - before) * (red - alpha * background[0])
                frame[y, x, 1] += (one - before) * (green - alpha * background[1])
                frame[y, x, 2] += (one - before) * (blue - alpha * background[2])
            nearer = z < before_z or (before_group < 0 and alpha > 0)
            both = one - (one - alpha) * (one - before)
            info[y, x, 0] = min(z, before_z)
            info[y, x, 1] = 2 * (group if nearer else before_group) + both
        else:
            frame[y, x, 0] = red + (one - alpha) * background[0]
            frame[y, x, 1] = green + (one - alpha) * background[1]
            frame[y, x, 2] = blue + (one - alpha) * background[2]
            info[y, x, 0] = z
            info[y, x, 1] = 2 * group + alpha if alpha > 0 else np.float32(-2)


@njit(cache=True, error_model="numpy", nogil=True)
def pack(band, x0, y0, bits, halves):  # type: ignore[no-untyped-def]
    """A band of a rectangle of the frame as half floats RGBA (h, w, 4).

    `bits` (H, W, 3) is the frame's RGB seen as int32. What is below 2^-14 becomes 0; the largest half float stays one.
    """
    for row in range(band * BAND, min((band + 1) * BAND, len(halves))):
        for k in range(halves.shape[1]):
            for c in range(3):
                b = np.int32(bits[y0 + row, x0 + k, c])
                value = ((b + np.int32(0x0FFF) + ((b >> 13) & 1)) >> 13) - np.int32(112 << 10)
                if b < np.int32(113 << 23):
                    value = np.int32(0)
                elif value > np.int32(0x7BFF):
                    value = np.int32(0x7BFF)
                halves[row, k, c] = np.uint16(value)
            halves[row, k, 3] = np.uint16(0x3C00)
