"""Shared parts of the solids: the depth of a round body, and small items scattered through it.

A round body is star-shaped about the origin: its skin is at a radius that depends on direction only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.threads import for_spans
from sample_scenes.solids.noise import noise

__all__ = [
    "ItemGrid",
    "colours_at",
    "depths_at",
    "index_items",
    "item_at",
    "rotated_frame",
    "round_depth",
    "round_depths",
    "round_shape",
    "teardrop",
]

ItemGrid = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]
"""Items (M, 16): centre 3, rows of the local frame 9, half lengths 3, kind; cell starts; items of each cell."""

GRID = 40
"""Cells along an axis of the look-up grid over [-EXTENT, EXTENT]^3; one item's reach at most."""

EXTENT = 1.3


def round_shape(
    axes: tuple[float, float, float],
    wobble: float,
    frequency: float,
    seed: int,
    *,
    taper: float = 0.0,
    top: tuple[float, float] = (0.0, 1.0),
    bottom: tuple[float, float] = (0.0, 1.0),
    lobes: tuple[float, int] = (0.0, 5),
    crater: tuple[float, float] = (0.0, 1.0),
) -> NDArray[np.float64]:
    """(15,). Parameters of a round body for `round_depth`.

    An ellipsoid of half axes `axes` with noise of relative height `wobble`, wider above by `taper`, with a dent (depth,
    angular width in radians; a negative depth is a bump) at either pole, a second one, `crater`, in the top one, and
    `lobes` (height, count) around the bottom.
    """
    return np.array([*axes, wobble, frequency, seed, taper, *top, *bottom, *lobes, *crater], np.float64)


@njit(cache=True)
def _radius(x: float, y: float, z: float, shape: NDArray[np.float64]) -> float:
    """Radius of the skin in the unit direction (x, y, z)."""
    a, b, c = x / shape[0], y / shape[1], z / shape[2]
    radius = 1 / math.sqrt(a * a + b * b + c * c)
    f = shape[4]
    radius *= 1 + shape[3] * noise(f * x + 11.3, f * y + 5.1, f * z + 8.7, int(shape[5])) + shape[6] * z
    polar = math.acos(min(max(z, -1.0), 1.0))
    if shape[7] != 0.0:
        radius -= shape[7] * math.exp(-((polar / shape[8]) ** 2))
    if shape[13] != 0.0:
        radius -= shape[13] * math.exp(-((polar / shape[14]) ** 2))
    if shape[9] != 0.0:
        radius -= shape[9] * math.exp(-(((math.pi - polar) / shape[10]) ** 2))
    if shape[11] != 0.0:
        # Full on the underside, zero above and, by the sine, at the pole, where the angle is undefined.
        radius += shape[11] * math.cos(shape[12] * math.atan2(y, x)) * (x * x + y * y) * max(0.2 - z, 0.0)
    return radius


@njit(cache=True)
def round_depth(x: float, y: float, z: float, shape: NDArray[np.float64]) -> float:
    """Signed depth under a round body's skin: (R(u) - r) / |gradient|, the distance to first order at the skin."""
    r = math.sqrt(x * x + y * y + z * z)
    if r < 1e-9:
        return min(shape[0], shape[1], shape[2])
    x, y, z = x / r, y / r, z / r
    if abs(z) < 0.9:
        length = math.sqrt(x * x + y * y)
        ax, ay, az = -y / length, x / length, 0.0
    else:
        length = math.sqrt(y * y + z * z)
        ax, ay, az = 0.0, -z / length, y / length
    bx, by, bz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    e = 1e-4
    n = 1 / math.sqrt(1 + e * e)
    here = _radius(x, y, z, shape)
    g = (_radius((x + e * ax) * n, (y + e * ay) * n, (z + e * az) * n, shape) - here) / e
    h = (_radius((x + e * bx) * n, (y + e * by) * n, (z + e * bz) * n, shape) - here) / e
    return (here - r) / math.sqrt(1 + (g * g + h * h) / (here * here))


@njit(cache=True, nogil=True)
def round_depths(
    start: int,
    stop: int,
    points: NDArray[np.float64],  # [M, 3]
    shape: NDArray[np.float64],
    out: NDArray[np.float32],  # [M]
) -> None:
    """`round_depth` of points."""
    for i in range(start, stop):
        out[i] = round_depth(points[i, 0], points[i, 1], points[i, 2], shape)


