"""The default prior: interiors from photographs of cut faces, offline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.scene.grid import Body
from training.families import Family
from training.priors.exemplar.pictures import Picture, read_picture
from training.priors.exemplar.solve import solve
from training.priors.prior import Progress, Volume

__all__ = ["ExemplarPrior", "Picture", "read_picture"]


class ExemplarPrior:
    """Places what the pictures of a family show at the corresponding positions in the body."""

    def __init__(self, same: bool = False) -> None:
        """`same`: whether the pictures are known to show one and the same thing; otherwise that is detected."""
        self.same = same

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

        Raises InputError if no family has a picture, or one shows no cut face.
        """
        return solve(body, up, families, voxels, seed, progress, self.same)
