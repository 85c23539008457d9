"""Cut faces where the processor draws: the kernel field on each plane, added up pixel by pixel (DESIGN, section 3).

The section of an ellipsoid with a plane is a Gaussian in the plane: with coordinates s, t there, and the same for each
pixel's point, an atom costs a quadratic and an exponential a pixel, row by row, so that a row is a run of vectors.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.ray_entry import coverage_of, enter_row, facing_of
from engine.render.cpu.tiles import FUSED, falloff
from engine.render.projection import rotation
from engine.scene.constants import CUTOFF_Q, FACE_AMBIENT, FACE_LAMP
from engine.scene.sh import C0

__all__ = ["BAND", "GRID", "SECTION", "add_faces", "bin_bands", "fill_grid", "sections"]

BAND = 8
"""Rows of the picture in a task."""

SECTION = 10
"""Numbers in a record: 0 1 centre s, t; 2 3 4 conic, q / 2 = r2 ds^2 + r3 ds dt + r4 dt^2; 5 q / 2 at which it ends;
6 weight, 7 8 9 weight times RGB."""

GRID = 6
"""Numbers that describe a grid: 0 its first cell (-1: none), 1 2 height and width, 3 4 low s and t, 5 1 / cell."""

LANES = 9
"""Numbers of a pixel while its band is worked on: 0 plane (-1 none), 1 2 s and t, 3 depth, 4 weight, 5 6 7 RGB by
weight, 8 light. All in one array: with several the compiler would have to suspect that they overlap."""


@njit(cache=True, error_model="numpy", nogil=True)
def sections(
    chunk,
    chunk_size,
    rows,  # [N] which atoms
    geometry,  # [A, 10] mean, scales, quat; or [A, 4] mean, sigma
    colours,  # [A, C] RGB in the first three, as coefficients of degree 0 if C > 3
    enlarge,
    plane,  # [4] object space
    e1,  # [3] unit vectors in the plane
    e2,
    matrix,  # [4, 4] object space to camera
    cam,  # packed camera
    records,  # out [N, SECTION]
    boxes,  # out [N, 4] first and end pixel in x and in y
):
    """The sections of some atoms with a plane, and the pixels that they can touch; an empty box where none."""
    ortho, near, width, height = cam.orthographic != 0.0, cam.near, int(cam.width), int(cam.height)
    per_pixel = 1.0 / math.sqrt(cam.fx * cam.fy)
    coefficient, ball = colours.shape[1] > 3, geometry.shape[1] == 4
    upright = rotation(1.0, 0.0, 0.0, 0.0)
    for i in range(chunk * chunk_size, min((chunk + 1) * chunk_size, len(rows))):
        g = geometry[rows[i]]
        boxes[i, :] = 0
        x, y, z = float(g[0]), float(g[1]), float(g[2])
        distance = plane[0] * x + plane[1] * y + plane[2] * z + plane[3]
        fx, fy, fz = x - distance * plane[0], y - distance * plane[1], z - distance * plane[2]
        deep = matrix[2, 0] * fx + matrix[2, 1] * fy + matrix[2, 2] * fz + matrix[2, 3]
        least = 0.5 * per_pixel * (1.0 if ortho else max(deep, near))
        aa, ab, bb, ad, bd, dd, weight = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
        turn = upright if ball else rotation(g[6], g[7], g[8], g[9])
        for k in range(3):
            own = g[3 if ball else 3 + k] * enlarge
            used = max(own, least)
            weight *= own / used
            a = (turn[k] * e1[0] + turn[3 + k] * e1[1] + turn[6 + k] * e1[2]) / used
            b = (turn[k] * e2[0] + turn[3 + k] * e2[1] + turn[6 + k] * e2[2]) / used
            d = -distance * (turn[k] * plane[0] + turn[3 + k] * plane[1] + turn[6 + k] * plane[2]) / used
            aa += a * a
            ab += a * b
            bb += b * b
            ad += a * d
            bd += b * d
            dd += d * d
        det = aa * bb - ab * ab
        if not det > 0.0:
            continue
        ms, mt = (ab * bd - bb * ad) / det, (ab * ad - aa * bd) / det
        nn = max(dd + ms * ad + mt * bd, 0.0)
        left = CUTOFF_Q - nn
        if not left > 0.0:
            continue
        s = e1[0] * x + e1[1] * y + e1[2] * z + ms
        t = e2[0] * x + e2[1] * y + e2[2] * z + mt
        reach_s, reach_t = math.sqrt(left * bb / det), math.sqrt(left * aa / det)
        x0, x1, y0, y1, whole = np.inf, -np.inf, np.inf, -np.inf, False
        for corner in range(4):
            cs = s + (reach_s if corner & 1 else -reach_s)
            ct = t + (reach_t if corner & 2 else -reach_t)
            px = cs * e1[0] + ct * e2[0] - plane[3] * plane[0]
            py = cs * e1[1] + ct * e2[1] - plane[3] * plane[1]
            pz = cs * e1[2] + ct * e2[2] - plane[3] * plane[2]
            cx = matrix[0, 0] * px + matrix[0, 1] * py + matrix[0, 2] * pz + matrix[0, 3]
            cy = matrix[1, 0] * px + matrix[1, 1] * py + matrix[1, 2] * pz + matrix[1, 3]
            cz = matrix[2, 0] * px + matrix[2, 1] * py + matrix[2, 2] * pz + matrix[2, 3]
            over = 1.0 if ortho else cz
            if not over > 1e-9:
                whole = True  # beside or behind the eye: somewhere in the picture
                continue
            u, v = cam.fx * cx / over + cam.cx, cam.fy * cy / over + cam.cy
            x0, x1, y0, y1 = min(x0, u), max(x1, u), min(y0, v), max(y1, v)
        if whole:
            x0, x1, y0, y1 = 0.0, float(width), 0.0, float(height)
        boxes[i, 0], boxes[i, 1] = int(max(math.floor(x0), 0.0)), int(min(math.ceil(x1) + 1.0, width))
        boxes[i, 2], boxes[i, 3] = int(max(math.floor(y0), 0.0)), int(min(math.ceil(y1) + 1.0, height))
        if boxes[i, 0] >= boxes[i, 1] or boxes[i, 2] >= boxes[i, 3]:
            boxes[i, :] = 0
            continue
        weight *= math.exp(-0.5 * nn)
        r = records[i]
        r[0], r[1], r[2], r[3], r[4], r[5], r[6] = s, t, 0.5 * aa, ab, 0.5 * bb, 0.5 * left, weight
        for c in range(3):
            value = float(colours[rows[i], c])
            r[7 + c] = weight * (max(0.5 + C0 * value, 0.0) if coefficient else value)


@njit(cache=True, error_model="numpy", nogil=True)
def bin_bands(boxes, bands):
    """(first (bands + 1,), listed (pairs,)): the records that touch each band of rows, in their order."""
    first = np.zeros(bands + 1, np.int64)
    for i in range(len(boxes)):
        if boxes[i, 3] > boxes[i, 2]:
            for band in range(boxes[i, 2] // BAND, (boxes[i, 3] - 1) // BAND + 1):
                first[band + 1] += 1
    for band in range(bands):
        first[band + 1] += first[band]
    listed = np.empty(first[bands], np.int32)
    at = first[:-1].copy()
    for i in range(len(boxes)):
        if boxes[i, 3] > boxes[i, 2]:
            for band in range(boxes[i, 2] // BAND, (boxes[i, 3] - 1) // BAND + 1):
                listed[at[band]] = i
                at[band] += 1
    return first, listed


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def add_faces(
    band,
    cam,
    planes,  # [P, 4] camera space
    frames,  # [P, 8] e1 and e2 of each plane in camera space, each with its offset: s = e . p + offset
    joined,  # [M, 4] planes of the pieces beside this one, camera space
    first_joined,  # [pieces + 1] where those of each begin
    tolerance,
    first,
    listed,
    boxes,
    records,
    owner,  # [N] plane of each record
    cells,  # [cells, 4] grids of the field of the interior atoms, one after the other
    grids,  # [P, GRID] which of them is each plane's
    edge_sigma,
    light,
    lines,  # [2] first and end row in which a face can be
    fresh,  # whether nothing is in the layer yet
    face,  # in and out [H, W, 4] rgb, coverage
    depths,  # in and out [H, W]
):
    """Puts the faces of one piece into a band of the face layer, the nearest in front."""
    height, width = depths.shape
    top, bottom = band * BAND, min((band + 1) * BAND, height)
    if bottom <= lines[0] or top >= lines[1]:
        if fresh:
            for y in range(top, bottom):
                for k in range(width):
                    face[y, k, 3] = 0.0
        return
    area = BAND * width
    entry, slope, left = np.empty(width), np.empty(width), np.empty(width)
    own = np.empty(width, np.int32)
    lane = np.empty((LANES, BAND, width), np.float32)
    ortho = cam.orthographic != 0.0
    found = False
    for y in range(top, bottom):
        row = y - top
        enter_row(y, cam, planes, joined, first_joined, tolerance, entry, own, slope, left)
        down = (y + 0.5 - cam.cy) / cam.fy
        for k in range(width):
            lane[0, row, k] = own[k]
            lane[3, row, k] = entry[k]
            lane[8, row, k] = 1
        for p in range(len(planes)):
            if light:
                shine(lane[:, row], down, planes, p, cam)
            f = frames[p]
            for k in range(width):
                across = (k + 0.5 - cam.cx) / cam.fx
                ray_s, ray_t = f[0] * across + f[1] * down, f[4] * across + f[5] * down
                here_s = ray_s + f[2] * entry[k] + f[3] if ortho else entry[k] * (ray_s + f[2]) + f[3]
                here_t = ray_t + f[6] * entry[k] + f[7] if ortho else entry[k] * (ray_t + f[6]) + f[7]
                lane[1, row, k] = here_s if own[k] == p else lane[1, row, k]
                lane[2, row, k] = here_t if own[k] == p else lane[2, row, k]
        for k in range(width):
            found |= own[k] >= 0
    if found:
        lane[4:8] = 0
        if len(cells) > 0:
            read_grids(lane, bottom - top, cells, grids)
        flat = lane.reshape(-1)
        for pair in range(first[band], first[band + 1]):
            i = listed[pair]
            r = records[i]
            plane = np.float32(owner[i])
            for y in range(max(boxes[i, 2], top), min(boxes[i, 3], bottom)):
                at = (y - top) * width
                add_row(r, plane, np.uintp(at + boxes[i, 0]), np.uintp(at + boxes[i, 1]), np.uintp(area), flat)
    else:
        lane[0] = -1
    per_pixel = np.float32(1.0 / math.sqrt(cam.fx * cam.fy))
    for y in range(top, bottom):
        finish_row(lane[:, y - top], per_pixel, ortho, np.float32(edge_sigma), fresh, face[y], depths[y])


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def shine(lane, down, planes, p, cam):
    """Fills the light of the pixels of a row that show plane p: a lamp at the eye."""
    for k in range(np.uintp(lane.shape[1])):
        across = (k + 0.5 - cam.cx) / cam.fx
        facing = facing_of(planes[p], across, down, cam.orthographic != 0.0)
        lane[8, k] = FACE_AMBIENT + FACE_LAMP * max(facing, 0.0) if lane[0, k] == p else lane[8, k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def finish_row(lane, per_pixel, ortho, edge_sigma, fresh, face, depths):
    """Puts a row of lanes (LANES, W) over a row of the face layer (W, 4) and its depths (W,). No branch."""
    zero, tiny = np.float32(0), np.float32(1e-20)
    for k in range(np.uintp(len(depths))):
        deep = lane[3, k]
        density = lane[4, k] if lane[0, k] >= zero else zero
        footprint = per_pixel if ortho else per_pixel * deep
        cover = coverage_of(density, footprint, edge_sigma)
        cover = cover if density > zero else zero
        kept = (cover > zero) & (fresh | (face[k, 3] <= zero) | (deep <= depths[k]))
        each = lane[8, k] / max(density, tiny)
        face[k, 0] = each * lane[5, k] if kept else face[k, 0]
        face[k, 1] = each * lane[6, k] if kept else face[k, 1]
        face[k, 2] = each * lane[7, k] if kept else face[k, 2]
        face[k, 3] = cover if kept else (zero if fresh else face[k, 3])
        depths[k] = deep if kept else depths[k]


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def add_row(r, owner, start, end, area, lane):
    """Adds one section to pixels start..end of the band's lanes, which stand `area` apart."""
    s0, t0, aa, ab, bb, limit = r[0], r[1], r[2], r[3], r[4], r[5]
    weight, red, green, blue = r[6], r[7], r[8], r[9]
    zero = r.dtype.type(0)
    two, four, five = area + area, np.uintp(4) * area, np.uintp(5) * area
    six, seven = np.uintp(6) * area, np.uintp(7) * area
    for k in range(start, end):
        ds, dt = lane[area + k] - s0, lane[two + k] - t0
        h = ds * (aa * ds + ab * dt) + bb * dt * dt
        g = falloff(min(h, limit))
        g = g if (h <= limit) & (lane[k] == owner) else zero
        lane[four + k] += g * weight
        lane[five + k] += g * red
        lane[six + k] += g * green
        lane[seven + k] += g * blue


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FUSED)
def read_grids(lane, rows, cells, grids):
    """Starts the sums of a band with what the grids of its planes hold, read with linear interpolation."""
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    last, plane, begin, height, width = np.float32(-1), 0, -1, 0, 0
    low_s, low_t, per_cell, right, bottom = zero, zero, zero, zero, zero
    for row in range(rows):
        for k in range(lane.shape[2]):
            if lane[0, row, k] != last:
                last = lane[0, row, k]
                plane = int(last)
                begin = int(grids[plane, 0]) if plane >= 0 else -1
                height, width = int(grids[plane, 1]), int(grids[plane, 2])
                low_s, low_t = np.float32(grids[plane, 3]), np.float32(grids[plane, 4])
                per_cell = np.float32(grids[plane, 5])
                right, bottom = np.float32(width - 1), np.float32(height - 1)
            if begin < 0:
                continue
            u, v = (lane[1, row, k] - low_s) * per_cell - half, (lane[2, row, k] - low_t) * per_cell - half
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
            lane[4, row, k], lane[5, row, k], lane[6, row, k], lane[7, row, k] = w, red, green, blue


@njit(cache=True, error_model="numpy", nogil=True)
def fill_grid(band, low_s, low_t, cell, first, listed, boxes, records, grid):
    """Adds up a band of a grid (h, w, 4) of weight and RGB by weight, whose cells stand at low + (k + 1/2) cell."""
    height, width = grid.shape[0], grid.shape[1]
    top, bottom = band * BAND, min((band + 1) * BAND, height)
    lane = np.zeros((LANES, BAND, width), np.float32)
    for row in range(bottom - top):
        for k in range(width):
            lane[1, row, k] = low_s + (k + 0.5) * cell
            lane[2, row, k] = low_t + (top + row + 0.5) * cell
    flat, none = lane.reshape(-1), np.float32(0)
    for pair in range(first[band], first[band + 1]):
        i = listed[pair]
        for y in range(max(boxes[i, 2], top), min(boxes[i, 3], bottom)):
            start, end = (y - top) * width + boxes[i, 0], (y - top) * width + boxes[i, 1]
            add_row(records[i], none, np.uintp(start), np.uintp(end), np.uintp(BAND * width), flat)
    for row in range(bottom - top):
        for k in range(width):
            for m in range(4):
                grid[top + row, k, m] = lane[4 + m, row, k]
