"""A 3DGS scene in memory, with activated values instead of logits and logs."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Gaussians"]

Float = NDArray[np.float32]

FIRM = 0.3
"""Opacity from which a Gaussian alone decides what is seen."""

STRAYS = 0.003
"""Share of the firm Gaussians cut off at either end of the visible box: strays are fewer, a stem's tip has more."""


@dataclass(frozen=True)
class Gaussians:
    """The N Gaussians of a 3DGS scene, all arrays float32."""

    means: Float
    """(N, 3). Centres, world units."""
    scales: Float
    """(N, 3). Standard deviations along the principal axes, world units. Range (0, inf)."""
    quats: Float
    """(N, 4). Unit quaternions, wxyz, principal axes to world."""
    opacities: Float
    """(N,). Range [0, 1]."""
    sh: Float
    """(N, (d+1)^2, 3). Spherical harmonics of degree d = 0..3, coefficient-major, RGB last."""
    origin: tuple[float, float, float] = field(default=(0.0, 0.0, 0.0), kw_only=True)
    """Position of the zero of `means` in the file's coordinates (engine.io.origin)."""

    def __post_init__(self) -> None:
        n = len(self.means)
        bands = self.sh.shape[1] if self.sh.ndim == 3 else 0
        assert self.means.shape == (n, 3), self.means.shape
        assert self.scales.shape == (n, 3), self.scales.shape
        assert self.quats.shape == (n, 4), self.quats.shape
        assert self.opacities.shape == (n,), self.opacities.shape
        assert bands in (1, 4, 9, 16) and self.sh.shape == (n, bands, 3), self.sh.shape

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0..3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    def visible_bounds(self) -> NDArray[np.float64]:
        """(2, 3). Corners of the box around what pictures show, thin parts included; around all if none is firm."""
        firm = self.means[self.opacities > FIRM] if (self.opacities > FIRM).any() else self.means
        return np.quantile(firm.astype(np.float64), [STRAYS, 1 - STRAYS], axis=0)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.integer] | slice) -> Gaussians:
        """The Gaussians of these rows: a mask (N,), indices (M,) or a slice."""
        means, scales, quats = self.means[rows], self.scales[rows], self.quats[rows]
        return Gaussians(means, scales, quats, self.opacities[rows], self.sh[rows], origin=self.origin)
