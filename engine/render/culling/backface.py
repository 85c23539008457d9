"""Backface culling of a skin's atoms: the solid below the skin hides those that face away from the eye.

On a closed, filled body a point whose outward normal faces away from the eye lies behind the body's own front, or
behind a cut face. An atom gets a cone of normals (a mean axis and the least cosine to it) only where that argument
holds: the skin consists of flat discs, has solid below it and air above it, and hardly bends within the reach of an
atom. Everywhere else an atom has no cone and is always drawn. If the solid lacks skin anywhere, no atom has a cone,
because the far side could be seen from inside through the hole. Nor is an atom culled if the line of sight enters
through a cut face near the skin, since the face may have a gap there.

Holes finer than the grid go unnoticed, so hidden atoms are not dropped but drawn last. The graphics card tests them
against the depth of what was drawn, the software kernels tile by tile (engine.render.cpu.software_holes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.scene.atoms import Atoms
from engine.scene.rotations import normalised_quats, rotation_matrices

__all__ = ["DEEP", "NEVER", "SHELL", "BackfaceCulling", "NormalCones", "backface_culling", "no_culling"]

Float = NDArray[np.float32]

NEVER = 2.0
"""Least cosine of an atom that is never culled: no cosine reaches it."""

FLAT = 0.5
"""Ratio of the two shortest axes from which an atom is no longer a disc and has no normal."""

CELL = 1.5
"""Edge of an occupancy cell in pitches: a cell holds three or four lattice atoms, smoothed over 4 x 4 x 4 cells."""

FILLED = 0.4
"""Fraction of a full cell's lattice from which the cell counts as solid."""

DENSE = 0.7
"""Fraction of a full cell's lattice from which a cut face through the cell has no gaps."""

EMPTY, SHELL, DEEP = 0, 1, 2
"""Zones of cells: nothing there; near the skin or sparse; inside the solid, with solid cells on all sides."""

MARGIN = math.radians(8.0)
"""Angle beyond edge-on: an atom turned away by less may still belong to a silhouette."""

MARGIN_STEP = math.radians(3.0)
"""Steps in which the margin grows with the footprint of a pixel."""

MOST_CELLS = 1 << 25
"""Largest occupancy grid; an object spread over more cells has no cones."""


class NormalCones(NamedTuple):
    """The cones for one eye, as the kernels read them; floats are float32. A named tuple, which numba can read."""

    axes: Float
    """(S, 3). Outward unit vectors."""
    min_cosine: Float
    """(S,). An atom is hidden if dot(axis, direction from the eye to it) is at least this; NEVER: always drawn."""
    zone: NDArray[np.uint8]
    """(X, Y, Z). EMPTY, SHELL or DEEP, cell by cell."""
    low: Float
    """(3,). Outer corner of cell (0, 0, 0), world units."""
    cell: np.float32
    """Edge of a cell, world units."""


@dataclass(frozen=True)
class BackfaceCulling:
    """What is known about a skin before the camera is."""

    axes: Float
    """(S, 3). Outward unit vectors, one for each surface atom."""
    min_cosine: Float
    """(S,). As in `NormalCones`, for pixels of no size."""
    zone: NDArray[np.uint8]
    """(X, Y, Z). EMPTY, SHELL or DEEP, cell by cell."""
    low: NDArray[np.float64]
    """(3,). Outer corner of cell (0, 0, 0), world units."""
    cell: float
    """Edge of a cell, world units."""
    pitch: float
    """Pitch of the solid, world units."""

    def cones(self, eye: NDArray[np.float64] | None, footprint: float) -> NormalCones:
        """The cones for an eye (3,), None if infinitely far away, and pixels that span `footprint` world units."""
        low = self.low.astype(np.float32)
        return NormalCones(self.axes, self._min_cosine_at(eye, footprint), self.zone, low, np.float32(self.cell))

    def _min_cosine_at(self, eye: NDArray[np.float64] | None, footprint: float) -> Float:
        """(S,). `min_cosine`, widened for the size of a pixel.

        From inside the solid, where the skin is seen from behind, nothing is hidden.

        An atom turned away by an angle m lies inside the silhouette by (1 - cos m) radii of curvature; a margin of two
        pixels at a radius of twenty pitches leaves the silhouette as it is. The margin grows in steps, so that few
        versions are ever computed.
        """
        if eye is not None:
            index = np.floor((eye - self.low) / self.cell).astype(np.int64)
            inside = (index >= 0).all() and (index < self.zone.shape).all()
            if inside and self.zone[tuple(index)] != EMPTY:
                return np.full_like(self.min_cosine, NEVER)
        away = math.acos(max(-1.0, 1 - 2 * footprint / (20 * self.pitch)))
        step = max(0, math.ceil((away - MARGIN) / MARGIN_STEP))
        if step not in self._widened:
            angle = np.arcsin(np.minimum(self.min_cosine, 1)) + step * MARGIN_STEP
            widened = np.where((self.min_cosine <= 1) & (angle < math.pi / 2), np.sin(angle), NEVER)
            self._widened[step] = widened.astype(np.float32)
        return self._widened[step]

    _widened: dict[int, Float] = field(default_factory=dict, init=False, repr=False, compare=False)


