"""The skin of a solid, fitted to its capture at one level of detail."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.fit.sh_fit import fit_sh, surface_views
from engine.fit.skin_fit import fit_skin
from engine.scene.atoms import Atoms
from engine.scene.gaussians import Gaussians
from training.settings import Detail
from training.views import ENTRIES, surface_cameras

__all__ = ["match_skin"]


def match_skin(atoms: Atoms, gaussians: Gaussians, up: NDArray[np.float64], detail: Detail, seed: int) -> Atoms:
    """The atoms with a skin that looks like the capture: colours in closed form, then the geometry too.

    Training does the same with a checkpoint after each step.
    """
    cameras = surface_cameras(gaussians, up, detail.surface_views, detail.surface)
    atoms = fit_sh(atoms, surface_views(atoms, gaussians, cameras, ENTRIES)).atoms
    cameras = surface_cameras(gaussians, up, detail.surface_views, detail.skin_size)
    return fit_skin(atoms, gaussians, cameras, detail.skin_steps, seed)
