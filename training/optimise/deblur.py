"""Colours with which soft atoms show a sharp volume.

An atom shows on a cut face as a Gaussian of half its spacing, so a field of atoms that copy a volume is a blurred one.
Undoing that on the trained planes alone would ring between them; here it is undone everywhere at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms

__all__ = ["deblur"]

# Steps of c += V - F c (Van Cittert). The field keeps 29 % of a pattern as fine as the lattice can hold and more of
# every coarser one, so each step leaves at most 71 % of what is missing; after six the finest is back to 91 % and
# noise has grown threefold.
STEPS = 6


def deblur(atoms: Atoms, target: NDArray[np.float32]) -> NDArray[np.float32]:
    """(I, 3). Interior colours whose kernel field at the atoms is near those wanted there (I, 3). Range [0, 1]."""
    means = atoms.interior.means
    offsets, columns, weights = KernelField(atoms).entries(means)
    field = csr_matrix((weights, columns, offsets), shape=(len(means), len(atoms)))
    field = field[:, len(atoms.surface) :]  # the skin has its own colours, which are not to bleed into the flesh
    total = np.maximum(np.asarray(field.sum(axis=1)), np.finfo(np.float32).tiny).reshape(-1, 1)
    rgb = target
    for _ in range(STEPS):
        rgb = np.clip(rgb + target - (field @ rgb) / total, 0, 1).astype(np.float32)
    return rgb
