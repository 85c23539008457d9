"""Kernels of the kernel field: the terms at points, found through a grid or, in a picture of a plane, atom by atom.

A point finds the dozen atoms that reach it among about fifty in the grid's cells; on a plane it is faster to ask each
atom which pixels it reaches.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from engine.render.cpu.ray_entry import skin_part
from engine.scene.constants import CUTOFF_Q

__all__ = [
    "POINTS",
    "REACH",
    "ROWS",
    "atoms_near_plane",
    "colour_faces",
    "count_terms",
    "count_terms_on",
    "fill_terms",
    "fill_terms_on",
    "sort_by_cell",
    "sum_terms",
]

POINTS = 2048
"""Points in a task: many tasks, so that the cores finish together, but each long compared with a call."""

ROWS = 16
"""Rows of the picture in a task."""

REACH = 3.0001
"""Standard deviations at which an atom is cut off, with a margin for rounding."""

SPREAD = 3
"""Most cells around a run of points that share their search, over those around the first of them."""

MARGIN = 1e-3
"""Pixels by which an atom's box is widened, against rounding."""


@njit(cache=True, nogil=True)
def atoms_near_plane(grid, corner, across, down, most, rows, boxes):
    """Finds the atoms of a level that reach a picture's plane: rows (n,), ascending, and boxes (n, 4), x0 x1 y0 y1 of
    the pixels they may reach, first to one past last. Returns their number. Pixel (x, y) is at corner + x across + y
    down."""
    xx = across[0] * across[0] + across[1] * across[1] + across[2] * across[2]
    xy = across[0] * down[0] + across[1] * down[1] + across[2] * down[2]
    yy = down[0] * down[0] + down[1] * down[1] + down[2] * down[2]
    det = xx * yy - xy * xy
    c0, c1, c2 = corner[0] - grid.origin[0], corner[1] - grid.origin[1], corner[2] - grid.origin[2]
    count = 0
    for i in range(len(grid.shapes)):
        x, y, z = grid.shapes[i, 0] - c0, grid.shapes[i, 1] - c1, grid.shapes[i, 2] - c2
        least = min(min(grid.shapes[i, 3], grid.shapes[i, 4]), min(grid.shapes[i, 5], most))
        reach = REACH / np.float64(least)
        ax, ay = x * across[0] + y * across[1] + z * across[2], x * down[0] + y * down[1] + z * down[2]
        u, v = (yy * ax - xy * ay) / det, (xx * ay - xy * ax) / det
        left = reach * reach - (x * x + y * y + z * z - u * ax - v * ay)  # squared reach within the plane
        if not left > 0.0:
            continue
        wide, high = math.sqrt(left * yy / det) + MARGIN, math.sqrt(left * xx / det) + MARGIN
        rows[count] = i
        boxes[count, 0] = math.ceil(min(max(u - wide, 0.0), 1e9))
        boxes[count, 1] = math.floor(min(max(u + wide, -1.0), 1e9)) + 1
        boxes[count, 2] = math.ceil(min(max(v - high, 0.0), 1e9))
        boxes[count, 3] = math.floor(min(max(v + high, -1.0), 1e9)) + 1
        count += boxes[count, 1] > boxes[count, 0] and boxes[count, 3] > boxes[count, 2]
    return count


@njit(cache=True)
def _slot(x, scale, n):
    """Cell of a coordinate along an axis of n cells; coordinates outside belong to the border cells."""
    i = x * scale
    if not i > 0:
        return 0
    return int(i) if i < n else n - 1


