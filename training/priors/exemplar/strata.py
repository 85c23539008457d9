"""Texture in thin layers, each taken from another part of a picture.

A picture shows its texture in one plane only. Extended along the axis it would become rods, and sheared or drifting,
wavy lines. In layers across the axis, about as thick as the grain is long, every cut shows as much texture as the
picture, and cuts parallel to the picture show it as it was photographed. A picture that is turned about an
axis has its layers around it (`Fan`). They split in two where they become too thick: wedges from the axis to the skin
would be rays about the one and bars under the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.noise import Noise

__all__ = ["LAYER", "Fan", "Rows", "Waves", "beside_own", "read_layers"]

LAYER = 1.5
"""Thickness of a layer over the grain of its texture, so that it changes as fast along the axis as around it. Thicker
layers show as streaks in the other cuts: features of radial cuts up to 0.4 worse for each doubling from 2.5 on."""

PASSING = 0.15
"""Share of a layer over which it blends into the next. Elsewhere the texture is one picture's own, with its lines:
blending all along blurs them by chance (features of radial cuts of four pairs 0.03 to 0.15 worse)."""

WAVE, WAVE_LENGTH = 0.25, 3.0
"""Standard deviation and length of the layers' waves, in thicknesses. In cuts across them, flat layers show as rows of
bricks; 0.4 and 2.0 break up the lines of a texture in cuts along them (slope across over along it 1.4, here 2.6)."""

SHORTEST = 0.02
"""Length of the shortest waves in radii: with it their lattice has 130 cells along a side."""

INNERMOST = 3
"""Layers that meet at an axis, around which they are as thick as others are."""

Rows = NDArray[np.bool_] | NDArray[np.intp] | slice
"""Some of the points, or all of them: a slice copies nothing."""

Read = Callable[[NDArray[np.int64], Rows], NDArray[np.float32]]
"""(R, 3). The texture of layers (R,) at some rows of the points."""


class Waves:
    """Waves by which layers differ from planes."""

    def __init__(self, thickness: float, rng: np.random.Generator) -> None:
        """`thickness`: of the layers, in radii."""
        self._noise = Noise((max(WAVE_LENGTH * thickness, SHORTEST),) * 3, 1, rng)

    def at(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M,). The offset of the layers, in thicknesses, at points (M, 3) in radii."""
        return WAVE * self._noise.at(points)[:, 0]


def read_layers(height: NDArray[np.floating], read: Read) -> NDArray[np.float32]:
    """(M, 3). The layered texture at points of this height (M,), in layers.

    Layers blend such that the variance is kept (Heitz and Neyret 2018), as averaging would blur.
    """
    whole = np.floor(height)
    part = (height - whole - (1 - PASSING)) / PASSING
    layer = whole.astype(np.int64)
    out = read(layer, slice(None))
    rows = np.flatnonzero(part > 0)
    turn = np.pi / 2 * part[rows, None]
    out[rows] = np.cos(turn) * out[rows] + np.sin(turn) * read(layer[rows] + 1, rows)
    return out


@dataclass(frozen=True)
class Fan:
    """Layers around an axis, all about as thick: each splits in two where the radius has doubled."""

    thickness: float
    widest: float
    """Largest distance from the axis, in the units of `thickness`."""

    @property
    def count(self) -> int:
        """How many layers there are in all."""
        last = self._ring(np.array([self.widest])).astype(np.int64)
        return int(self._before(last + 3)[0])  # of rings that waves and a blend reach

    def read(
        self, radius: NDArray[np.floating], turn: NDArray[np.floating], waves: NDArray[np.floating], read: Read
    ) -> NDArray[np.float32]:
        """(M, 3). The layered texture at points at a radius (M,) and angle (M,) in turns, with `waves` (M,) in
        thicknesses."""

        def ring(rings: NDArray[np.int64], rows: Rows) -> NDArray[np.float32]:
            around, these = self._before(rings + 1) - self._before(rings), np.arange(len(turn))[rows]

            def layer(layers: NDArray[np.int64], some: Rows) -> NDArray[np.float32]:
                return read(self._before(rings[some]) + layers % around[some], these[some])

            return read_layers(turn[rows] * around + waves[rows], layer)

        return read_layers(self._ring(radius + waves * self.thickness), ring)

    def _ring(self, radius: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M,). Which ring of layers lies at a radius (M,). In the middle of each, they have their thickness."""
        middle = 2 * np.pi * radius / (INNERMOST * self.thickness)
        return np.log2(np.maximum(middle, 1)) + 0.5

    @staticmethod
    def _before(ring: NDArray[np.int64]) -> NDArray[np.int64]:
        """(M,). The layers in rings before these (M,)."""
        return INNERMOST * (2**ring - 1)


def beside_own(
    texture: NDArray[np.float32], own: NDArray[np.float32], distance: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(M, 3). The `texture` (M, 3) of layers, blended into the picture's `own` (M, 3) near the plane that it shows.

    `distance` (M,): from that plane, in thicknesses of a layer.
    """
    share = np.exp(-np.square(distance))[:, None].astype(np.float32)
    return share * own + np.sqrt(1 - share * share) * texture
