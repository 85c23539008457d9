"""The lines where planes intersect the object: contours of the body on each plane, including those of hollows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.atoms import Atoms
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane, frame

__all__ = ["WIRES", "body_of_atoms", "body_of_shell", "clipped_lines", "contours", "wires"]

Float = NDArray[np.float64]

CELLS = 72
"""Cells along the longest side of the grid that contours are found in: finer than the lines are wide when the object
fills a window, and coarse enough to be built within a frame or two. A cell is never smaller than the atoms' pitch."""

BLUR = 0.8
"""Standard deviation, in cells, of the blur that turns counts of jittered atoms into an even interior with a smooth
edge."""

SHELL_CELLS = 48
"""The same as CELLS for a capture, which has only a skin: coarser, so that gaps in it are at most four cells wide."""

WIRES = 24
"""Meshes along the longest side of the net of `wires`: few enough to look through."""

# Marching squares: the segments for each pattern of corners inside the body (bits 1, 2, 4, 8 around a cell), from one
# edge to another; edge i goes from corner i to the next. Diagonally opposite corners count as separate.
ONE = [(-1, -1), (3, 0), (0, 1), (3, 1), (1, 2), (3, 0), (0, 2), (3, 2)]
ONE += [(2, 3), (2, 0), (0, 1), (2, 1), (1, 3), (1, 0), (0, 3), (-1, -1)]
TWO = [(1, 2) if code == 5 else (2, 3) if code == 10 else (-1, -1) for code in range(16)]
EDGES = np.array([ONE, TWO]).transpose(1, 0, 2)


def body_of_atoms(atoms: Atoms) -> Body:
    """The solid that atoms fill, on a grid coarse enough to be built while the user waits; exact to a fraction."""
    means, spacing = atoms.interior.means.astype(np.float64), 2 * atoms.interior.sigmas.astype(np.float64)
    if not len(means):
        means = atoms.surface.means.astype(np.float64)
        spacing = np.full(len(means), atoms.pitch)
    cell = max(float(np.ptp(means, axis=0).max()) / CELLS, atoms.pitch) if len(means) else 1.0
    volumes, origin = _gathered(means, spacing**3, cell)
    filled = ndimage.gaussian_filter(volumes, BLUR, mode="constant") / cell**3
    # The skin is where half is filled. Depths need to be right only near it.
    depth = (filled - 0.5) * 2.5 * BLUR * cell
    return Body(Grid(origin, cell, volumes.shape), depth.astype(np.float32))


def body_of_shell(points: NDArray[np.floating]) -> Body:
    """The volume that points (N, 3) on a skin enclose, for a capture that is not solid yet."""
    cell = float(np.ptp(points, axis=0).max()) / SHELL_CELLS if len(points) > 1 else 1.0
    origin, shape = _around(points, cell)
    skin = np.zeros(shape, bool)
    skin[tuple(((points - origin) / cell).astype(int).T)] = True
    thick = ndimage.binary_fill_holes(ndimage.binary_dilation(skin, iterations=2))
    edge = ndimage.gaussian_filter(
        ndimage.binary_erosion(thick, iterations=2).astype(np.float32), BLUR, mode="constant"
    )
    return Body(Grid(origin, cell, shape), ((edge - 0.5) * 2.5 * BLUR * cell).astype(np.float32))


def _around(points: NDArray[np.floating], cell: float) -> tuple[Float, tuple[int, int, int]]:
    """Outer corner (3,) and shape of a grid around points, with a margin of four cells."""
    if not len(points):
        return np.zeros(3), (1, 1, 1)
    origin = points.min(0).astype(np.float64) - 4 * cell
    x, y, z = np.ceil((points.max(0) - origin) / cell).astype(int) + 4
    return origin, (x, y, z)


def _gathered(points: Float, volumes: Float, cell: float) -> tuple[NDArray[np.float32], Float]:
    """The volumes (N,) of points (N, 3) in each cell, each spread linearly over the nearest eight; and the outer corner
    (3,) of the grid."""
    origin, shape = _around(points, cell)
    place = (points - origin) / cell - 0.5
    first = np.floor(place).astype(np.int64)
    part = place - first
    total = np.zeros(int(np.prod(shape)))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, part, 1 - part).prod(1) * volumes
        total += np.bincount(np.ravel_multi_index(tuple((first + corner).T), shape), weight, len(total))
    return total.reshape(shape).astype(np.float32), origin


