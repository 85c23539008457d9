"""The kernel field: colour and density inside the object.

c(p) = sum w_i c_i / sum w_i and D(p) = sum w_i, w_i = exp(-q_i / 2), cut off at three standard deviations. A distant
pixel covers many atoms: every axis is then at least half a pixel's footprint long and the weight is reduced by the
volume gained, so that the sum keeps its value and the picture does not alias.

The atoms are sorted into uniform grids, one for each octave of size; a point reads the cells within reach.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.field_kernels import (
    POINTS,
    REACH,
    ROWS,
    atoms_near_plane,
    colour_faces,
    count_terms,
    count_terms_on,
    fill_terms,
    fill_terms_on,
    sort_by_cell,
    sum_terms,
)
from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.grid import widened
from engine.scene.rotations import normalised_quats, rotation_matrices
from engine.threads import for_each

__all__ = ["KernelField", "axes_of"]

Float = NDArray[np.float32]

CELLS_PER_REACH = 2
"""Cells from a point to the end of its reach: with two it tests 53 atoms, in 25 rows of cells, instead of 91."""

CELLS_PER_ATOM = 8
"""Upper limit of a grid's cells per atom, so that atoms spread over a huge space do not need a huge grid."""

STRAY = 0.01
"""Fraction of outliers at either end of an axis that the grid does not extend to: border cells hold them."""


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
    """(cells + 1,). First atom of each cell."""
    atom: NDArray[np.int32]
    """(n,). Row of each atom, surface atoms before interior ones."""
    shapes: Float
    """(n, 6). Position relative to the origin, world units; inverse standard deviations."""
    axes: Float
    """(n, 3, 3). Rows are principal axes; (0, 3, 3) if all atoms are spheres."""
    rgb: Float
    """(n, 3). Colours, copied in this order: gathering them by row would cost more than the sums."""
    box: Float
    """(2, 3). Bounds of the positions."""
    largest: np.float32
    """Largest standard deviation, world units."""
    is_isolated: NDArray[np.bool_]
    """(cells,). Cells without an atom within reach of the largest one: most cells of a skin's grid inside a solid."""