@njit(cache=True)
def sort_by_cell(position, scale, nx, ny, nz):
    """Stable counting sort by cell: first (cells + 1,) and the order (n,)."""
    first = np.zeros(nx * ny * nz + 1, np.int32)
    cell = np.empty(len(position), np.int32)
    for i in range(len(position)):
        x, y, z = _slot(position[i, 0], scale, nx), _slot(position[i, 1], scale, ny), _slot(position[i, 2], scale, nz)
        cell[i] = (z * ny + y) * nx + x
        first[cell[i] + 1] += 1
    for c in range(nx * ny * nz):
        first[c + 1] += first[c]
    cursor = first[:-1].copy()
    order = np.empty(len(position), np.int32)
    for i in range(len(position)):
        order[cursor[cell[i]]] = i
        cursor[cell[i]] += 1
    return first, order


@njit(cache=True)
def _weight(i, point, most, shapes, axes):
    """w_i at a point; -1 beyond the cutoff."""
    q, ratio = _distance(i, point, most, shapes, axes)
    if q > np.float32(CUTOFF_Q):
        return np.float32(-1)
    return math.exp(np.float32(-0.5) * q) * ratio


@njit(cache=True)
def _distance(i, point, most, shapes, axes):
    """(q_i, ratio of volumes) at a point: the factor on the weight of an atom widened to the footprint."""
    x, y, z = point[0] - shapes[i, 0], point[1] - shapes[i, 1], point[2] - shapes[i, 2]
    a, b, c = shapes[i, 3], shapes[i, 4], shapes[i, 5]
    if len(axes) > 0:
        u = axes[i, 0, 0] * x + axes[i, 0, 1] * y + axes[i, 0, 2] * z
        v = axes[i, 1, 0] * x + axes[i, 1, 1] * y + axes[i, 1, 2] * z
        w = axes[i, 2, 0] * x + axes[i, 2, 1] * y + axes[i, 2, 2] * z
        x, y, z = u, v, w
    ratio = np.float32(1)
    if a > most:
        ratio *= most / a
        a = most
    if b > most:
        ratio *= most / b
        b = most
    if c > most:
        ratio *= most / c
        c = most
    x, y, z = x * a, y * b, z * c
    return x * x + y * y + z * z, ratio


@njit(cache=True)
def _cells_within(p, reach, grid):
    """Cells within reach of p, ends included: x0, x1, y0, y1, z0, z1; x1 < x0 if there are none."""
    for k in range(3):
        if p[k] + reach < grid.box[0, k] or p[k] - reach > grid.box[1, k] or not reach >= 0:
            return 0, -1, 0, -1, 0, -1
    if reach <= np.float32(REACH) * grid.largest:
        x, y, z = _slot(p[0], grid.scale, grid.nx), _slot(p[1], grid.scale, grid.ny), _slot(p[2], grid.scale, grid.nz)
        if grid.is_isolated[(z * grid.ny + y) * grid.nx + x]:
            return 0, -1, 0, -1, 0, -1
    return (
        _slot(p[0] - reach, grid.scale, grid.nx),
        _slot(p[0] + reach, grid.scale, grid.nx),
        _slot(p[1] - reach, grid.scale, grid.ny),
        _slot(p[1] + reach, grid.scale, grid.ny),
        _slot(p[2] - reach, grid.scale, grid.nz),
        _slot(p[2] + reach, grid.scale, grid.nz),
    )


@njit(cache=True)
def _local(point, origin):
    """A point relative to the level's origin, float32."""
    return (
        np.float32(point[0] - origin[0]),
        np.float32(point[1] - origin[1]),
        np.float32(point[2] - origin[2]),
    )


@njit(cache=True)
def _reach(most, largest):
    """Distance beyond which no atom of a level has a term."""
    return np.float32(REACH) * max(largest, np.float32(1) / most)