def contours(
    body: Body, planes: Sequence[Plane], within: Sequence[Sequence[Plane]] = ((),), outset: float = 0.0
) -> Float:
    """(S, 2, 3). Ends of line segments where planes intersect a body, or the part of it in any of the cells `within`.

    A cell of `within` is the intersection of half-spaces. Segments are in no order, as short as the body's grid cells,
    and run `outset` grid cells outside the skin.
    """
    low, high = body.bounds()
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 + body.grid.cell
    steps = np.arange(-radius, radius + body.grid.cell, body.grid.cell)
    found = [np.zeros((0, 2, 3))]
    for plane in planes:
        e1, e2, n = frame(plane.normal)
        distance = float(plane.distance(centre))
        if abs(distance) > radius:
            continue
        axes, foot = np.stack([e1, e2]), centre - distance * n
        flat = np.stack(np.meshgrid(steps, steps, indexing="ij"), 2)
        points = foot + flat @ axes
        depth = body.at(points).astype(np.float64) + outset * body.grid.cell
        if all(within):
            kept = [np.min([-half.distance(points) for half in cell], axis=0) for cell in within]
            depth = np.minimum(depth, np.max(kept, axis=0))
        found.append(foot + (_marched(depth) * body.grid.cell + steps[0]) @ axes)
    return np.concatenate(found)


def _marched(values: Float) -> Float:
    """(S, 2, 2). Segments of the zero contour of values (H, W), in grid units, by marching squares."""
    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    height, width = values.shape
    inside = values > 0
    windows = [inside[i : height - 1 + i, j : width - 1 + j] for i, j in corners]
    mixed = np.logical_or.reduce(windows) & ~np.logical_and.reduce(windows)
    cells = np.argwhere(mixed)
    codes = sum(window[mixed] * np.int64(1 << bit) for bit, window in enumerate(windows))
    value = np.stack([values[cells[:, 0] + i, cells[:, 1] + j] for i, j in corners], 1)
    other = np.roll(value, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # edges without a crossing are not used
        part = (value / (value - other))[..., None]
        crossings = cells[:, None] + corners + part * (np.roll(corners, -1, axis=0) - corners)
    first, second = EDGES[codes].transpose(1, 0, 2)
    rows = np.arange(len(cells))[:, None]
    return np.concatenate([crossings[rows, first], crossings[rows, second][second[:, 0] >= 0]])


def wires(body: Body, outset: float = 0.0) -> Float:
    """(S, 2, 3). An even net around a body, `outset` of its cells outside the skin: contours of level planes along each
    axis, as evenly spaced."""
    low, high = body.bounds()
    step = float((high - low).max()) / WIRES
    planes = [
        Plane.through((low + high) / 2 + n * step * np.eye(3)[axis], np.eye(3)[axis])
        for axis in range(3)
        for n in range(-(WIRES // 2), WIRES // 2 + 1)
    ]
    return contours(body, planes, outset=outset)


def clipped_lines(ends: Float, within: Sequence[Sequence[Plane]]) -> Float:
    """(S, 2, 3). The parts of line segments (L, 2, 3) in any of the cells `within`, which half-spaces bound."""
    found = [np.zeros((0, 2, 3))]
    for cell in within:
        first, last = np.zeros(len(ends)), np.ones(len(ends))
        for plane in cell:
            start, end = plane.distance(ends[:, 0]), plane.distance(ends[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing = start / (start - end)
            first = np.where(start > 0, np.where(end < 0, np.maximum(first, crossing), 2.0), first)
            last = np.where((end > 0) & (start <= 0), np.minimum(last, crossing), last)
        kept = first < last
        run = ends[kept, 1] - ends[kept, 0]
        found.append(np.stack([ends[kept, 0] + part[kept, None] * run for part in (first, last)], 1))
    return np.concatenate(found)
