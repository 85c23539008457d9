"""The kernel field: colour and density inside the object (DESIGN, section 3).

c(p) = sum w_i c_i / sum w_i and D(p) = sum w_i, w_i = exp(-q_i / 2), cut off at three standard deviations. Seen from
afar a pixel covers many atoms: every axis is then at least half a pixel's footprint long and the weight falls by the
volume gained, so the sum stays what it was and the picture does not alias.

The atoms lie in uniform grids, one for every octave of size, sorted by cell; a point reads the cells in its reach.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from engine.render.cpu.face_rows import ROWS, near_plane
from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.constants import CUTOFF_Q
from engine.scene.rotations import matrices, unit_quats
from engine.threads import for_each

__all__ = ["KernelField", "axes_of"]

Float = NDArray[np.float32]

CELLS_PER_REACH = 2
"""Cells from a point to the end of its reach: two visit 53 of 91 candidates that one would, in 25 rows of cells."""

CELLS_PER_ATOM = 8
"""Upper limit of a grid's cells, so that atoms strewn over a huge space do not ask for a huge grid."""

STRAY = 0.01
"""Share of the atoms at either end of an axis that does not set the grid's extent: border cells hold the strays."""

POINTS = 2048
"""Points in a task: many tasks, so that the cores stay even, each long beside the call."""


class Level(NamedTuple):
    """Atoms of one octave of size, sorted by grid cell, x fastest. A named tuple, which numba can read."""

    origin: NDArray[np.float64]
    """(3,). Corner of cell (0, 0, 0), world units."""
    scale: np.float32
    """Cells per world unit."""
    nx: int
    ny: int
    nz: int
    first: NDArray[np.int32]
    """(cells + 1,). Where each cell's atoms begin."""
    atom: NDArray[np.int32]
    """(n,). Row of each in the order surface, interior."""
    shapes: Float
    """(n, 6). Position, world units from the origin; one over each standard deviation."""
    axes: Float
    """(n, 3, 3). Rows are principal axes; (0, 3, 3) where all are spheres."""
    rgb: Float
    """(n, 3). Colours, a copy in this order: gathering them by row would cost more than the sums."""
    box: Float
    """(2, 3). Bounds of the positions."""
    largest: np.float32
    """Largest standard deviation, world units."""
    lonely: NDArray[np.bool_]
    """(cells,). Cells from which no atom is within the reach of the largest: inside a solid, most cells of its skin."""


