"""Things that end, strewn through the body: seeds and pores as many and as long as the pictures say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from training.priors.exemplar.carve import Carving
from training.priors.exemplar.decompose import Detail, Layers
from training.priors.exemplar.frames import Space, View, voxel_gate
from training.priors.exemplar.patches import OVER, POLAR, RADIAL, frame_at
from training.priors.prior import Progress

__all__ = ["strew"]

BIN = 0.4
"""Edge of a bin of gate coordinates; a thing may stand in its own bin and the neighbours."""

SECTION = np.pi / 4
"""Mean size of a random section of an ellipsoid over the size of its largest."""

ALIKE = 0.25
"""Colour distance up to which a place is like the one where the picture shows a thing: no crumbs in the cream."""

MIXED = 0.5
"""Colour distance from what a thing lies in at which a voxel is something else: a crumb is cut off at the cream."""

TRIES = 20
"""Places tried for a thing before it may touch another."""


class _Places:
    """Voxels by gate coordinates, to draw one near given coordinates quickly."""

    def __init__(self, gates: NDArray[np.float32], rows: NDArray[np.intp]) -> None:
        keys = self._keys(np.floor(gates[rows] / BIN).astype(np.int64))
        order = np.argsort(keys, kind="stable")
        self.rows = rows[order]
        self.keys, self.first, self.count = np.unique(keys[order], return_index=True, return_counts=True)

    @staticmethod
    def _keys(bins: NDArray[np.int64]) -> NDArray[np.int64]:
        return (bins + 8) @ np.array([1_000_000, 1_000, 1])

    def _near(self, gate: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """First row and number of rows of the bins around gate coordinates."""
        around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
        wanted = self._keys(np.floor(gate / BIN).astype(np.int64) + around)
        at = np.minimum(np.searchsorted(self.keys, wanted), len(self.keys) - 1)
        found = self.keys[at] == wanted
        return self.first[at[found]], self.count[at[found]]

    def number(self, gate: NDArray[np.float32]) -> int:
        """How many voxels lie around these coordinates."""
        return int(self._near(gate)[1].sum()) if len(self.keys) else 0

    def draw(self, gate: NDArray[np.float32], count: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """(count,). Voxels around these coordinates, drawn evenly; there must be some."""
        first, number = self._near(gate)
        ends = np.cumsum(number)
        pick = rng.integers(ends[-1], size=count)
        which = np.searchsorted(ends, pick, side="right")
        return self.rows[first[which] + pick - (ends[which] - number[which])]


@dataclass(frozen=True)
class _Kind:
    """A detail of a picture as a thing in space."""

    view: int
    layers: int
    detail: int
    across: float
    """Half length along the picture's normal, cells."""
    copies: float
    """How many of it the body holds."""
    places: _Places
    gate: NDArray[np.float32]
    """(3,). Where one may be centred, gate coordinates."""


def strew(
    rgb: NDArray[np.float32],  # [X, Y, Z, 3]
    space: Space,
    views: Sequence[View],
    layers: Sequence[Sequence[Layers]],
    carve: Carving | None,
    rng: np.random.Generator,
    progress: Progress,
) -> int:
    """Paints the details of all pictures into the grid, in place, and returns how many.

    A detail of a picture is a section of a thing that is as long across the picture as the other families' details say
    of their own, or, where there are none, as it is wide. A plane meets a thing of length L on a share L/H of its
    places, so a face with n of them stands for n H / L in the body: short things are more.
    """
    kinds = _kinds(space, views, layers, carve)
    if not kinds:
        return 0
    order = np.argsort([-k.across for k in kinds], kind="stable")
    total = 0
    grid = _Buckets(space)
    for done, n in enumerate(order):
        progress(done / len(order))
        kind = kinds[n]
        whole, part = divmod(kind.copies, 1)
        parts = layers[kind.view][kind.layers]
        detail = parts.details[kind.detail]
        size = max(*detail.half, kind.across)
        for _ in range(int(whole) + (rng.random() < part)):
            choice = kind.places.draw(kind.gate, TRIES, rng)
            i, j, k = space.cells[choice].T
            choice = choice[np.linalg.norm(rgb[i, j, k] - detail.ground, axis=1) < ALIKE]
            if len(choice) == 0:
                continue
            at = grid.place(choice, size)
            view = views[kind.view]
            _paint(
                rgb,
                space.number,
                space.cells[at].astype(np.float32) + rng.uniform(-0.5, 0.5, 3).astype(np.float32),
                view.kind,
                view.basis.astype(np.float32),
                space.centre,
                parts.sheet.rgb,
                parts.detail,
                parts.labels,
                detail.label,
                np.float32(detail.x),
                np.float32(detail.y),
                np.float32(detail.reach),
                parts.sheet.ab[detail.pixel],
                np.float32(kind.across),
                detail.ground,
            )
            total += 1
    return total


