"""The body of a trained object, recovered from its atoms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms
from engine.scene.constants import SOLID_DENSITY
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.solid.signed_distance import signed_depth
from engine.solid.visible_skin import out_to_front

__all__ = ["body_of", "skin_outside"]

MOST_CELLS = 256
"""Most cells along the longest side of the grid: the largest that training finds a body on, 1.1 GB for a cube."""

CELL = 0.75
"""Pitches. A mesh on cells of this size lies within a fortieth of a pitch of the skin of a ball; for a draft it has
24,000 triangles."""

MOST_SHIFT = 0.25
"""Pitches. Most that the skin is moved to hold what the interior atoms fill. Skin atoms of a ball stand a tenth of a
pitch below the skin that they show, which is 1 % of the volume of a draft."""

MARGIN = 4
"""Cells around the interior atoms: the tangent planes move the skin by up to 1.5."""

BISECTIONS = 16
"""Bisections of that shift: to a hundred-thousandth of a pitch."""

BLOCK = 1 << 20
"""Points whose density is read at once."""

AWAY = 2.0
"""Pitches. Farther out than this from the body an atom of the skin is part of a leaf or a mat, not of the body."""


def body_of(atoms: Atoms, name: str) -> Body:
    """The solid that the interior atoms fill, with its skin where the surface atoms show it.

    A trained object does not keep the body that was filled. Its inside is recovered as the cells that the interior
    atoms fill, by the law of cut faces, and the tangent planes of the surface atoms place the skin to a fraction of a
    cell. Then the skin is moved evenly until the volume is that of the lattice cells that the interior atoms stand for,
    (2 sigma)^3 each. Raises InputError, in a line that begins with `name`, if interior atoms fill nothing.
    """
    interior = atoms.interior
    if not len(interior):
        raise InputError(f"{name}: there is no inside to export; train the object first")
    bounds = np.stack([interior.means.min(0), interior.means.max(0)]).astype(np.float64)
    least = float(np.ptp(bounds, axis=0).max()) / (MOST_CELLS - 2 * MARGIN)
    grid = Grid.around(bounds, max(CELL * atoms.pitch, least), MARGIN)
    inside = ndimage.binary_fill_holes(_density(atoms, grid) >= SOLID_DENSITY)
    if not inside.any():
        raise InputError(f"{name}: its interior atoms are too few to fill anything; train the object again")
    surface = atoms.surface
    shell = Gaussians(
        surface.means, surface.scales, surface.quats, np.ones(len(surface), np.float32), surface.sh[:, :1]
    )
    body = out_to_front(Body(grid, signed_depth(inside, shell, grid)), surface, atoms.pitch)
    return _filled_by(body, float(((2 * interior.sigmas.astype(np.float64)) ** 3).sum()), MOST_SHIFT * atoms.pitch)


def skin_outside(atoms: Atoms, body: Body) -> float:
    """Share of the surface atoms that are not skin of the body: leaves, strings and mats, which have no inside.
    Range [0, 1]."""
    if not len(atoms.surface):
        return 0.0
    return float((body.at(atoms.surface.means) < -AWAY * max(atoms.pitch, body.grid.cell)).mean())


def _filled_by(body: Body, volume: float, most: float) -> Body:
    """The body with its skin moved by at most `most`, so that it has this volume if it can."""
    low, high = -most, most
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if Body(body.grid, body.depth + np.float32(middle)).volume < volume:
            low = middle
        else:
            high = middle
    return Body(body.grid, body.depth + np.float32((low + high) / 2))


def _density(atoms: Atoms, grid: Grid) -> NDArray[np.float32]:
    """(X, Y, Z). Sum of the weights of the interior atoms at the cell centres."""
    field = KernelField(atoms.without_skin())
    points = grid.centres().reshape(-1, 3)
    parts = [field.at(points[start : start + BLOCK])[1] for start in range(0, len(points), BLOCK)]
    return np.concatenate(parts).reshape(grid.shape)
