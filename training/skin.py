"""Fits the skin of a solid to its capture at one level of detail."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.fit.sh_fit import fit_sh, surface_views
from engine.fit.skin_fit import SkinFit
from engine.scene.atoms import Atoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.threads import one_thread_for_torch
from training.checkpoint import CHECKPOINT_SECONDS, Checkpoint
from training.priors.prior import Progress
from training.request import Geometry, Interrupted, Request
from training.settings import Detail
from training.views import ENTRIES, surface_cameras

__all__ = ["fit_geometry", "match_skin"]

DRAWN = 0.2
"""Fraction of a fit's time that drawing the capture takes."""


def match_skin(
    atoms: Atoms,
    gaussians: Gaussians,
    body: Body,
    up: NDArray[np.float64],
    detail: Detail,
    seed: int,
    progress: Progress = lambda part: None,
) -> Atoms:
    """The atoms with a skin that looks like the capture of a body: colours in closed form, then the geometry too.

    Training does the same with checkpoints. `progress` may raise an exception, which is passed on.
    """
    with one_thread_for_torch():
        cameras = surface_cameras(gaussians, up, detail.surface_views, detail.surface)
        atoms = fit_sh(atoms, surface_views(atoms, gaussians, cameras, ENTRIES)).atoms
        cameras = surface_cameras(gaussians, up, detail.skin_views, detail.skin_size)
        fit = SkinFit(atoms, gaussians, body, cameras, detail.skin_steps, seed, lambda part: progress(DRAWN * part))
        while fit.step < fit.steps:
            fit.advance()
            progress(DRAWN + (1 - DRAWN) * fit.step / fit.steps)
        return fit.result()


def fit_geometry(
    atoms: Atoms, geometry: Geometry, request: Request, checkpoint: Checkpoint, progress: Progress
) -> Atoms:
    """The atoms with means, scales, rotations and colours of the skin fitted to the capture. Bit-equal, resumed or not.

    If `progress` raises Interrupted to stop the run, the state is saved before it is passed on.
    """
    stored = checkpoint.load("skin")
    if stored is None or "step" in stored[1]:
        detail, gaussians = request.fineness, geometry.gaussians
        cameras = surface_cameras(gaussians, geometry.up, detail.skin_views, detail.skin_size)
        fit = SkinFit(
            atoms,
            gaussians,
            geometry.enclosed,
            cameras,
            detail.skin_steps,
            request.seed,
            lambda part: progress(DRAWN * part),
        )
        if stored is not None:
            fit.restore(stored[0], stored[1]["step"])
        saved = time.perf_counter()

        def save() -> None:
            checkpoint.save("skin", fit.state(), {"step": fit.step})

        while fit.step < fit.steps:
            fit.advance()
            try:
                progress(DRAWN + (1 - DRAWN) * fit.step / fit.steps)
            except Interrupted:
                save()
                raise
            if time.perf_counter() - saved > CHECKPOINT_SECONDS:
                save()
                saved = time.perf_counter()
        s = fit.result().surface
        stored = {"means": s.means, "scales": s.scales, "quats": s.quats, "sh": s.sh}, {}
        checkpoint.save("skin", *stored)
    return replace(atoms, surface=SurfaceAtoms(**stored[0]))
