"""Which atoms of a skin the solid under them hides: those that look away from the eye.

On a closed, filled body a point whose outward normal points away from the eye lies behind the body's own front, or
behind a cut face. That is only so where the skin is flat discs, has the solid under it and air over it, and hardly
turns within the reach of an atom; everywhere else an atom has no cone and is always drawn. Where the solid shows
anywhere without a skin over it, no atom has one: through a hole the far side would be seen from within. And where the
line of sight enters through a cut face near the skin, the face may have a gap: then the atom is drawn, too.

Holes finer than the grid are not known here: what is hidden is only put last. A graphics card holds it against the
depth of what was drawn, the processor's kernels do so tile by tile (engine.render.cpu.window_holes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.scene.atoms import Atoms
from engine.scene.rotations import matrices, unit_quats

__all__ = ["DEEP", "NO_CONE", "RIND", "Hiding", "hiding", "nothing_hides"]

Float = NDArray[np.float32]

NO_CONE = 2.0
"""Least cosine of an atom that nothing hides: no cosine reaches it."""

FLAT = 0.5
"""Thickness over the next axis from which a disc has no side."""

CELL = 1.5
"""Cells of the occupancy grid, in pitches: one holds three or four lattice atoms, evened out over 4 x 4 x 4 cells."""

FILLED = 0.4
"""Share of a cell's lattice from which it counts as solid."""

DENSE = 0.7
"""Share of a cell's lattice from which a cut face through it has no gap."""

AIR, RIND, DEEP = 0, 1, 2
"""Zones: nothing there; near the skin, or sparse; inside the solid, with a cell of solid all around."""

MARGIN = math.radians(8.0)
"""Beyond edge-on: an atom turned away by less may still round off a silhouette."""

MARGIN_STEP = math.radians(3.0)
"""Fineness with which the margin grows with the footprint of a pixel."""

MOST_CELLS = 1 << 25
"""Cells of the occupancy grid; an object strewn wider than that has no cones."""


@dataclass(frozen=True)
class Hiding:
    """What is known of a skin before any camera is."""

    axes: Float
    """(S, 3). Outward unit vectors, one for each surface atom."""
    least: Float
    """(S,). An atom is hidden where dot(axis, direction from the eye to it) is at least this; NO_CONE: never."""
    zone: NDArray[np.uint8]
    """(X, Y, Z). AIR, RIND or DEEP, cell by cell."""
    low: NDArray[np.float64]
    """(3,). Outer corner of cell (0, 0, 0), world units."""
    cell: float
    """Edge of a cell, world units."""
    pitch: float
    """Of the solid, world units."""

    def least_at(self, eye: NDArray[np.float64] | None, footprint: float) -> Float:
        """(S,). `least` for an eye (3,), None if it is infinitely far, and pixels that span `footprint` world units.

        From within the solid, where one looks at the skin from behind, nothing is hidden.

        What is turned away by m lies inside of the silhouette by (1 - cos m) radii of curvature; two pixels at a
        radius of twenty pitches keep it from rounding the silhouette off. In steps, so that few are ever made.
        """
        if eye is not None:
            at = np.floor((eye - self.low) / self.cell).astype(np.int64)
            if (at >= 0).all() and (at < self.zone.shape).all() and self.zone[tuple(at)] != AIR:
                return np.full_like(self.least, NO_CONE)
        away = math.acos(max(-1.0, 1 - 2 * footprint / (20 * self.pitch)))
        step = max(0, math.ceil((away - MARGIN) / MARGIN_STEP))
        if step not in self._known:
            angle = np.arcsin(np.minimum(self.least, 1)) + step * MARGIN_STEP
            widened = np.where((self.least <= 1) & (angle < math.pi / 2), np.sin(angle), NO_CONE)
            self._known[step] = widened.astype(np.float32)
        return self._known[step]

    _known: dict[int, Float] = field(default_factory=dict, init=False, repr=False, compare=False)


def nothing_hides(count: int) -> Hiding:
    """For atoms that are always drawn."""
    least = np.full(count, NO_CONE, np.float32)
    return Hiding(np.zeros((count, 3), np.float32), least, np.zeros((1, 1, 1), np.uint8), np.zeros(3), 1.0, 1.0)


