"""The frame in software: colours of the splats, layers composited by depth, conversion to half floats."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.cpu.software_sections import BAND
from engine.render.cpu.splats import Splats, project
from engine.render.cpu.weights import BEFORE, BEHIND, FUSED
from engine.render.projection import CameraRecord
from engine.scene.constants import MIN_WEIGHT
from engine.scene.sh import fill_basis

__all__ = ["FrameArrays", "GroupLayers", "HalfFloats", "SplatBatch", "SplatView", "compose", "gather", "pack"]


class SplatView(NamedTuple):
    """What projects and colours the splats of one piece. A named tuple, which numba can read."""

    cam: CameraRecord
    eye: NDArray[np.float64]
    """(3,). Object space; orthographic: the viewing direction."""
    planes: NDArray[np.float64]
    """(P, 4). Planes of all pieces, camera space."""
    plane_range: NDArray[np.int64]
    """(2,). First and end of the planes that bound this piece."""
    degree: int
    """Degree of the spherical harmonics."""


class SplatBatch(NamedTuple):
    """Memory for N gathered splats. A named tuple, which numba can read."""

    splats: Splats
    colours: NDArray[np.float32]
    """(N, 3). RGB as the eye sees it."""
    records: NDArray[np.float32]
    """(N, RECORD)."""
    spans: NDArray[np.int32]
    """(N, 6)."""


class GroupLayers(NamedTuple):
    """Sums of the pieces that lie together, in a rectangle h x w of the frame. A named tuple, which numba can read."""

    x: int
    """Corner of the rectangle, pixels."""
    y: int
    sums: NDArray[np.float32]
    """(h, w, SUMS). Sums of the outside, as in `engine.render.cpu.weights`."""
    front: NDArray[np.float32]
    """(h, w). Depth of the nearest core, world units."""
    has_faces: bool
    """Whether `face` and `depths` hold anything."""
    face: NDArray[np.float32]
    """(h, w, 4). RGB and coverage of the cut faces."""
    depths: NDArray[np.float32]
    """(h, w). Depth of the cut faces, world units."""
    tolerance: np.float32
    """A splat no more than this in front of a face counts as behind it, world units."""
    number: np.float32
    """Number of the group."""


class FrameArrays(NamedTuple):
    """The frame so far. A named tuple, which numba can read."""

    rgb: NDArray[np.float32]
    """(H, W, 3)."""
    info: NDArray[np.float32]
    """(H, W, 2). As in shaders/resolve.frag.glsl."""
    background: NDArray[np.float32]
    """(3,)."""
    nothing: np.float32
    """Depth of a pixel that shows nothing."""


class HalfFloats(NamedTuple):
    """A rectangle of the frame as half floats. A named tuple, which numba can read."""

    x: int
    """Corner of the rectangle, pixels."""
    y: int
    rgba: NDArray[np.uint16]
    """(h, w, 4)."""


@njit(cache=True, error_model="numpy", nogil=True)
def gather(
    chunk,
    chunk_size,
    atoms,  # AtomBatch of ellipsoids
    view,  # SplatView
    out,  # SplatBatch
):
    """Copies some splats, with the colours that the eye sees, and projects them."""
    rows, geometry, packed = atoms.rows, atoms.geometry, atoms.colours
    eye, degree = view.eye, view.degree
    means, scales, quats = out.splats.means, out.splats.scales, out.splats.quats
    colours = out.colours
    basis = np.zeros(16)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(rows))):
        g, f = geometry[rows[i]], packed[rows[i]]
        x, y, z = eye[0], eye[1], eye[2]
        if view.cam.orthographic == 0.0:
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
            scales[i, c] = g[3 + c] * atoms.enlarge
        for c in range(4):
            quats[i, c] = g[6 + c]
    project(chunk, chunk_size, view.cam, view.planes, view.plane_range, out.splats, out.records, out.spans)


@njit(cache=True, error_model="numpy", nogil=True)
def compose(
    band,
    group,  # GroupLayers
    frame,  # in and out FrameArrays
    over_earlier,  # whether the frame already holds another group
    half_floats,  # out HalfFloats
    last,  # whether no group follows: then the pixels go to `half_floats`, not to the frame
):
    """Resolves a band of one group and puts it into the frame: shaders/resolve.frag.glsl, line by line."""
    x0, y0, front, background, number = group.x, group.y, group.front, frame.background, group.number
    width = front.shape[1]
    one, two, half = np.float32(1), np.float32(2), np.float32(0.5)
    lane, pixels = np.empty((5, width), np.float32), np.empty((width, 3), np.float32)
    for row in range(band * BAND, min((band + 1) * BAND, len(front))):
        resolve_row(row, group, frame.nothing, lane)
        before, info = frame.rgb[y0 + row, x0 : x0 + width], frame.info[y0 + row, x0 : x0 + width]
        for k in range(np.uintp(width)):
            z, alpha, red, green, blue = lane[0, k], lane[1, k], lane[2, k], lane[3, k], lane[4, k]
            left = one - alpha
            if over_earlier:
                before_z = info[k, 0]
                before_group = np.floor(info[k, 1] * half)
                rest = one - (info[k, 1] - two * before_group)
                if z <= before_z:
                    pixels[k, 0] = red + left * before[k, 0]
                    pixels[k, 1] = green + left * before[k, 1]
                    pixels[k, 2] = blue + left * before[k, 2]
                else:
                    pixels[k, 0] = before[k, 0] + rest * (red - alpha * background[0])
                    pixels[k, 1] = before[k, 1] + rest * (green - alpha * background[1])
                    pixels[k, 2] = before[k, 2] + rest * (blue - alpha * background[2])
                nearer = z < before_z or (before_group < 0 and alpha > 0)
                info[k, 0] = min(z, before_z)
                info[k, 1] = two * (number if nearer else before_group) + one - left * rest
            else:
                pixels[k, 0] = red + left * background[0]
                pixels[k, 1] = green + left * background[1]
                pixels[k, 2] = blue + left * background[2]
                info[k, 0] = z
                info[k, 1] = two * number + alpha if alpha > 0 else -two
        if last:
            x, y = x0 - half_floats.x, y0 - half_floats.y + row
            to_half_floats(pixels.view(np.int32), half_floats.rgba[y, x : x + width])
        else:
            # Number by number: for whole slices numba would also compile an error message, which takes seconds.
            for k in range(np.uintp(width)):
                for c in range(np.uintp(3)):
                    before[k, c] = pixels[k, c]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def resolve_row(row, group, nothing, lane):
    """Depth, coverage and RGB by coverage (5, W) of a row of one group: its splats under or over its faces.

    Without branches, so that it compiles to vector instructions.
    """
    sums, front, face, depths = group.sums[row], group.front[row], group.face[row], group.depths[row]
    has_faces, tolerance = group.has_faces, group.tolerance
    one, half, zero = np.float32(1), np.float32(0.5), np.float32(0)
    least, tiny = np.float32(MIN_WEIGHT), np.float32(1e-37)
    for k in range(np.uintp(len(front))):
        weight, first, rest = sums[k, 0], sums[k, BEFORE], sums[k, BEHIND]
        z = min(front[k], nothing)
        each = one / max(weight, least)
        layer = min(max(half + (weight - half) * sums[k, 1] * each, zero), one) if weight > least else zero
        each_before = one / max(first, least)
        before = min(max(half + (first - half) * sums[k, BEFORE + 1] * each_before, zero), one)
        before = before if (first > least) & (weight > least) else zero
        behind = min(max(half + (rest - half) * sums[k, BEHIND + 1] / max(rest, least), zero), one)
        layer *= one - before
        behind = (one - before - layer) * behind if (rest > least) & (weight > least) else zero
        alpha = layer + before + behind
        each *= layer
        each_before *= before
        each_behind = behind / max(sums[k, BEHIND + 5], tiny)
        red = each * sums[k, 2] + each_before * sums[k, BEFORE + 2] + each_behind * sums[k, BEHIND + 2]
        green = each * sums[k, 3] + each_before * sums[k, BEFORE + 3] + each_behind * sums[k, BEHIND + 3]
        blue = each * sums[k, 4] + each_before * sums[k, BEFORE + 4] + each_behind * sums[k, BEHIND + 4]
        cover = face[k, 3] if has_faces else zero
        first = depths[k] <= z + tolerance
        # Without coverage the face layer holds arbitrary values.
        visible = cover > zero
        over = cover if first else (one - alpha) * cover
        under = one - cover if first else one
        red = over * face[k, 0] + under * red if visible else red
        green = over * face[k, 1] + under * green if visible else green
        blue = over * face[k, 2] + under * blue if visible else blue
        lane[0, k] = depths[k] if visible & (cover >= half) & (first | (alpha < half)) else z
        lane[1, k] = one - (one - cover) * (one - alpha)
        lane[2, k], lane[3, k], lane[4, k] = red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def pack(band, x, y, part, half_floats):
    """Writes a band of a part (h, w, 3) of the frame, whose corner is x, y, into the half floats."""
    width = part.shape[1]
    left, top = x - half_floats.x, y - half_floats.y
    for row in range(band * BAND, min((band + 1) * BAND, len(part))):
        to_half_floats(part[row].view(np.int32), half_floats.rgba[top + row, left : left + width])


@njit(cache=True, error_model="numpy", nogil=True)
def to_half_floats(bits, half_floats):
    """RGB (W, 3), float32 viewed as int32, as half floats RGBA (W, 4).

    Values below 2^-14 become 0; those above the largest half float are clamped to it.
    """
    for k in range(np.uintp(len(bits))):
        for c in range(np.uintp(3)):
            b = np.int32(bits[k, c])
            value = ((b + np.int32(0x0FFF) + ((b >> 13) & 1)) >> 13) - np.int32(112 << 10)
            value = min(value, np.int32(0x7BFF)) if b >= np.int32(113 << 23) else np.int32(0)
            half_floats[k, c] = np.uint16(value)
        half_floats[k, 3] = np.uint16(0x3C00)
