"""The fine texture of cut faces, apart from the things they show.

Texture is what is narrower than a seed and no stronger than its surroundings; no two cuts show the same. Carried along
an axis it would show as rods and, where places drift, as wavy lines. So only the things are quilted, and each thin
layer of the ball has texture from elsewhere in the pictures. Layers lie across the axis where a horizontal picture is
shown, around it where a radial one is, so that either cut shows texture as it was photographed (`strata`).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.chunks import Ball
from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    REACH,
    Disc,
    Medians,
    disc_grid,
    enlarged,
    smooth_disc,
)
from training.priors.exemplar.sampling import blurred
from training.priors.exemplar.strata import LAYER, Waves, read_layers

__all__ = ["Parts", "TextureField", "take_apart"]

WIDTH = 0.02
"""Radius, in radii, of the medians over which texture stands out: narrower than seeds and arils. At 0.04 the features
of a pomegranate are 10 % farther from other photographs, and those of oranges, apples and melons 2 to 5 %."""

AROUND = 0.11
"""Radius in radii of the neighbourhood whose typical contrast texture has: some seeds wide."""

STRONG = (2.5, 4.0)
"""Multiples of the typical contrast between which a contrast changes from texture to the edge of a thing."""

SHIFT = 0.1
"""Standard deviation in radii of the shift of a radial layer's places. Without it texture shows as rings."""

THINNEST = 0.01
"""Thickness of a layer in radii that the finest volumes still resolve."""

FLESH = (0.1, 0.85)
"""Shares of the radius between which the grain is measured: neither core nor rind."""


@dataclass(frozen=True)
class Parts:
    """A face is its things plus the strength of its texture times the texture."""

    things: Disc
    texture: Disc
    """Mean 0 and mean square about 1 wherever there is any."""
    strength: Disc
    """The same in all three channels."""


def take_apart(disc: Disc) -> Parts:
    """The things and the texture of a face."""
    residual = disc.rgb - enlarged(Medians(disc.rgb).over(WIDTH))
    contrast = np.linalg.norm(residual, axis=-1)[..., None]
    typical = enlarged(Medians(contrast).over(AROUND))
    # An edge counts as one over all its width and a little beyond.
    scale = DISC_PIXELS / (2 * REACH)
    wide = ndimage.maximum_filter(contrast[..., 0], int(0.6 * WIDTH * scale) | 1)
    edge = blurred(wide, 0.3 * WIDTH * scale)[..., None] / (typical + 0.002)
    t = np.clip((edge - STRONG[0]) / (STRONG[1] - STRONG[0]), 0, 1)
    weight = np.broadcast_to(1 - t * t * (3 - 2 * t), disc.rgb.shape)
    texture = residual * weight
    power = smooth_disc(Disc(np.repeat(np.square(texture).sum(-1, keepdims=True), 3, -1)), AROUND / 2).rgb
    strength = np.sqrt(power / (smooth_disc(Disc(weight.astype(np.float32)), AROUND / 2).rgb + 0.05)) + 0.001
    return Parts(*(Disc(a.astype(np.float32)) for a in (disc.rgb - texture, texture / strength, strength)))


class TextureField:
    """Texture at every point of the ball, of mean square 1."""

    def __init__(self, textures: Sequence[Disc], is_horizontal: bool, rng: np.random.Generator) -> None:
        """`textures`: of the pictures of one family."""
        self.textures, self.is_horizontal = textures, is_horizontal
        self.thickness = max(LAYER * float(np.mean([_grain(t) for t in textures])), THINNEST)
        layers = int(2 * REACH / self.thickness) + 4 if is_horizontal else int(np.pi / self.thickness)
        self._turns = rng.uniform(0, 2 * np.pi, layers)
        self._shifts = SHIFT * rng.standard_normal((layers, 2))
        self._mirrors = rng.choice([-1.0, 1.0], layers)
        self._pictures = rng.integers(0, len(textures), layers)
        self._waves = Waves(self.thickness, rng)

    def reduced(self, n: int) -> TextureField:
        """The same texture without the detail that pixels n times as large do not show."""
        coarse = copy(self)
        coarse.textures = [texture.reduced(n) for texture in self.textures]
        return coarse

    def at(self, ball: Ball) -> NDArray[np.float32]:
        """(M, 3). The texture at the points."""
        count = len(self._turns)
        if self.is_horizontal:
            height = (ball.points[:, 2] + REACH) / self.thickness
        else:
            height = (ball.angle / (2 * np.pi) + 1) * count
        return read_layers(
            height + self._waves.at(ball.points), lambda layer, rows: self._layer(ball, layer % count, rows)
        )

    def _layer(self, ball: Ball, layer: NDArray[np.int64], rows: NDArray[np.intp]) -> NDArray[np.float32]:
        """(R, 3). The texture of layers (R,) at some rows (R,) of the points."""
        mirror = self._mirrors[layer]
        if self.is_horizontal:
            c, s = np.cos(self._turns)[layer], np.sin(self._turns)[layer]
            u, v = ball.level[rows].T
            x, y = c * u - s * mirror * v, s * u + c * mirror * v
        else:
            free = (1 - ball.rind[rows])[:, None] * self._shifts[layer]
            x, y = mirror * ball.radius[rows] + free[:, 0], ball.points[rows, 2] + free[:, 1]
        picture = self._pictures[layer]
        out = np.empty((len(x), 3), np.float32)
        for n, texture in enumerate(self.textures):
            of_it = picture == n
            out[of_it] = texture.read(x[of_it], y[of_it])
        return out


def _grain(texture: Disc) -> float:
    """Length in radii along which texture changes around the axis: its standard deviation over that of its slope."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    grey = texture.rgb.mean(-1)
    slope_x, slope_y = np.gradient(grey, 2 * REACH / DISC_PIXELS)
    flesh = (radius > FLESH[0]) & (radius < FLESH[1])
    around = (x * slope_y - y * slope_x)[flesh] / radius[flesh]
    return float(grey[flesh].std() / max(around.std(), 1e-6))
