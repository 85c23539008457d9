"""Opaque particles that make up a solid object.

Surface atoms are ellipsoids with spherical harmonics. Interior atoms are spheres with a plain colour, seven floats
each, because a cut shows nothing more of them. Atoms have no opacity: all are opaque (paper, section 3.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.scene.gaussians import Gaussians
from engine.scene.sh import rgb_to_sh

__all__ = ["Atoms", "InteriorAtoms", "SurfaceAtoms"]

Float = NDArray[np.float32]


@dataclass(frozen=True)
class SurfaceAtoms:
    """S ellipsoids on the skin, float32."""

    means: Float
    """(S, 3). World units."""
    scales: Float
    """(S, 3). Standard deviations, world units. Range (0, pitch]."""
    quats: Float
    """(S, 4). Unit quaternions, wxyz."""
    sh: Float
    """(S, (d+1)^2, 3). Degree d = 0..3."""

    def __post_init__(self) -> None:
        n = len(self.means)
        assert self.means.shape == (n, 3), self.means.shape
        assert self.scales.shape == (n, 3), self.scales.shape
        assert self.quats.shape == (n, 4), self.quats.shape
        assert self.sh.ndim == 3 and self.sh.shape[0] == n and self.sh.shape[2] == 3, self.sh.shape
        assert self.sh.shape[1] in (1, 4, 9, 16), self.sh.shape

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0..3."""
        return round(self.sh.shape[1] ** 0.5) - 1


@dataclass(frozen=True)
class InteriorAtoms:
    """I spheres inside the body, float32, which appear on cut faces only."""

    means: Float
    """(I, 3). World units."""
    sigmas: Float
    """(I,). Isotropic standard deviations, world units, about half the local pitch."""
    rgb: Float
    """(I, 3). Range [0, 1]."""

    def __post_init__(self) -> None:
        n = len(self.means)
        assert self.means.shape == (n, 3), self.means.shape
        assert self.sigmas.shape == (n,), self.sigmas.shape
        assert self.rgb.shape == (n, 3), self.rgb.shape

    def __len__(self) -> int:
        return len(self.means)


NO_INTERIOR = InteriorAtoms(np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros((0, 3), np.float32))


@dataclass(frozen=True)
class Atoms:
    """A solid object: its surface and its interior."""

    surface: SurfaceAtoms
    interior: InteriorAtoms
    pitch: float
    """Largest scale of surface atoms and, as long as nothing is trained, lattice constant of the finest interior atoms,
    world units; trained ones may be finer. Range (0, inf)."""

    def __len__(self) -> int:
        return len(self.surface) + len(self.interior)

    def without_skin(self) -> Atoms:
        """The interior alone."""
        skin = self.surface
        none = SurfaceAtoms(skin.means[:0], skin.scales[:0], skin.quats[:0], skin.sh[:0])
        return Atoms(none, self.interior, self.pitch)

    def as_gaussians(self, opacity: float) -> Gaussians:
        """The surface atoms, then the interior ones, all with this opacity and the surface's SH degree."""
        surface, interior = self.surface, self.interior
        n, s = len(self), len(surface)
        coefficients = np.zeros((n, surface.sh.shape[1], 3), np.float32)
        coefficients[:s] = surface.sh
        coefficients[s:, 0] = rgb_to_sh(interior.rgb)
        quats = np.zeros((n, 4), np.float32)
        quats[:s] = surface.quats
        quats[s:, 0] = 1
        return Gaussians(
            np.concatenate([surface.means, interior.means]),
            np.concatenate([surface.scales, np.repeat(interior.sigmas[:, None], 3, axis=1)]),
            quats,
            np.full(n, opacity, np.float32),
            coefficients,
        )

    @cached_property
    def bounds(self) -> Float:
        """(2, 3). Smallest and largest centre along each axis; zeros if there are no atoms."""
        means = np.concatenate([self.surface.means, self.interior.means])
        if not len(means):
            return np.zeros((2, 3), np.float32)
        return np.stack([means.min(0), means.max(0)])