def hiding(atoms: Atoms) -> Hiding:
    """What the solid hides of its surface atoms."""
    skin, inside = atoms.surface, atoms.interior
    if not len(skin) or not len(inside):
        return nothing_hides(len(skin))
    cell = CELL * atoms.pitch
    low = np.minimum(skin.means.min(0), inside.means.min(0)).astype(np.float64) - 4 * cell
    high = np.maximum(skin.means.max(0), inside.means.max(0)).astype(np.float64) + 4 * cell
    shape = np.ceil((high - low) / cell).astype(np.int64) + 1
    if shape.prod() > MOST_CELLS:
        return nothing_hides(len(skin))

    def cells_of(points: NDArray[np.floating]) -> NDArray[np.int64]:
        return np.floor((points - low) / cell).astype(np.int64)

    at = cells_of(inside.means)
    solid = np.zeros(shape, np.float32)
    spacing = 2 * inside.sigmas / cell
    parts = np.ceil(spacing).astype(np.int64)
    for count in np.unique(parts):  # an atom wider than a cell fills all that its cube covers
        own = parts == count
        steps = ((np.arange(count) + 0.5) / count - 0.5).astype(np.float32)
        for step in np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3):
            places = cells_of(inside.means[own] + step * 2 * inside.sigmas[own, None])
            np.add.at(solid, tuple(places.T), (spacing[own] / count) ** 3)
    for axis in range(3):  # evens out how many lattice points happen to fall into a cell
        solid = (np.roll(solid, 1, axis) + 2 * solid + np.roll(solid, -1, axis)) / 4
    filled = solid >= FILLED
    skinned = np.zeros(shape, bool)
    skinned[tuple(cells_of(skin.means).T)] = True
    deep = ~spread(solid < DENSE) & ~spread(skinned)
    zone = np.where(deep, DEEP, np.where(spread(filled | skinned), RIND, AIR)).astype(np.uint8)
    skinned[tuple(at[: inside.exposed].T)] = True
    if not closed(filled, skinned):
        return nothing_hides(len(skin))

    normals, flat = discs(skin.scales, skin.quats)
    means = skin.means.astype(np.float64)
    under = filled[tuple(cells_of(means - 1.5 * cell * normals).T)]
    over = filled[tuple(cells_of(means + 1.5 * cell * normals).T)]
    normals = np.where((over & ~under)[:, None], -normals, normals)
    backed = flat & (under != over) & filled[tuple(cells_of(means - 3 * cell * normals).T)]
    axes, cosines = cones(cells_of(means), shape, normals.astype(np.float32), backed)
    angle = np.arccos(np.clip(cosines, -1, 1)) + MARGIN
    least = np.where((cosines > 0) & (angle < math.pi / 2), np.sin(angle), NO_CONE)
    return Hiding(axes, least.astype(np.float32), zone, low, cell, float(atoms.pitch))


def spread(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask and all cells that touch it."""
    for axis in range(3):
        mask = mask | np.roll(mask, 1, axis) | np.roll(mask, -1, axis)
    return mask


def discs(scales: Float, quats: Float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Shortest axes (S, 3), of either sign, and which atoms are flat enough to have a side."""
    order = np.sort(scales, axis=1)
    columns = matrices(unit_quats(quats)).transpose(0, 2, 1)
    return columns[np.arange(len(scales)), scales.argmin(1)], order[:, 0] < FLAT * order[:, 1]


def closed(filled: NDArray[np.bool_], skinned: NDArray[np.bool_]) -> bool:
    """Whether each filled cell beside an empty one has skin in its neighbourhood."""
    near = spread(skinned)
    border = np.zeros_like(filled)
    for axis in range(3):
        border |= ~np.roll(filled, 1, axis) | ~np.roll(filled, -1, axis)
    return not bool((filled & border & ~near).any())


@njit(cache=True)
def cones(cells, shape, normals, backed):
    """Mean normal (S, 3) of each atom's cell, and the least cosine (S,) to it in that cell and those around it.

    The cosine is -1 where one of the atoms there is not backed.
    """
    n = len(cells)
    sums = np.zeros((shape[0], shape[1], shape[2], 3), np.float32)
    for i in range(n):
        for c in range(3):
            sums[cells[i, 0], cells[i, 1], cells[i, 2], c] += normals[i, c]
    least = np.ones((shape[0], shape[1], shape[2]), np.float32)
    for i in range(n):
        for dx in range(-1, 2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    x, y, z = cells[i, 0] + dx, cells[i, 1] + dy, cells[i, 2] + dz
                    s = sums[x, y, z]
                    length = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
                    cosine = np.float32(-1.0)
                    if backed[i] and length > 0:
                        cosine = (s[0] * normals[i, 0] + s[1] * normals[i, 1] + s[2] * normals[i, 2]) / length
                    least[x, y, z] = min(least[x, y, z], cosine)
    axes = np.zeros((n, 3), np.float32)
    cosines = np.empty(n, np.float32)
    for i in range(n):
        s = sums[cells[i, 0], cells[i, 1], cells[i, 2]]
        length = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        cosines[i] = least[cells[i, 0], cells[i, 1], cells[i, 2]] if length > 0 else np.float32(-1.0)
        for c in range(3):
            axes[i, c] = s[c] / length if length > 0 else np.float32(0.0)
    return axes, cosines