class _Buckets:
    """Where things are already, in coarse cells, to keep them from running into each other."""

    def __init__(self, space: Space) -> None:
        self.space = space
        self.step = 8
        self.held: dict[tuple[int, ...], list[tuple[NDArray[np.float32], float]]] = {}

    def place(self, choice: NDArray[np.intp], size: float) -> int:
        """The first of some rows of `space.cells` that has room for a thing of this half length; else the last."""
        for at in choice.tolist():
            point = self.space.cells[at].astype(np.float32)
            key = tuple((point // self.step).astype(int).tolist())
            reach = 1 + int(1.5 * size // self.step)
            near = (
                other
                for i in range(-reach, reach + 1)
                for j in range(-reach, reach + 1)
                for k in range(-reach, reach + 1)
                for other in self.held.get((key[0] + i, key[1] + j, key[2] + k), ())
            )
            if all(float(((point - p) ** 2).sum()) > (0.8 * (size + s)) ** 2 for p, s in near):
                break
        self.held.setdefault(key, []).append((point, size))
        return at


def _kinds(
    space: Space, views: Sequence[View], layers: Sequence[Sequence[Layers]], carve: Carving | None
) -> list[_Kind]:
    """What to strew: each detail of each picture, its length across, its number and its places.

    Not what lies in a structure that is carried with all it holds, as an apple's seeds lie in its carpels.
    """
    speaking = [v for v in range(len(views)) if any(p.details for p in layers[v])]
    # Where a radial or parallel family knows at which height and depth things are, the others' things go there too.
    aspects = [_aspect(layers[v]) for v in range(len(views))]
    kinds = []
    for v in speaking:
        others = [aspects[o] for o in speaking if o != v]
        gates = voxel_gate(space, views[v].kind)
        pixels = np.concatenate([p.sheet.gate for p in layers[v]])
        everywhere = _Places(gates, np.arange(len(gates)))
        shown = _Places(pixels, np.arange(len(pixels)))
        allowed = everywhere
        if views[v].kind == POLAR:
            known = _known_to(space, views, layers, [o for o in speaking if views[o].kind == RADIAL])
            allowed = _Places(gates, np.flatnonzero(known))
        for n, parts in enumerate(layers[v]):
            for d, detail in enumerate(parts.details):
                gate = parts.sheet.gate[detail.pixel]
                if carve is not None and views[v].kind == RADIAL and _held(carve, parts, detail):
                    continue
                voxels, area = everywhere.number(gate), shown.number(gate)
                if voxels == 0 or area == 0:
                    continue
                places = allowed if allowed.number(gate) else everywhere
                width = float(np.sqrt(detail.half[0] * detail.half[1]))
                across = width * float(np.mean(others)) if others else width
                across = float(np.clip(across, 0.5 * min(detail.half), 1.5 * max(detail.half))) / SECTION
                kinds.append(
                    _Kind(v, n, d, across, voxels / area / (2 * SECTION * across) / len(speaking), places, gate)
                )
    return kinds


def _held(carve: Carving, parts: Layers, detail: Detail) -> bool:
    """Whether a carried structure holds this detail of a radial picture."""
    (across, up), (half_across, half_up) = parts.sheet.middle, parts.sheet.half
    radius = np.array([abs(detail.x - across) / half_across])
    return bool(carve.explains(radius, np.array([(up - detail.y) / half_up]))[0])


def _aspect(layers: Sequence[Layers]) -> float:
    """Typical length along the second direction over that along the first, of a family's larger details."""
    halves = np.array([d.half for parts in layers for d in parts.details]).reshape(-1, 2)
    if len(halves) == 0:
        return 1.0
    large = halves[halves.prod(1) >= np.median(halves.prod(1))]
    ratio = float(np.median(large[:, 1] / large[:, 0]))
    return float(np.clip(ratio, 0.5, 2.0))


def _known_to(
    space: Space, views: Sequence[View], layers: Sequence[Sequence[Layers]], families: Sequence[int]
) -> NDArray[np.bool_]:
    """(N,). Voxels near whose place some detail of these families lies; all where there are no such families."""
    known = np.full(len(space.cells), not families)
    for v in families:
        gates = voxel_gate(space, views[v].kind)
        for parts in layers[v]:
            for detail in parts.details:
                known |= (np.abs(gates - parts.sheet.gate[detail.pixel]) <= 0.8).all(1)
    return known


@njit(cache=True)
def _paint(  # type: ignore[no-untyped-def]
    rgb, number, point, kind, basis, centre, picture, opacity, labels, label, x, y, reach, ab, across, ground
):
    """One thing: its picture in its own plane, shrunk like an ellipsoid towards its ends, where its own ground is."""
    ax, ay, az, bx, by, bz = frame_at(kind, basis, centre, point[0], point[1], point[2])
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    grow = np.float32(1.15)  # sections are smaller than what they cut
    far = max(reach * grow, across) + 1
    height, width = opacity.shape
    low0, high0 = max(int(point[0] - far), 0), min(int(point[0] + far) + 2, number.shape[0])
    low1, high1 = max(int(point[1] - far), 0), min(int(point[1] + far) + 2, number.shape[1])
    low2, high2 = max(int(point[2] - far), 0), min(int(point[2] + far) + 2, number.shape[2])
    for i in range(low0, high0):
        for j in range(low1, high1):
            for k in range(low2, high2):
                if number[i, j, k] < 0:
                    continue
                if (
                    (rgb[i, j, k, 0] - ground[0]) ** 2
                    + (rgb[i, j, k, 1] - ground[1]) ** 2
                    + (rgb[i, j, k, 2] - ground[2]) ** 2
                ) > MIXED * MIXED:
                    continue
                dx, dy, dz = np.float32(i) - point[0], np.float32(j) - point[1], np.float32(k) - point[2]
                w = (dx * nx + dy * ny + dz * nz) / across
                if w * w >= np.float32(0.98):
                    continue
                scale = grow * np.sqrt(np.float32(1) - w * w)
                s = (dx * ax + dy * ay + dz * az) / scale
                t = (dx * bx + dy * by + dz * bz) / scale
                if s * s + t * t > reach * reach:
                    continue
                px, py = x + s * ab[0] + t * ab[2], y + s * ab[1] + t * ab[3]
                column, row = px * np.float32(OVER), py * np.float32(OVER)
                c, r = int(column), int(row)
                if c < 0 or r < 0 or c >= width - 1 or r >= height - 1:
                    continue
                u, v = column - np.float32(c), row - np.float32(r)
                if labels[int(row + np.float32(0.5)), int(column + np.float32(0.5))] != label:
                    continue
                for channel in range(3):
                    colour = np.float32(0)
                    alpha = np.float32(0)
                    for m in range(2):
                        for n in range(2):
                            weight = (v if m else 1 - v) * (u if n else 1 - u)
                            colour += weight * picture[r + m, c + n, channel]
                            alpha += weight * opacity[r + m, c + n]
                    rgb[i, j, k, channel] += alpha * (colour - rgb[i, j, k, channel])