class KernelField:
    """The field of a set of atoms, prepared for many points."""

    def __init__(self, atoms: Atoms) -> None:
        surface, interior = atoms.surface, atoms.interior
        self._skin: list[Level] = []
        rgb = sh.sh_to_rgb(surface.sh[:, 0])
        for rows in octaves(surface.scales.max(1, initial=0)):
            axes = axes_of(surface.quats[rows])
            self._skin.append(level(rows, surface.means[rows], surface.scales[rows], axes, rgb[rows]))
        axes = np.zeros((0, 3, 3), np.float32)
        self._interior: list[Level] = []
        for rows in octaves(interior.sigmas):
            scales = np.repeat(interior.sigmas[rows, None], 3, 1)
            atom = rows + len(surface)
            self._interior.append(level(atom, interior.means[rows], scales, axes, interior.rgb[rows]))

    def at(
        self,
        points: NDArray[np.floating],  # [P, 3]
        footprint: float | NDArray[np.floating] = 0.0,  # [] or [P]
    ) -> tuple[Float, Float]:
        """Colour (P, 3) and density (P,) at world points; a footprint is a pixel's size there in world units.

        The skin colours what the interior does not fill (`skin_part`). A filled lattice has density LATTICE_DENSITY;
        where density is zero, so is colour.
        """
        points, most = prepared(points, footprint)
        tasks = -(-len(points) // POINTS)
        sums = []
        for levels in (self._skin, self._interior):
            sums += [np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)]
            for grid in levels:
                for_each(sum_terms, tasks, points, most, grid, *sums[-2:])
        for_each(colour_faces, tasks, *sums)
        return sums[2], sums[3]

    def entries(
        self,
        points: NDArray[np.floating],  # [P, 3]
        footprint: float | NDArray[np.floating] = 0.0,  # [] or [P]
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], Float]:
        """The terms of the sums as compressed rows: offsets (P + 1,), atoms (E,) and their weights w_i (E,)."""
        points, most = prepared(points, footprint)
        tasks = -(-len(points) // POINTS)
        count = np.zeros(len(points) + 1, np.int64)
        for grid in self._skin + self._interior:
            for_each(count_terms, tasks, points, most, grid, count)
        offsets = np.cumsum(count)
        cursor = offsets[:-1].copy()
        atom, weight = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        for grid in self._skin + self._interior:
            for_each(fill_terms, tasks, points, most, grid, cursor, atom, weight)
        return offsets, atom, weight

    def entries_on(
        self,
        points: NDArray[np.floating],  # [H, W, 3]
        footprint: float,
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], Float]:
        """`entries`, bit for bit but much faster, at points of a plane that form an evenly spaced grid."""
        height, width, _ = points.shape
        corner = points[0, 0].astype(np.float64)
        across = (points[0, -1] - corner) / max(width - 1, 1)
        down = (points[-1, 0] - corner) / max(height - 1, 1)
        flat, least = prepared(points.reshape(-1, 3), footprint)
        most, tasks = least[0], -(-height // ROWS)
        near = []
        for grid in self._skin + self._interior:
            rows, boxes = np.empty(len(grid.shapes) + 1, np.int32), np.empty((len(grid.shapes) + 1, 4), np.int32)
            count_near = atoms_near_plane(grid, corner, across, down, most, rows, boxes)
            near.append((grid, rows[:count_near], boxes[:count_near]))
        count = np.zeros(len(flat) + 1, np.int64)
        for grid, rows, boxes in near:
            for_each(count_terms_on, tasks, height, width, rows, boxes, flat, most, grid, count)
        offsets = np.cumsum(count)
        cursor = offsets[:-1].copy()
        atom, weight = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        for grid, rows, boxes in near:
            for_each(fill_terms_on, tasks, height, width, rows, boxes, flat, most, grid, cursor, atom, weight)
        return offsets, atom, weight


def prepared(
    points: NDArray[np.floating], footprint: float | NDArray[np.floating]
) -> tuple[NDArray[np.floating], Float]:
    """Points (P, 3) and the largest inverse standard deviation (P,) that each footprint allows."""
    assert points.shape == (len(points), 3), points.shape
    with np.errstate(divide="ignore", over="ignore"):
        most = 2.0 / np.broadcast_to(np.asarray(footprint, np.float64), len(points))
    return np.ascontiguousarray(points), most.astype(np.float32)


def octaves(sizes: NDArray[np.floating]) -> list[NDArray[np.intp]]:
    """Rows of each octave of size that occurs; the twelfth octave under the largest also holds everything smaller."""
    if not len(sizes):
        return []
    largest = max(float(sizes.max()), float(np.finfo(np.float32).tiny))
    octave = np.floor(np.log2(np.maximum(sizes / largest, 2.0**-12)) + 1e-4).astype(int)
    return [np.flatnonzero(octave == o) for o in np.unique(octave)]


def axes_of(quats: NDArray[np.floating]) -> Float:
    """(N, 3, 3). Rows are the principal axes of quaternions (N, 4), wxyz; the world's axes for one of length 0."""
    return np.ascontiguousarray(rotation_matrices(normalised_quats(quats)).transpose(0, 2, 1), np.float32)


def level(atom: NDArray[np.intp], means: Float, scales: Float, axes: Float, rgb: Float) -> Level:
    """Sorts atoms of about the same size into a grid."""
    largest = float(scales.max())
    skipped = int(np.ceil(STRAY * (len(means) - 1)))
    ends = skipped, len(means) - 1 - skipped
    low, high = np.partition(means, ends, axis=0)[list(ends)].astype(np.float64)
    margin = 3 * STRAY * np.maximum(high - low, 0)  # a ball is sparse at its ends, so the quantile falls short of them
    low, high = low - margin, high + margin
    cell = max(3 * largest / CELLS_PER_REACH, float(np.finfo(np.float32).tiny))
    while (np.maximum((high - low) / cell, 0) + 1).prod() > CELLS_PER_ATOM * len(atom) + 64:
        cell *= 1.26  # a third of an octave: the count about halves
    nx, ny, nz = (int(n) for n in np.maximum((high - low) / cell, 0) + 1)
    scale = np.float32(1 / cell)
    position = (means - low).astype(np.float32)
    first, order = sort_by_cell(position, scale, nx, ny, nz)
    reach = math.ceil(REACH * largest * float(scale))  # cells that a point's reach can touch on each side
    is_isolated = ~widened(np.diff(first).reshape(nz, ny, nx) > 0, reach).ravel()
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
        is_isolated,
    )