def depths_at(points: NDArray[np.float64], kernel: Callable[..., None], *args: Any) -> NDArray[np.float32]:
    """(M,). The values of a kernel at points (M, 3), on all cores: kernel(start, stop, points, *args, out)."""
    out = np.empty(len(points), np.float32)
    for_spans(kernel, len(points), points, *args, out)
    return out


def colours_at(points: NDArray[np.float64], kernel: Callable[..., None], *args: Any) -> NDArray[np.float32]:
    """(M, 3). The same for colours."""
    out = np.empty((len(points), 3), np.float32)
    for_spans(kernel, len(points), points, *args, out)
    return out


def rotated_frame(axis: NDArray[np.float64], roll: float) -> NDArray[np.float64]:
    """(3, 3). Rows of a frame whose first is the unit axis; the other two are turned by roll radians about it."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    e1 = np.cross(axis, helper)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    return np.stack([axis, math.cos(roll) * e1 + math.sin(roll) * e2, -math.sin(roll) * e1 + math.cos(roll) * e2])


def index_items(
    centres: NDArray[np.float64],  # [M, 3]
    frames: Sequence[NDArray[np.float64]],  # M of [3, 3], rows are the local axes
    halves: NDArray[np.float64],  # [M, 3] half lengths along the local axes
    kinds: NDArray[np.float64],  # [M]
) -> ItemGrid:
    """Puts items into a look-up grid for `item_at`: each is listed in all cells within its reach."""
    rows = np.concatenate(
        [centres, np.reshape(np.asarray(frames), (len(centres), 9)), halves, np.reshape(kinds, (-1, 1))], axis=1
    )
    cell_items: list[list[int]] = [[] for _ in range(GRID**3)]
    reach = halves.max(axis=1, keepdims=True) * 1.35  # a margin for effects drawn around an item
    low = np.clip(((centres - reach + EXTENT) / (2 * EXTENT) * GRID).astype(int), 0, GRID - 1)
    high = np.clip(((centres + reach + EXTENT) / (2 * EXTENT) * GRID).astype(int), 0, GRID - 1)
    for item, (a, b) in enumerate(zip(low, high, strict=True)):
        for i in range(a[0], b[0] + 1):
            for j in range(a[1], b[1] + 1):
                for k in range(a[2], b[2] + 1):
                    cell_items[(i * GRID + j) * GRID + k].append(item)
    starts = np.concatenate([[0], np.cumsum([len(m) for m in cell_items])]).astype(np.int64)
    return rows, starts, np.array([item for m in cell_items for item in m], np.int64)


@njit(cache=True)
def teardrop(u: float, v: float, w: float, point: float) -> float:
    """Squared radius in a unit teardrop whose tip points along +u: 1 at its skin; point 0 is a sphere."""
    wide = 1 - point * (0.5 + 0.5 * u)
    wide = max(wide, 0.25)
    return u * u + (v * v + w * w) / (wide * wide)


@njit(cache=True)
def item_at(
    x: float,
    y: float,
    z: float,
    point: float,
    rows: NDArray[np.float64],
    starts: NDArray[np.int64],
    items: NDArray[np.int64],
) -> tuple[float, int]:
    """The item that the point is deepest in: its squared teardrop radius (1 at its skin, 9 for none) and its row."""
    i = int((x + EXTENT) / (2 * EXTENT) * GRID)
    j = int((y + EXTENT) / (2 * EXTENT) * GRID)
    k = int((z + EXTENT) / (2 * EXTENT) * GRID)
    best, found = 9.0, -1
    if min(i, j, k) < 0 or max(i, j, k) >= GRID:
        return best, found
    cell = (i * GRID + j) * GRID + k
    for n in range(starts[cell], starts[cell + 1]):
        row = rows[items[n]]
        dx, dy, dz = x - row[0], y - row[1], z - row[2]
        u = (row[3] * dx + row[4] * dy + row[5] * dz) / row[12]
        v = (row[6] * dx + row[7] * dy + row[8] * dz) / row[13]
        w = (row[9] * dx + row[10] * dy + row[11] * dz) / row[14]
        q = teardrop(u, v, w, point)
        if q < best:
            best, found = q, items[n]
    return best, found
