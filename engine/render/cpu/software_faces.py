"""Cut faces in software: the kernel field on each plane, summed pixel by pixel.

The section of an ellipsoid with a plane is a Gaussian in the plane. With coordinates s, t in the plane for atoms and
pixels alike, an atom costs a quadratic and an exponential per pixel, in rows that compile to vector instructions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.render.cpu.ray_entry import PieceBounds, coverage_of, enter_row, face_light, facing_of, skin_part
from engine.render.cpu.software_sections import BAND
from engine.render.cpu.weights import FUSED, falloff
from engine.render.projection import CameraRecord

__all__ = ["GRID", "PieceFaces", "add_faces", "fill_grid"]

GRID = 6
"""Numbers that describe a grid: 0 its first cell (-1: none), 1 2 height and width, 3 4 low s and t, 5 1 / cell."""

PLANE, S, T, DEPTH, WEIGHT, RED, GREEN, BLUE, SKIN, SKIN_RED, SKIN_GREEN, SKIN_BLUE, LIGHT = range(13)
LANES = 13
"""Numbers of a pixel while its band is computed: plane (-1 none), its coordinates there, depth, sums of weight and of
RGB by weight of the interior and of the skin, light. One array: with several the compiler would have to assume that
they overlap."""


class PieceFaces(NamedTuple):
    """The faces of one piece, and the sections and grids that colour them. A named tuple, which numba can read."""

    cam: CameraRecord
    bounds: PieceBounds
    frames: NDArray[np.float64]
    """(P, 8). e1 and e2 of each plane in camera space, each with its offset: s = e . p + offset."""
    sections: NDArray[np.float32]
    """(N, SECTION)."""
    boxes: NDArray[np.int32]
    """(N, 4). Pixels that each section can touch, first and end in x and in y."""
    planes: NDArray[np.int32]
    """(N,). The plane of each section."""
    skin: NDArray[np.bool_]
    """(N,). Whether it is the section of a skin's atom."""
    band_starts: NDArray[np.int64]
    """(bands + 1,). Where the list of each band begins in `section_ids`."""
    section_ids: NDArray[np.int32]
    """(pairs,). Sections of the bands."""
    cells: NDArray[np.float32]
    """(cells, 4). Grids of the field of the interior atoms, one after another."""
    grids: NDArray[np.float64]
    """(P, GRID). Each plane's grid."""
    edge_sigma: float
    """Half the pitch, world units."""
    lit: bool
    """Whether a lamp at the eye shades the faces."""
    rows: NDArray[np.float64]
    """(2,). First and end row in which a face can be."""


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def add_faces(
    band,
    faces,  # PieceFaces
    fresh,  # whether the layer is still empty
    face,  # in and out [H, W, 4] rgb, coverage
    depths,  # in and out [H, W]
):
    """Puts the faces of one piece into a band of the face layer, the nearest in front."""
    cam, planes, frames, boxes = faces.cam, faces.bounds.planes, faces.frames, faces.boxes
    height, width = depths.shape
    top, bottom = band * BAND, min((band + 1) * BAND, height)
    if bottom <= faces.rows[0] or top >= faces.rows[1]:
        if fresh:
            for y in range(top, bottom):
                for k in range(width):
                    face[y, k, 3] = 0.0
        return
    area = BAND * width
    entry, distance, touching = np.empty(width), np.empty(width), np.empty(width)
    through = np.empty(width, np.int32)
    lane = np.empty((LANES, BAND, width), np.float32)
    orthographic = cam.orthographic != 0.0
    any_face = False
    for y in range(top, bottom):
        row = y - top
        enter_row(y, cam, faces.bounds, entry, through, distance, touching)
        down = (y + 0.5 - cam.cy) / cam.fy
        for k in range(width):
            lane[PLANE, row, k] = through[k]
            lane[DEPTH, row, k] = entry[k]
            lane[LIGHT, row, k] = 1
        for p in range(len(planes)):
            if faces.lit:
                light_row(lane[:, row], down, planes, p, cam)
            f = frames[p]
            for k in range(width):
                across = (k + 0.5 - cam.cx) / cam.fx
                ray_s, ray_t = f[0] * across + f[1] * down, f[4] * across + f[5] * down
                here_s = ray_s + f[2] * entry[k] + f[3] if orthographic else entry[k] * (ray_s + f[2]) + f[3]
                here_t = ray_t + f[6] * entry[k] + f[7] if orthographic else entry[k] * (ray_t + f[6]) + f[7]
                lane[S, row, k] = here_s if through[k] == p else lane[S, row, k]
                lane[T, row, k] = here_t if through[k] == p else lane[T, row, k]
        for k in range(width):
            any_face |= through[k] >= 0
    if any_face:
        lane[WEIGHT:LIGHT] = 0
        if len(faces.cells) > 0:
            read_grids(lane, bottom - top, faces.cells, faces.grids)
        flat = lane.reshape(-1)
        for pair in range(faces.band_starts[band], faces.band_starts[band + 1]):
            i = faces.section_ids[pair]
            r = faces.sections[i]
            plane, sums = np.float32(faces.planes[i]), SKIN if faces.skin[i] else WEIGHT
            for y in range(max(boxes[i, 2], top), min(boxes[i, 3], bottom)):
                at = (y - top) * width
                start, end = np.uintp(at + boxes[i, 0]), np.uintp(at + boxes[i, 1])
                add_row(r, plane, start, end, np.uintp(area), np.uintp(sums * area), flat)
    else:
        lane[PLANE] = -1
    per_pixel = np.float32(1.0 / math.sqrt(cam.fx * cam.fy))
    for y in range(top, bottom):
        finish_row(lane[:, y - top], per_pixel, orthographic, np.float32(faces.edge_sigma), fresh, face[y], depths[y])


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def light_row(lane, down, planes, p, cam):
    """Fills the light of a row's pixels on plane p: a lamp at the eye."""
    for k in range(np.uintp(lane.shape[1])):
        across = (k + 0.5 - cam.cx) / cam.fx
        facing = facing_of(planes[p], across, down, cam.orthographic != 0.0)
        lane[LIGHT, k] = face_light(max(facing, 0.0)) if lane[PLANE, k] == p else lane[LIGHT, k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def finish_row(lane, per_pixel, orthographic, edge_sigma, fresh, face, depths):
    """Puts a row of lanes (LANES, W) over a row of the face layer (W, 4) and its depths (W,), without branches."""
    zero, tiny = np.float32(0), np.float32(1e-20)
    for k in range(np.uintp(len(depths))):
        deep = lane[DEPTH, k]
        interior, skin = lane[WEIGHT, k], lane[SKIN, k]
        density = interior + skin if lane[PLANE, k] >= zero else zero
        footprint = per_pixel if orthographic else per_pixel * deep
        cover = coverage_of(density, footprint, edge_sigma)
        cover = cover if density > zero else zero
        kept = (cover > zero) & (fresh | (face[k, 3] <= zero) | (deep <= depths[k]))
        part = skin_part(interior)
        each = lane[LIGHT, k] / max(interior + part * skin, tiny)
        face[k, 0] = each * (lane[RED, k] + part * lane[SKIN_RED, k]) if kept else face[k, 0]
        face[k, 1] = each * (lane[GREEN, k] + part * lane[SKIN_GREEN, k]) if kept else face[k, 1]
        face[k, 2] = each * (lane[BLUE, k] + part * lane[SKIN_BLUE, k]) if kept else face[k, 2]
        face[k, 3] = cover if kept else (zero if fresh else face[k, 3])
        depths[k] = deep if kept else depths[k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def add_row(r, plane, start, end, area, sums, lane):
    """Adds one section of a plane to pixels start..end of a band's flattened lanes, which are `area` apart; its sums
    begin at `sums`."""
    s0, t0, aa, ab, bb, limit = r[0], r[1], r[2], r[3], r[4], r[5]
    weight, red, green, blue = r[6], r[7], r[8], r[9]
    zero = r.dtype.type(0)
    two, red_sums = area + area, sums + area
    green_sums, blue_sums = red_sums + area, red_sums + area + area
    for k in range(start, end):
        ds, dt = lane[area + k] - s0, lane[two + k] - t0
        h = ds * (aa * ds + ab * dt) + bb * dt * dt
        g = falloff(min(h, limit))
        g = g if (h <= limit) & (lane[k] == plane) else zero
        lane[sums + k] += g * weight
        lane[red_sums + k] += g * red
        lane[green_sums + k] += g * green
        lane[blue_sums + k] += g * blue


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def read_grids(lane, rows, cells, grids):
    """Starts the sums of a band with the grids of its planes, read with bilinear interpolation."""
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    last, plane, begin, height, width = np.float32(-1), 0, -1, 0, 0
    low_s, low_t, per_cell, right, bottom = zero, zero, zero, zero, zero
    for row in range(rows):
        for k in range(lane.shape[2]):
            if lane[PLANE, row, k] != last:
                last = lane[PLANE, row, k]
                plane = int(last)
                begin = int(grids[plane, 0]) if plane >= 0 else -1
                height, width = int(grids[plane, 1]), int(grids[plane, 2])
                low_s, low_t = np.float32(grids[plane, 3]), np.float32(grids[plane, 4])
                per_cell = np.float32(grids[plane, 5])
                right, bottom = np.float32(width - 1), np.float32(height - 1)
            if begin < 0:
                continue
            u, v = (lane[S, row, k] - low_s) * per_cell - half, (lane[T, row, k] - low_t) * per_cell - half
            if not (u >= zero and v >= zero and u < right and v < bottom):
                continue
            x, y = int(u), int(v)
            b, d = u - np.float32(x), v - np.float32(y)
            a, c = one - b, one - d
            p, q, r, s = a * c, b * c, a * d, b * d
            at = np.uintp(begin + y * width + x)
            under = at + np.uintp(width)
            next_at, next_under = at + np.uintp(1), under + np.uintp(1)
            w = p * cells[at, 0] + q * cells[next_at, 0] + r * cells[under, 0] + s * cells[next_under, 0]
            red = p * cells[at, 1] + q * cells[next_at, 1] + r * cells[under, 1] + s * cells[next_under, 1]
            green = p * cells[at, 2] + q * cells[next_at, 2] + r * cells[under, 2] + s * cells[next_under, 2]
            blue = p * cells[at, 3] + q * cells[next_at, 3] + r * cells[under, 3] + s * cells[next_under, 3]
            lane[WEIGHT, row, k] = w
            lane[RED, row, k], lane[GREEN, row, k], lane[BLUE, row, k] = red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def fill_grid(band, low_s, low_t, cell, band_starts, section_ids, boxes, sections, grid):
    """Sums a band of a grid (h, w, 4) of weight and RGB by weight; cell k has its centre at low + (k + 1/2) cell."""
    height, width = grid.shape[0], grid.shape[1]
    top, bottom = band * BAND, min((band + 1) * BAND, height)
    lane = np.zeros((LANES, BAND, width), np.float32)
    for row in range(bottom - top):
        for k in range(width):
            lane[S, row, k] = low_s + (k + 0.5) * cell
            lane[T, row, k] = low_t + (top + row + 0.5) * cell
    flat, plane = lane.reshape(-1), np.float32(0)
    for pair in range(band_starts[band], band_starts[band + 1]):
        i = section_ids[pair]
        for y in range(max(boxes[i, 2], top), min(boxes[i, 3], bottom)):
            start, end = (y - top) * width + boxes[i, 0], (y - top) * width + boxes[i, 1]
            area = np.uintp(BAND * width)
            add_row(sections[i], plane, np.uintp(start), np.uintp(end), area, np.uintp(WEIGHT) * area, flat)
    for row in range(bottom - top):
        for k in range(width):
            for m in range(4):
                grid[top + row, k, m] = lane[WEIGHT + m, row, k]