class KernelField:
    """The field of a set of atoms, ready to be asked at many points."""

    def __init__(self, atoms: Atoms) -> None:
        surface, interior = atoms.surface, atoms.interior
        self.levels: list[Level] = []
        rgb = sh.sh_to_rgb(surface.sh[:, 0])
        for rows in octaves(surface.scales.max(1, initial=0)):
            axes = axes_of(surface.quats[rows])
            self.levels.append(level(rows, surface.means[rows], surface.scales[rows], axes, rgb[rows]))
        axes = np.zeros((0, 3, 3), np.float32)
        for rows in octaves(interior.sigmas):
            scales = np.repeat(interior.sigmas[rows, None], 3, 1)
            atom = rows + len(surface)
            self.levels.append(level(atom, interior.means[rows], scales, axes, interior.rgb[rows]))

    def at(
        self,
        points: NDArray[np.floating],  # [P, 3]
        footprint: float | NDArray[np.floating] = 0.0,  # [] or [P]
    ) -> tuple[Float, Float]:
        """Colour (P, 3) and density (P,) at world points; a footprint is a pixel's size there in world units.

        A filled lattice has density formula.LATTICE_DENSITY; colour is zero where density is.
        """
        points, most = prepared(points, footprint)
        tasks = -(-len(points) // POINTS)
        colour, density = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
        for grid in self.levels:
            for_each(_sum, tasks, points, most, grid, colour, density)
        for_each(_divide, tasks, colour, density)
        return colour, density

    def entries(
        self,
        points: NDArray[np.floating],  # [P, 3]
        footprint: float | NDArray[np.floating] = 0.0,  # [] or [P]
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], Float]:
        """The terms of the sums as compressed rows: offsets (P + 1,), atoms (E,) and their weights w_i (E,)."""
        points, most = prepared(points, footprint)
        tasks = -(-len(points) // POINTS)
        count = np.zeros(len(points) + 1, np.int64)
        for grid in self.levels:
            for_each(_count, tasks, points, most, grid, count)
        offsets = np.cumsum(count)
        cursor = offsets[:-1].copy()
        atom, weight = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        for grid in self.levels:
            for_each(_fill, tasks, points, most, grid, cursor, atom, weight)
        return offsets, atom, weight

    def entries_on(
        self,
        points: NDArray[np.floating],  # [H, W, 3]
        footprint: float,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], Float]:
        """`entries`, to the bit, at the points of a picture of a plane, evenly spaced on lines: it is much faster."""
        height, width, _ = points.shape
        corner = points[0, 0].astype(np.float64)
        across = (points[0, -1] - corner) / max(width - 1, 1)
        down = (points[-1, 0] - corner) / max(height - 1, 1)
        flat, least = prepared(points.reshape(-1, 3), footprint)
        most, tasks = least[0], -(-height // ROWS)
        near = []
        for grid in self.levels:
            rows, boxes = np.empty(len(grid.shapes) + 1, np.int32), np.empty((len(grid.shapes) + 1, 4), np.int32)
            found = near_plane(grid, corner, across, down, most, rows, boxes)
            near.append((grid, rows[:found], boxes[:found]))
        count = np.zeros(len(flat) + 1, np.int64)
        for grid, rows, boxes in near:
            for_each(_count_on, tasks, height, width, rows, boxes, flat, most, grid, count)
        offsets = np.cumsum(count)
        cursor = offsets[:-1].copy()
        atom, weight = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        for grid, rows, boxes in near:
            for_each(_fill_on, tasks, height, width, rows, boxes, flat, most, grid, cursor, atom, weight)
        return offsets, atom, weight


def prepared(
    points: NDArray[np.floating], footprint: float | NDArray[np.floating]
) -> tuple[NDArray[np.floating], Float]:
    """Points (P, 3) and the greatest inverse standard deviation (P,) that each footprint lets an atom have."""
    assert points.shape == (len(points), 3), points.shape
    with np.errstate(divide="ignore", over="ignore"):
        most = 2.0 / np.broadcast_to(np.asarray(footprint, np.float64), len(points))
    return np.ascontiguousarray(points), most.astype(np.float32)


def octaves(sizes: NDArray[np.floating]) -> list[NDArray[np.intp]]:
    """Rows of each octave of size that occurs; twelve octaves under the largest everything is of one kind."""
    if not len(sizes):
        return []
    largest = max(float(sizes.max()), float(np.finfo(np.float32).tiny))
    octave = np.floor(np.log2(np.maximum(sizes / largest, 2.0**-12)) + 1e-4).astype(int)
    return [np.flatnonzero(octave == o) for o in np.unique(octave)]


def axes_of(quats: NDArray[np.floating]) -> Float:
    """(N, 3, 3). Rows are the principal axes of quaternions (N, 4), wxyz; the world's where one has no length."""
    return np.ascontiguousarray(matrices(unit_quats(quats)).transpose(0, 2, 1), np.float32)


def level(atom: NDArray[np.intp], means: Float, scales: Float, axes: Float, rgb: Float) -> Level:
    """Sorts atoms of about one size into a grid."""
    largest = float(scales.max())
    ranked = np.sort(means, axis=0)
    skipped = int(np.ceil(STRAY * (len(means) - 1)))
    low, high = ranked[skipped].astype(np.float64), ranked[len(means) - 1 - skipped].astype(np.float64)
    margin = 3 * STRAY * np.maximum(high - low, 0)  # a ball is sparse there, so the quantile falls short of its end
    low, high = low - margin, high + margin
    cell = max(3 * largest / CELLS_PER_REACH, float(np.finfo(np.float32).tiny))
    while (np.maximum((high - low) / cell, 0) + 1).prod() > CELLS_PER_ATOM * len(atom) + 64:
        cell *= 1.26  # a third of an octave: the count about halves
    nx, ny, nz = (int(n) for n in np.maximum((high - low) / cell, 0) + 1)
    scale = np.float32(1 / cell)
    position = (means - low).astype(np.float32)
    first, order = _cells(position, scale, nx, ny, nz)
    around = 2 * math.ceil(3.0001 * largest * float(scale)) + 1  # cells that a point's reach can touch along an axis
    lonely = maximum_filter(np.diff(first).reshape(nz, ny, nx) > 0, around, mode="constant").ravel() == 0
    inverse = 1 / np.maximum(scales, np.finfo(np.float32).tiny)
    return Level(
        low,
        scale,
        nx,
        ny,
        nz,
        first,
        atom[order].astype(np.int32),
        np.concatenate([position, inverse], 1, dtype=np.float32)[order],
        axes[order] if len(axes) else axes,
        rgb[order].astype(np.float32),
        np.stack([position.min(0), position.max(0)]),
        np.float32(largest),
        lonely,
    )


@njit(cache=True)
def _slot(x, scale, n):
    """Cell of a coordinate; what lies outside belongs to the border cells."""
    i = x * scale
    if not i > 0:
        return 0
    return int(i) if i < n else n - 1


@njit(cache=True)
def _cells(position, scale, nx, ny, nz):
    """Counting sort by cell: first (cells + 1,) and the order (n,); equal cells keep the order of the input."""
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
    """w_i at a point; -1 where it is cut off."""
    q, ratio = _distance(i, point, most, shapes, axes)
    if q > np.float32(CUTOFF_Q):
        return np.float32(-1)
    return math.exp(np.float32(-0.5) * q) * ratio


@njit(cache=True)
def _distance(i, point, most, shapes, axes):
    """(q_i, by how much the atom's weight falls) at a point."""
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
def _window(p, reach, grid):
    """Cells within reach of p, ends included: x0, x1, y0, y1, z0, z1; x1 < x0 where there are none."""
    for k in range(3):
        if p[k] + reach < grid.box[0, k] or p[k] - reach > grid.box[1, k] or not reach >= 0:
            return 0, -1, 0, -1, 0, -1
    if reach <= np.float32(3.0001) * grid.largest:
        x, y, z = _slot(p[0], grid.scale, grid.nx), _slot(p[1], grid.scale, grid.ny), _slot(p[2], grid.scale, grid.nz)
        if grid.lonely[(z * grid.ny + y) * grid.nx + x]:
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
    """A point from the level's origin, single precision."""
    return (
        np.float32(point[0] - origin[0]),
        np.float32(point[1] - origin[1]),
        np.float32(point[2] - origin[2]),
    )


@njit(cache=True)
def _reach(most, largest):
    """Distance at which the last atom of a level is cut off, with a little air for rounding."""
    return np.float32(3.0001) * max(largest, np.float32(1) / most)


@njit(cache=True, nogil=True)
def _sum(task, points, most, grid, colour, density):
    for p in range(task * POINTS, min((task + 1) * POINTS, len(points))):
        point = _local(points[p], grid.origin)
        x0, x1, y0, y1, z0, z1 = _window(point, _reach(most[p], grid.largest), grid)
        if x1 < x0:
            continue
        total = np.float32(0)
        red, green, blue = np.float32(0), np.float32(0), np.float32(0)
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                row = (z * grid.ny + y) * grid.nx
                for i in range(grid.first[row + x0], grid.first[row + x1 + 1]):
                    w = _weight(i, point, most[p], grid.shapes, grid.axes)
                    if w >= 0:
                        total += w
                        red += w * grid.rgb[i, 0]
                        green += w * grid.rgb[i, 1]
                        blue += w * grid.rgb[i, 2]
        density[p] += total
        colour[p, 0] += red
        colour[p, 1] += green
        colour[p, 2] += blue


@njit(cache=True, nogil=True)
def _divide(task, colour, density):
    for p in range(task * POINTS, min((task + 1) * POINTS, len(density))):
        if density[p] > 0:
            for k in range(3):
                colour[p, k] /= density[p]


@njit(cache=True, nogil=True)
def _count(task, points, most, grid, count):
    for p in range(task * POINTS, min((task + 1) * POINTS, len(points))):
        point = _local(points[p], grid.origin)
        x0, x1, y0, y1, z0, z1 = _window(point, _reach(most[p], grid.largest), grid)
        if x1 < x0:
            continue
        n = 0
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                row = (z * grid.ny + y) * grid.nx
                for i in range(grid.first[row + x0], grid.first[row + x1 + 1]):
                    q, _ = _distance(i, point, most[p], grid.shapes, grid.axes)
                    n += q <= np.float32(CUTOFF_Q)
        count[p + 1] += n


@njit(cache=True, nogil=True)
def _fill(task, points, most, grid, cursor, columns, weights):
    for p in range(task * POINTS, min((task + 1) * POINTS, len(points))):
        point = _local(points[p], grid.origin)
        x0, x1, y0, y1, z0, z1 = _window(point, _reach(most[p], grid.largest), grid)
        if x1 < x0:
            continue
        n = cursor[p]
        for z in range(z0, z1 + 1):
            for y in range(y0, y1 + 1):
                row = (z * grid.ny + y) * grid.nx
                for i in range(grid.first[row + x0], grid.first[row + x1 + 1]):
                    w = _weight(i, point, most[p], grid.shapes, grid.axes)
                    if w >= 0:
                        columns[n] = grid.atom[i]
                        weights[n] = w
                        n += 1
        cursor[p] = n


@njit(cache=True, nogil=True)
def _count_on(task, height, width, rows, boxes, points, most, grid, count):
    first, stop = task * ROWS, min((task + 1) * ROWS, height)
    for k in range(len(rows)):
        for y in range(max(boxes[k, 2], first), min(boxes[k, 3], stop)):
            for p in range(y * width + boxes[k, 0], y * width + min(boxes[k, 1], width)):
                q, _ = _distance(rows[k], _local(points[p], grid.origin), most, grid.shapes, grid.axes)
                count[p + 1] += q <= np.float32(CUTOFF_Q)


@njit(cache=True, nogil=True)
def _fill_on(task, height, width, rows, boxes, points, most, grid, cursor, columns, weights):
    first, stop = task * ROWS, min((task + 1) * ROWS, height)
    for k in range(len(rows)):
        for y in range(max(boxes[k, 2], first), min(boxes[k, 3], stop)):
            for p in range(y * width + boxes[k, 0], y * width + min(boxes[k, 1], width)):
                w = _weight(rows[k], _local(points[p], grid.origin), most, grid.shapes, grid.axes)
                if w >= 0:
                    columns[cursor[p]] = grid.atom[rows[k]]
                    weights[cursor[p]] = w
                    cursor[p] += 1