@njit(cache=True)
def _run_from(p, end, points, most, grid):
    """The points from p on whose cells within reach lie close together: one past the last of them, and these cells."""
    x0, x1, y0, y1, z0, z1 = _cells_within(_local(points[p], grid.origin), _reach(most[p], grid.largest), grid)
    stop, room = p + 1, SPREAD * (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1)
    while stop < end:
        a0, a1, b0, b1, c0, c1 = _cells_within(
            _local(points[stop], grid.origin), _reach(most[stop], grid.largest), grid
        )
        a0, a1, b0, b1, c0, c1 = min(a0, x0), max(a1, x1), min(b0, y0), max(b1, y1), min(c0, z0), max(c1, z1)
        if (a1 - a0 + 1) * (b1 - b0 + 1) * (c1 - c0 + 1) > room:
            break
        x0, x1, y0, y1, z0, z1 = a0, a1, b0, b1, c0, c1
        stop += 1
    return stop, (x0, x1, y0, y1, z0, z1)


@njit(cache=True)
def _gather(cells, grid, near, columns):
    """Copies what `_reached` reads of the atoms in some cells: their number n, near (2, n), whose first row holds their
    rows in the level, ascending, and columns (16, n). The arrays are new ones if those given are too small."""
    x0, x1, y0, y1, z0, z1 = cells
    count = np.int64(0)
    for _ in range(2):
        if count > near.shape[1]:
            near, columns = np.empty((2, 2 * count), np.int32), np.empty((16, 2 * count), np.float32)
        count = np.int64(0)
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                row = (z * grid.ny + y) * grid.nx
                first, last = grid.first[row + x0], grid.first[row + x1 + 1]
                if count + last - first <= near.shape[1]:
                    for i in range(first, last):
                        near[0, count + i - first] = i
                        for k in range(6):
                            columns[k, count + i - first] = grid.shapes[i, k]
                count += last - first
        if count <= near.shape[1]:
            break
    if len(grid.axes) > 0:
        for n in range(count):
            for k in range(9):
                columns[6 + k, n] = grid.axes[near[0, n], k // 3, k % 3]
    return count, near, columns


@njit(cache=True)
def _reached(point, most, grid, count, near, columns):
    """How many of `count` gathered atoms reach a point; writes their places among these to the second row of `near` and
    q_i to the last row of `columns`, as `_distance` finds it but for several atoms at a time."""
    for j in range(count):
        x, y, z = point[0] - columns[0, j], point[1] - columns[1, j], point[2] - columns[2, j]
        if len(grid.axes) > 0:
            u = columns[6, j] * x + columns[7, j] * y + columns[8, j] * z
            v = columns[9, j] * x + columns[10, j] * y + columns[11, j] * z
            w = columns[12, j] * x + columns[13, j] * y + columns[14, j] * z
            x, y, z = u, v, w
        a, b, c = columns[3, j], columns[4, j], columns[5, j]
        a, b, c = most if a > most else a, most if b > most else b, most if c > most else c
        x, y, z = x * a, y * b, z * c
        columns[15, j] = x * x + y * y + z * z
    n = 0
    for j in range(count):
        near[1, n] = j
        n += columns[15, j] <= np.float32(CUTOFF_Q)
    return n


@njit(cache=True)
def _gathered_weight(j, most, columns):
    """`_weight` of a gathered atom that `_reached` has found."""
    ratio = np.float32(1)
    for k in range(3, 6):
        if columns[k, j] > most:
            ratio *= most / columns[k, j]
    return math.exp(np.float32(-0.5) * columns[15, j]) * ratio


@njit(cache=True, nogil=True)
def sum_terms(task, points, most, grid, colour, density):
    """Adds the terms of one level to colour (P, 3), weighted, and density (P,) of some points."""
    near, columns = np.empty((2, 0), np.int32), np.empty((16, 0), np.float32)
    p, end = task * POINTS, min((task + 1) * POINTS, len(points))
    while p < end:
        stop, cells = _run_from(p, end, points, most, grid)
        count, near, columns = _gather(cells, grid, near, columns)
        while p < stop:
            point = _local(points[p], grid.origin)
            total = np.float32(0)
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            for j in range(_reached(point, most[p], grid, count, near, columns)):
                w = _gathered_weight(near[1, j], most[p], columns)
                if w >= 0:
                    i = near[0, near[1, j]]
                    total += w
                    red += w * grid.rgb[i, 0]
                    green += w * grid.rgb[i, 1]
                    blue += w * grid.rgb[i, 2]
            density[p] += total
            colour[p, 0] += red
            colour[p, 1] += green
            colour[p, 2] += blue
            p += 1


@njit(cache=True, nogil=True)
def colour_faces(task, skin_colour, skin_density, colour, density):
    """Adds the skin's sums at some points to the interior's, colour (P, 3) weighted and density (P,), and divides."""
    for p in range(task * POINTS, min((task + 1) * POINTS, len(density))):
        part = skin_part(density[p])
        weight = density[p] + part * skin_density[p]
        density[p] += skin_density[p]
        if weight > 0:
            for k in range(3):
                colour[p, k] = (colour[p, k] + part * skin_colour[p, k]) / weight


@njit(cache=True, nogil=True)
def count_terms(task, points, most, grid, count):
    """Adds the number of terms of one level at some points to count (P + 1,), that of point p at place p + 1."""
    near, columns = np.empty((2, 0), np.int32), np.empty((16, 0), np.float32)
    p, end = task * POINTS, min((task + 1) * POINTS, len(points))
    while p < end:
        stop, cells = _run_from(p, end, points, most, grid)
        gathered, near, columns = _gather(cells, grid, near, columns)
        while p < stop:
            count[p + 1] += _reached(_local(points[p], grid.origin), most[p], grid, gathered, near, columns)
            p += 1


@njit(cache=True, nogil=True)
def fill_terms(task, points, most, grid, cursor, atoms, weights):
    """Writes atoms and weights of the terms of one level at cursor (P,), which advances."""
    near, columns = np.empty((2, 0), np.int32), np.empty((16, 0), np.float32)
    p, end = task * POINTS, min((task + 1) * POINTS, len(points))
    while p < end:
        stop, cells = _run_from(p, end, points, most, grid)
        count, near, columns = _gather(cells, grid, near, columns)
        while p < stop:
            point = _local(points[p], grid.origin)
            n = cursor[p]
            for j in range(_reached(point, most[p], grid, count, near, columns)):
                w = _gathered_weight(near[1, j], most[p], columns)
                if w >= 0:
                    atoms[n] = grid.atom[near[0, near[1, j]]]
                    weights[n] = w
                    n += 1
            cursor[p] = n
            p += 1


@njit(cache=True, nogil=True)
def count_terms_on(task, height, width, rows, boxes, points, most, grid, count):
    """`count_terms` at some rows of a picture, from the boxes of `atoms_near_plane`."""
    first, stop = task * ROWS, min((task + 1) * ROWS, height)
    for k in range(len(rows)):
        for y in range(max(boxes[k, 2], first), min(boxes[k, 3], stop)):
            for p in range(y * width + boxes[k, 0], y * width + min(boxes[k, 1], width)):
                q, _ = _distance(rows[k], _local(points[p], grid.origin), most, grid.shapes, grid.axes)
                count[p + 1] += q <= np.float32(CUTOFF_Q)


@njit(cache=True, nogil=True)
def fill_terms_on(task, height, width, rows, boxes, points, most, grid, cursor, columns, weights):
    """`fill_terms` at some rows of a picture, from the boxes of `atoms_near_plane`."""
    first, stop = task * ROWS, min((task + 1) * ROWS, height)
    for k in range(len(rows)):
        for y in range(max(boxes[k, 2], first), min(boxes[k, 3], stop)):
            for p in range(y * width + boxes[k, 0], y * width + min(boxes[k, 1], width)):
                w = _weight(rows[k], _local(points[p], grid.origin), most, grid.shapes, grid.axes)
                if w >= 0:
                    columns[cursor[p]] = grid.atom[rows[k]]
                    weights[cursor[p]] = w
                    cursor[p] += 1
