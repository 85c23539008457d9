"""Colours of a trained object at points of its skin and of its inside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import NO_INTERIOR, Atoms
from engine.scene.constants import MIN_WEIGHT
from engine.scene.inside import Inside, Kind

__all__ = ["WIDEN", "Colours"]

Float = NDArray[np.float32]

ATOMS_DETAIL = 0.5
"""Pitches. What the atoms resolve where there is no inside: the standard deviation of the finest of them."""

WIDEN = 1.0
"""Pitches. Footprint at which the skin is read: flat atoms then reach half a pitch to either side, as the opaque image
blends them, and along the skin they keep their size."""

BLOCK = 200_000
"""Points that are read at once: bounds the memory of intermediate results."""


@dataclass(frozen=True)
class Colours:
    """What an object shows, for a texture or a volume."""

    atoms: Atoms
    inside: Inside | None
    """None if there are only atoms."""

    @property
    def detail(self) -> float:
        """World units. Distance of neighbouring points at which all details of the inside are kept."""
        return ATOMS_DETAIL * self.atoms.pitch if self.inside is None else self.inside.detail

    def within(self, points: NDArray[np.floating], footprint: float) -> Float:
        """(N, 3). Colours of the inside at points (N, 3), without details finer than the footprint, world units. Range
        [0, 1]."""
        out = np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), BLOCK):
            block = points[start : start + BLOCK]
            if self.inside is not None:
                rgb = self.inside.at(block, footprint)
            else:
                rgb = self._read(self._all, block, footprint)
            out[start : start + len(block)] = rgb
        return np.clip(out, 0, 1)

    def skin(self, points: NDArray[np.floating], footprint: float) -> Float:
        """(N, 3). Colours of the skin at points (N, 3) on it, seen from no side in particular: the mean over all
        directions, which is the degree 0 of the harmonics. Range [0, 1]."""
        out = np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), BLOCK):
            block = points[start : start + BLOCK]
            out[start : start + len(block)] = self._read(self._outside, block, max(footprint, WIDEN * self.atoms.pitch))
        return np.clip(out, 0, 1)

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(N,). The `Kind` at points (N, 3) in the body. With atoms alone it is always INSIDE."""
        if self.inside is None:
            return np.full(len(points), Kind.INSIDE, np.uint8)
        return self.inside.kinds(points)

    @cached_property
    def _all(self) -> KernelField:
        return KernelField(self.atoms)

    @cached_property
    def _outside(self) -> KernelField:
        """The field of the surface atoms."""
        return KernelField(replace(self.atoms, interior=NO_INTERIOR))

    def _read(self, field: KernelField, points: NDArray[np.floating], footprint: float) -> Float:
        """(M, 3). Colours of a field; where it has nothing, those of all atoms, at larger and larger footprints."""
        rgb, weight = field.at(points, footprint)
        reach = max(footprint, self.atoms.pitch)
        while (bare := np.flatnonzero(weight < MIN_WEIGHT)).size and reach < 64 * self.atoms.pitch:
            reach *= 2
            rgb[bare], weight[bare] = self._all.at(points[bare], reach)
        return rgb
