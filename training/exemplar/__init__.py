"""The default prior: interiors from photographs of cut faces, offline (DESIGN section 5.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.body import Body
from engine.errors import InputError
from training.exemplar.denoise import Patches, denoised, pixels_per_radius, prepare
from training.exemplar.patches import FIXED, POLAR, RADIAL
from training.exemplar.pictures import Picture, read_picture
from training.exemplar.solve import solve
from training.families import Family
from training.prior import Condition, Progress, Volume

__all__ = ["ExemplarPrior", "Picture", "read_picture"]


class ExemplarPrior:
    """Copies what the pictures of a family show to where in the body it belongs."""

    def __init__(self) -> None:
        self._patches: dict[tuple[Family, int], Patches] = {}

    def solve(
        self,
        body: Body,
        up: NDArray[np.float64],  # [3]
        families: Sequence[Family],
        voxels: int,
        seed: int,
        progress: Progress,
    ) -> Volume:
        """The interior on a grid of `voxels` cells along the body's longest side, or fewer. Bit-equal for a seed.

        Raises InputError where no family has a picture, or one shows no cut face.
        """
        return solve(body, up, families, voxels, seed, progress)

    def denoise(
        self,
        noisy: NDArray[np.float32],  # [H, W, 3]
        sigma: float,
        condition: Condition,
        rng: np.random.Generator,
    ) -> NDArray[np.float32]:
        """(H, W, 3). The noise in `noisy` in units of one: what its posterior mean over the exemplar patches leaves.

        Draws nothing from `rng`. Raises InputError where the family has no picture, or one shows no cut face.
        """
        family = condition.family
        if not family.exemplars:
            raise InputError(f"family '{family.kind}': no exemplar pictures; give it a photograph of a cut face")
        radius = pixels_per_radius(condition)
        # Pictures of one size share their patches: two per cent of scale is less than a photograph is sure of.
        step = round(np.log(radius) / 0.02)
        key = (family, step)
        if key not in self._patches:
            kind = {"horizontal": POLAR, "radial": RADIAL}.get(family.kind, FIXED)
            pictures = [read_picture(p, family.kind) for p in family.exemplars]
            self._patches[key] = prepare(pictures, kind, float(np.exp(0.02 * step)), _inradius(condition))
        return (noisy - denoised(noisy, sigma, condition, self._patches[key])) / max(sigma, 1e-6)


def _inradius(condition: Condition) -> float:
    """Inradius of the body in pixels of the condition's pictures, by how fast the depth grows away from the edge."""
    gy, gx = np.gradient(condition.under_skin)
    slope = np.hypot(gx, gy)[condition.inside]
    steepest = float(np.quantile(slope, 0.9)) if len(slope) else 0.0
    return 1 / max(steepest, 1e-3)
