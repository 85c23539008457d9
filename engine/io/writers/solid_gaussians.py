"""Pieces of a solid as the Gaussians of a 3DGS file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.scene.atoms import Atoms
from engine.scene.gaussians import Gaussians
from engine.scene.moved import moved
from engine.scene.piece import Piece

__all__ = ["ATOM_OPACITY", "joined", "piece_gaussians"]

ATOM_OPACITY = 0.999
"""Opacity of an atom in a file. 1 has no finite logit; at 0.999 two atoms in a row transmit 1e-6."""


def piece_gaussians(atoms: Atoms, cells: Sequence[Piece]) -> Gaussians:
    """One piece, given as convex cells with a common motion: the atoms whose centres are in any of them, moved and
    turned with it.

    Other viewers cannot divide an atom, so cut faces are as rough there as the atoms are large. Interior atoms are
    spheres and keep the identity as their rotation.
    """
    gaussians = atoms.as_gaussians(ATOM_OPACITY)
    means = gaussians.means.astype(np.float64)
    inside = np.zeros(len(means), bool)
    for cell in cells:
        inside |= np.logical_and.reduce([np.ones(len(means), bool), *(p.distance(means) <= 0 for p in cell.planes)])
    transform = cells[0].transform
    result = moved(gaussians[inside], transform[:3, :3], transform[:3, 3])
    result.quats[np.count_nonzero(inside[: len(atoms.surface)]) :] = (1, 0, 0, 0)
    return result


def joined(parts: Sequence[Gaussians]) -> Gaussians:
    """Several sets of Gaussians as one, with the highest SH degree among them: others look the same from all sides."""
    bands = max((part.sh.shape[1] for part in parts), default=1)
    parts = [replace(part, sh=np.pad(part.sh, ((0, 0), (0, bands - part.sh.shape[1]), (0, 0)))) for part in parts]
    names = ("means", "scales", "quats", "opacities", "sh")
    return Gaussians(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
