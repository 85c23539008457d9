"""The frame where the processor draws: colours of the splats, layers put together by depth, half floats."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.splats import project
from engine.render.cpu.tiles import FUSED
from engine.render.cpu.window_faces import BAND
from engine.scene.constants import MIN_WEIGHT
from engine.scene.sh import fill_basis

__all__ = ["compose", "gather", "pack"]


@njit(cache=True, error_model="numpy", nogil=True)
def gather(
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
        fill_basis(x, y, z, (degree + 1) * (degree + 1), basis)
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
def compose(
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
    last,  # whether nothing follows: then the pixels go to `halves`, not to the frame
    x1,  # where the corner of `halves` is
    y1,
    halves,  # out [h', w', 4]
):
    """Resolves a band of one group and puts it into the frame: shaders/resolve.frag.glsl, line by line."""
    width = front.shape[1]
    one, two, half = np.float32(1), np.float32(2), np.float32(0.5)
    lane, pixels = np.empty((5, width), np.float32), np.empty((width, 3), np.float32)
    for row in range(band * BAND, min((band + 1) * BAND, len(front))):
        layers(sums[row], front[row], faces, face[row], depths[row], tolerance, nothing, lane)
        before, told = frame[y0 + row, x0 : x0 + width], info[y0 + row, x0 : x0 + width]
        for k in range(np.uintp(width)):
            z, alpha, red, green, blue = lane[0, k], lane[1, k], lane[2, k], lane[3, k], lane[4, k]
            left = one - alpha
            if below:
                before_z = told[k, 0]
                before_group = np.floor(told[k, 1] * half)
                rest = one - (told[k, 1] - two * before_group)
                if z <= before_z:
                    pixels[k, 0] = red + left * before[k, 0]
                    pixels[k, 1] = green + left * before[k, 1]
                    pixels[k, 2] = blue + left * before[k, 2]
                else:
                    pixels[k, 0] = before[k, 0] + rest * (red - alpha * background[0])
                    pixels[k, 1] = before[k, 1] + rest * (green - alpha * background[1])
                    pixels[k, 2] = before[k, 2] + rest * (blue - alpha * background[2])
                nearer = z < before_z or (before_group < 0 and alpha > 0)
                told[k, 0] = min(z, before_z)
                told[k, 1] = two * (group if nearer else before_group) + one - left * rest
            else:
                pixels[k, 0] = red + left * background[0]
                pixels[k, 1] = green + left * background[1]
                pixels[k, 2] = blue + left * background[2]
                told[k, 0] = z
                told[k, 1] = two * group + alpha if alpha > 0 else -two
        if last:
            to_halves(pixels.view(np.int32), halves[y0 - y1 + row, x0 - x1 : x0 - x1 + width])
        else:
            before[:] = pixels


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def layers(sums, front, faces, face, depths, tolerance, nothing, lane):
    """Depth, coverage and RGB by coverage (5, W) of a row of one group: its splats under or over its faces.

    No branch, so that a row is a run of vectors.
    """
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    for k in range(np.uintp(len(front))):
        weight = sums[k, 0]
        z = min(front[k], nothing)
        each = one / max(weight, np.float32(MIN_WEIGHT))
        alpha = min(max(half + (weight - half) * sums[k, 1] * each, zero), one)
        alpha = alpha if weight > np.float32(MIN_WEIGHT) else zero
        each *= alpha
        red, green, blue = each * sums[k, 2], each * sums[k, 3], each * sums[k, 4]
        cover = face[k, 3] if faces else zero
        first = depths[k] <= z + tolerance
        # A face without coverage may hold anything.
        shows = cover > zero
        over = cover if first else (one - alpha) * cover
        under = one - cover if first else one
        red = over * face[k, 0] + under * red if shows else red
        green = over * face[k, 1] + under * green if shows else green
        blue = over * face[k, 2] + under * blue if shows else blue
        lane[0, k] = depths[k] if shows & (cover >= half) & (first | (alpha < half)) else z
        lane[1, k] = one - (one - cover) * (one - alpha)
        lane[2, k], lane[3, k], lane[4, k] = red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def pack(band, x0, y0, frame, x1, y1, halves):
    """A band of a part (h, w, 3) of the frame, whose corner is x0, y0, as half floats into those with corner x1, y1."""
    width = frame.shape[1]
    for row in range(band * BAND, min((band + 1) * BAND, len(frame))):
        to_halves(frame[row].view(np.int32), halves[y0 - y1 + row, x0 - x1 : x0 - x1 + width])


@njit(cache=True, error_model="numpy", nogil=True)
def to_halves(bits, halves):
    """RGB (W, 3), float32 seen as int32, as half floats RGBA (W, 4).

    What is below 2^-14 becomes 0; the largest half float stays one.
    """
    for k in range(np.uintp(len(bits))):
        for c in range(np.uintp(3)):
            b = np.int32(bits[k, c])
            value = ((b + np.int32(0x0FFF) + ((b >> 13) & 1)) >> 13) - np.int32(112 << 10)
            value = min(value, np.int32(0x7BFF)) if b >= np.int32(113 << 23) else np.int32(0)
            halves[k, c] = np.uint16(value)
        halves[k, 3] = np.uint16(0x3C00)