def no_culling(count: int) -> BackfaceCulling:
    """The culling of `count` atoms without cones, which are always drawn."""
    min_cosine = np.full(count, NEVER, np.float32)
    return BackfaceCulling(
        np.zeros((count, 3), np.float32), min_cosine, np.zeros((1, 1, 1), np.uint8), np.zeros(3), 1.0, 1.0
    )


def backface_culling(atoms: Atoms) -> BackfaceCulling:
    """The cones of the surface atoms: which the solid hides, and from where."""
    skin, inside = atoms.surface, atoms.interior
    if not len(skin) or not len(inside):
        return no_culling(len(skin))
    cell = CELL * atoms.pitch
    low = np.minimum(skin.means.min(0), inside.means.min(0)).astype(np.float64) - 4 * cell
    high = np.maximum(skin.means.max(0), inside.means.max(0)).astype(np.float64) + 4 * cell
    shape = np.ceil((high - low) / cell).astype(np.int64) + 1
    if shape.prod() > MOST_CELLS:
        return no_culling(len(skin))

    def cells_of(points: NDArray[np.floating]) -> NDArray[np.int64]:
        return np.floor((points - low) / cell).astype(np.int64)

    solid = np.zeros(shape, np.float32)
    spacing = 2 * inside.sigmas / cell
    parts = np.ceil(spacing).astype(np.int64)
    for count in np.unique(parts):  # an atom wider than a cell fills every cell of its cube
        chosen = parts == count
        steps = ((np.arange(count) + 0.5) / count - 0.5).astype(np.float32)
        for step in np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3):
            places = cells_of(inside.means[chosen] + step * 2 * inside.sigmas[chosen, None])
            np.add.at(solid, tuple(places.T), (spacing[chosen] / count) ** 3)
    for axis in range(3):  # smooths how many lattice points happen to fall into a cell
        solid = (np.roll(solid, 1, axis) + 2 * solid + np.roll(solid, -1, axis)) / 4
    filled = solid >= FILLED
    skinned = np.zeros(shape, bool)
    skinned[tuple(cells_of(skin.means).T)] = True
    deep = ~dilated(solid < DENSE) & ~dilated(skinned)
    zone = np.where(deep, DEEP, np.where(dilated(filled | skinned), SHELL, EMPTY)).astype(np.uint8)
    if not is_covered(filled, skinned):
        return no_culling(len(skin))

    normals, flat = disc_normals(skin.scales, skin.quats)
    means = skin.means.astype(np.float64)
    under = filled[tuple(cells_of(means - 1.5 * cell * normals).T)]
    over = filled[tuple(cells_of(means + 1.5 * cell * normals).T)]
    normals = np.where((over & ~under)[:, None], -normals, normals)
    backed = flat & (under != over) & filled[tuple(cells_of(means - 3 * cell * normals).T)]
    axes, cosines = normal_cones(cells_of(means), shape, normals.astype(np.float32), backed)
    angle = np.arccos(np.clip(cosines, -1, 1)) + MARGIN
    min_cosine = np.where((cosines > 0) & (angle < math.pi / 2), np.sin(angle), NEVER)
    return BackfaceCulling(axes, min_cosine.astype(np.float32), zone, low, cell, float(atoms.pitch))


def dilated(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask (X, Y, Z) grown by one cell in all directions, corners included."""
    for axis in range(3):
        mask = mask | np.roll(mask, 1, axis) | np.roll(mask, -1, axis)
    return mask


def disc_normals(scales: Float, quats: Float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Shortest axes (S, 3), of either sign, and which atoms (S,) are flat enough for that to be a normal."""
    order = np.sort(scales, axis=1)
    columns = rotation_matrices(normalised_quats(quats)).transpose(0, 2, 1)
    return columns[np.arange(len(scales)), scales.argmin(1)], order[:, 0] < FLAT * order[:, 1]


def is_covered(filled: NDArray[np.bool_], skinned: NDArray[np.bool_]) -> bool:
    """Whether every filled cell with an empty neighbour has skin nearby."""
    near = dilated(skinned)
    border = np.zeros_like(filled)
    for axis in range(3):
        border |= ~np.roll(filled, 1, axis) | ~np.roll(filled, -1, axis)
    return not bool((filled & border & ~near).any())


@njit(cache=True)
def normal_cones(cells, shape, normals, backed):
    """Mean normal (S, 3) of each atom's cell, and the least cosine (S,) to it in that cell and its neighbours.

    The cosine is -1 if one of the atoms there does not lie flat on the solid (`backed`).
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
