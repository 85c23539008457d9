"""How deep the layers along the skin of a cut face go."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.sampling import blurred, lengths

__all__ = ["FLESH", "rind_depth"]

LEAST_CONTRAST = 0.08
"""Least RGB distance from the flesh at which a layer along the skin is rind."""

AROUND = 0.9
"""Share of a layer along the skin that must differ from the flesh under it. In the rinds of 22 photographs and pictures
0.95 to 1 does, in the layers of a sandwich or a cake at most 0.87."""

STEP, STEPS = 0.02, 17
"""Thickness in inradii of a layer, and how many are looked at: anything deeper is no rind."""

FLESH = (0.33, 0.5)
"""Depths in inradii between which the flesh is sampled."""


def rind_depth(rgb: NDArray[np.floating], depth: NDArray[np.floating], blur: float, *, goes_around: bool) -> float:
    """Thickness of the layers along the skin, in inradii: beyond it the median colour is that of the flesh.

    `rgb` (H, W, 3): a face, range [0, 1]. `depth` (H, W): under its rim, in inradii, 0 outside. `blur`: standard
    deviation in pixels of the blur under which colours are compared. `goes_around`: whether a rind must go all around:
    what differs in colour on two sides only, like bread above and below a filling, is then no rind. Radial pictures do
    not ask for it, as what differs near the poles is followed along the skin like a rind.
    """
    inside, deep = depth > 0, (depth > FLESH[0]) & (depth < FLESH[1])
    if not deep.any():
        deep = inside
    flesh = np.median(rgb[deep], axis=0)
    # The flesh under each pixel: layers that end at the skin have the same colour there.
    under = ndimage.distance_transform_edt(~deep, return_distances=False, return_indices=True)
    smooth = blurred(rgb, blur)
    differs = lengths(smooth - smooth[under[0], under[1]]) > LEAST_CONTRAST
    for i in reversed(range(STEPS)):
        band = (depth > STEP * i) & (depth <= STEP * (i + 1))
        if not band.any() or np.linalg.norm(np.median(rgb[band], axis=0) - flesh) <= LEAST_CONTRAST:
            continue
        if not goes_around or differs[band].mean() >= AROUND:
            return STEP * (i + 1.5)
    return STEP
