"""The texture of cut faces, apart from the things they show.

Texture is what is narrow and no stronger than flesh usually is, such as juice sacs; no two cuts show the same. Carried
along an axis it would show as rods and, where places drift, as wavy lines. So only the things are quilted, and each
thin layer of the ball has texture from elsewhere in the pictures. Layers lie across the axis where a horizontal picture
is shown, around it where a radial one is, so that either cut shows texture as it was photographed (`strata`).
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
    disc_radius,
    enlarged,
    halo,
    smooth_disc,
)
from training.priors.exemplar.sampling import blurred, lengths, smoothstep
from training.priors.exemplar.strata import LAYER, Rows, Waves, read_layers

__all__ = ["FINE", "WIDTH", "Parts", "TextureField", "take_apart"]

FINE = 0.02
"""Radius, in radii, of the medians over which texture stands out while things are looked for: narrower than seeds and
arils."""

WIDTH = 0.07
"""The same once things are known. What is narrow and no texture closes beside its plane, and nothing takes its place:
with FINE here, horizontal cuts of two oranges and a melon had 0.18 to 0.54 of the power of their pictures at
wavelengths of 0.03 to 0.11 radii, now 0.23 to 0.63. Features of six pairs differ by less than 0.1 at 0.05 and 0.1."""

AROUND = 0.11
"""Radius in radii of the neighbourhood whose typical contrast texture has: some seeds wide."""

STRONG = (1.5, 3.5)
"""Multiples of the usual strongest contrast nearby between which a contrast changes from texture to that of a thing.
Features of two oranges and an apple differ by at most 0.21 between (1.5, 2.5) and (2, 3.5); with the latter, cores of
oranges are speckled."""

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


def take_apart(disc: Disc, width: float, things: NDArray[np.bool_] | None = None) -> Parts:
    """The things and the texture of a face: what stands out of medians over discs of a radius `width`, in radii.

    `things` (P, P): where there is surely no texture.
    """
    residual = disc.rgb - enlarged(Medians(disc.rgb).over(width))
    contrast = lengths(residual)
    scale = DISC_PIXELS / (2 * REACH)
    # A thing counts as one over all its width and a little beyond.
    strongest = blurred(ndimage.maximum_filter(contrast, int(0.6 * width * scale) | 1), 0.3 * width * scale)
    radius = disc_radius()
    everywhere = np.median(strongest[(radius > FLESH[0]) & (radius < FLESH[1])])
    usual = np.minimum(enlarged(Medians(strongest[..., None]).over(AROUND))[..., 0], everywhere)
    weight = (1 - smoothstep(strongest / (usual + 0.002), *STRONG)).astype(np.float32)
    if things is not None:
        weight *= 1 - halo(things)
    texture = residual * weight[..., None]
    power = np.square(texture).sum(-1)
    strength = np.sqrt(_around(power) / (_around(weight) + np.float32(0.05))) + np.float32(0.001)
    return Parts(Disc(disc.rgb - texture), Disc(texture / strength), Disc(strength))


def _around(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """(P, P, 3). Values (P, P) blurred over the neighbourhood of texture, the same in all three channels."""
    return smooth_disc(Disc(np.repeat(values[..., None], 3, -1).astype(np.float32)), AROUND / 2).rgb


class TextureField:
    """Texture at every point of the ball, of mean square 1."""

    def __init__(self, textures: Sequence[Disc], is_horizontal: bool, rng: np.random.Generator) -> None:
        """`textures`: of the pictures of one family."""
        self.textures, self.is_horizontal = [_everywhere(texture) for texture in textures], is_horizontal
        self.thickness = max(LAYER * float(np.mean([_grain(t) for t in textures])), THINNEST)
        layers = int(2 * REACH / self.thickness) + 4 if is_horizontal else int(np.pi / self.thickness)
        turns = rng.uniform(0, 2 * np.pi, layers)
        self._turns = np.stack([np.cos(turns), np.sin(turns)], -1).astype(np.float32)
        self._shifts = (SHIFT * rng.standard_normal((layers, 2))).astype(np.float32)
        self._mirrors = rng.choice([-1.0, 1.0], layers).astype(np.float32)
        self._pictures = rng.integers(0, len(textures), layers)
        self._waves = Waves(self.thickness, rng)

    def reduced(self, n: int) -> TextureField:
        """The same texture without the detail that pixels n times as large do not show."""
        coarse = copy(self)
        coarse.textures = [texture.reduced(n) for texture in self.textures]
        return coarse

    def at(self, ball: Ball) -> NDArray[np.float32]:
        """(M, 3). The texture at the points."""
        count = len(self._mirrors)
        if self.is_horizontal:
            height = (ball.points[:, 2] + REACH) / self.thickness
        else:
            height = (ball.angle / (2 * np.pi) + 1) * count
        return read_layers(
            height + self._waves.at(ball.points), lambda layer, rows: self._layer(ball, layer % count, rows)
        )

    def _layer(self, ball: Ball, layer: NDArray[np.int64], rows: Rows) -> NDArray[np.float32]:
        """(R, 3). The texture of layers (R,) at some rows of the points."""
        mirror = self._mirrors[layer]
        if self.is_horizontal:
            c, s = self._turns[layer].T
            u, v = ball.level[rows].T
            v = mirror * v
            x, y = c * u - s * v, s * u + c * v
        else:
            free = (1 - ball.rind[rows])[:, None] * self._shifts[layer]
            x, y = mirror * ball.radius[rows] + free[:, 0], ball.points[rows, 2] + free[:, 1]
        if len(self.textures) == 1:
            return self.textures[0].read(x, y)
        picture = self._pictures[layer]
        out = np.empty((len(x), 3), np.float32)
        for n, texture in enumerate(self.textures):
            of_it = picture == n
            out[of_it] = texture.read(x[of_it], y[of_it])
        return out


def _everywhere(texture: Disc) -> Disc:
    """The texture, mirrored at their edges into the places of things: layers are shifted, and would have none there."""
    missing = ~texture.rgb.any(-1) & (disc_radius() < 1)
    if not missing.any() or missing[disc_radius() < 1].all():
        return texture
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    at = np.argwhere(missing).T
    across = np.clip(2 * nearest[:, *at] - at, 0, len(missing) - 1)
    rgb = texture.rgb.copy()
    rgb[*at] = texture.rgb[*across]
    return Disc(rgb)


def _grain(texture: Disc) -> float:
    """Length in radii along which texture changes around the axis: its standard deviation over that of its slope."""
    x, y = disc_grid()
    radius = np.hypot(x, y)
    grey = texture.rgb.mean(-1)
    slope_x, slope_y = np.gradient(grey, 2 * REACH / DISC_PIXELS)
    flesh = (radius > FLESH[0]) & (radius < FLESH[1])
    around = (x * slope_y - y * slope_x)[flesh] / radius[flesh]
    return float(grey[flesh].std() / max(around.std(), 1e-6))
