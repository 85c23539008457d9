"""Texture in thin layers, each with that of another part of a picture.

A picture shows its texture in one plane only. Carried along the axis it would be rods, and sheared or drifting it would
be wavy lines. In layers across the axis, about as thick as its grain is long, every cut shows as much of it as the
picture, and the cuts that lie as the picture did show it as it was photographed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.noise import Noise

__all__ = ["LAYER", "Waves", "beside_own", "read_layers"]

LAYER = 1.5
"""Thickness of a layer over the grain of its texture, so that it changes as fast along the axis as around it. Thicker
ones show as streaks in the other cuts: features of radial cuts up to 0.4 worse for each doubling from 2.5 on."""

PASSING = 0.15
"""Share of a layer in which it passes into the next. Elsewhere texture is one picture's own, with its lines: passing
all along blurs them by chance (features of radial cuts of four pairs 0.03 to 0.15 worse)."""

WAVE, WAVE_LENGTH = 0.25, 3.0
"""Standard deviation and length of the waves of the layers, in thicknesses. Flat ones show in cuts across them as rows
of bricks; 0.4 and 2.0 break up the lines of a texture in cuts along them (slope across over along it 1.4, here 2.6)."""

SHORTEST = 0.02
"""Radii. Waves are no shorter: their lattice has 130 cells along a side then."""


class Waves:
    """How far layers lie from planes."""

    def __init__(self, thickness: float, rng: np.random.Generator) -> None:
        """Of layers this thick, in radii."""
        self._noise = Noise((max(WAVE_LENGTH * thickness, SHORTEST),) * 3, 1, rng)

    def at(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """(M,). In thicknesses at points (M, 3) in radii."""
        return WAVE * self._noise.at(points)[:, 0]


def read_layers(
    height: NDArray[np.floating], read: Callable[[NDArray[np.int64], NDArray[np.intp]], NDArray[np.float32]]
) -> NDArray[np.float32]:
    """(M, 3). The texture at points that lie so high (M,), in layers.

    `read` gives (R, 3) the texture that layers (R,) have at some rows (R,) of the points. Layers pass into one another
    such that the variance stays (Heitz and Neyret 2018), as a mean would be a blur.
    """
    whole = np.floor(height)
    part = np.clip((height - whole - (1 - PASSING)) / PASSING, 0, 1) * np.pi / 2
    layer = whole.astype(np.int64)
    out = np.zeros((len(layer), 3), np.float32)
    for step, share in ((0, np.cos(part)), (1, np.sin(part))):
        rows = np.flatnonzero(share > 0)
        out[rows] += share[rows, None] * read(layer[rows] + step, rows)
    return out


def beside_own(
    texture: NDArray[np.float32], own: NDArray[np.float32], distance: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(M, 3). Texture (M, 3) of layers, and a picture's `own` (M, 3) in the plane in which it was taken.

    `distance` (M,): from that plane, in thicknesses of a layer.
    """
    share = np.exp(-np.square(distance))[:, None].astype(np.float32)
    return share * own + np.sqrt(1 - share * share) * texture
