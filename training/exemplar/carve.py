"""At which heights a structure of the horizontal picture may stand: only where the radial pictures know of it.

At its own height the horizontal picture is right. Where radial pictures show the same colour there, at that radius,
they can see such things, and carve them away at the heights where they do not show them: an apple's carpels end. Where
they do not, or meet them by mere chance, they are blind to them and silent: an orange's membranes run through. That
is the answer here to who may speak (DESIGN section 5.1, step 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.cluster.vq import kmeans2

from training.exemplar.decompose import Layers

__all__ = ["Carving", "carving"]

COLOURS = 8
"""Kinds of colour among structures: flesh-side, core, seed, wall, and their mixtures."""

ALIKE = 0.14
"""Colour distance up to which two places show the same thing."""

RADII, HEIGHTS = 48, 96
"""Cells of the (radius, height) map."""

OWN_HEIGHT = 0.15
"""Greatest distance of a horizontal picture's height from the middle; people cut fruit in half."""

KNOWN = 0.5
"""Share of the radial pictures' halves that must show a colour at the own height to be heard on it: less is chance."""


DOUBT = 0.2
"""Chance that every half misses a thing which is there, under which they are believed that it is not."""


@dataclass(frozen=True)
class Carving:
    """Opacity left to structures by colour, radius and height."""

    palette: NDArray[np.float32]
    """(K, 3)."""
    left: NDArray[np.float32]
    """(K, RADII, HEIGHTS). Range [0, 1]."""

    def at(
        self, colours: NDArray[np.float32], radius: NDArray[np.floating], height: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(M,). For colours (M, 3) at radii over the body's greatest (M,) and heights in [-1, 1] (M,)."""
        gaps = ((colours[:, None] - self.palette) ** 2).sum(-1)
        i = np.clip(radius * RADII, 0, RADII - 1).astype(int)
        j = np.clip((height + 1) / 2 * HEIGHTS, 0, HEIGHTS - 1).astype(int)
        return self.left[gaps.argmin(1), i, j]


def carving(carrier: Layers, radial: Sequence[Layers], rng: np.random.Generator) -> Carving | None:
    """What radial pictures leave of the structures of a horizontal one; None where it has no structures."""
    sheet = carrier.sheet
    pixels = sheet.rgb[(carrier.structure > 0.5) & (sheet.depth > 1.2 * carrier.rind)]
    if len(pixels) < 50:
        return None
    few = pixels[rng.integers(len(pixels), size=4000)].astype(np.float64)
    palette, _ = kmeans2(few, COLOURS, minit="++", seed=rng)
    t, h = np.meshgrid((np.arange(RADII) + 0.5) / RADII, (np.arange(HEIGHTS) + 0.5) / HEIGHTS * 2 - 1, indexing="ij")
    halves = []
    for parts in radial:
        middle, half = parts.sheet.middle, parts.sheet.half
        for side in (1, -1):
            seen = parts.sheet.read(middle[0] + side * t * half[0], middle[1] - h * half[1])
            shown = np.linalg.norm(seen - palette[:, None, None], axis=-1) < ALIKE
            # Things need not stand where the picture happens to have them to the pixel.
            halves.append(ndimage.binary_dilation(shown, np.ones((1, 5, 9))))
    seen = np.stack(halves)  # [halves, colours, radii, heights]
    known = seen[..., np.abs(h[0]) < OWN_HEIGHT].any(-1).mean(0) >= KNOWN
    # What covers few directions is met by chance: that it is not met elsewhere says nothing.
    known &= (1 - _coverage(carrier, palette)) ** len(halves) < DOUBT
    near = ndimage.gaussian_filter(seen.any(0).astype(np.float32), (0, 0.7, 1))
    # What is nearly flesh is the edge of something; it goes with the thing and not by itself.
    flesh = np.median(sheet.rgb[(carrier.structure < 0.1) & (carrier.detail < 0.1) & (sheet.depth > 0)], axis=0)
    known &= (np.linalg.norm(palette - flesh, axis=1) > 1.5 * ALIKE)[:, None]
    left = np.where(known[..., None], near, 1.0)
    return Carving(palette.astype(np.float32), left.astype(np.float32))


def _coverage(carrier: Layers, palette: NDArray[np.floating]) -> NDArray[np.floating]:
    """(K, RADII). Share of the directions in which a horizontal picture shows each colour near each radius."""
    sheet = carrier.sheet
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    radius = (np.arange(RADII) + 0.5) / RADII * sheet.rim(angle)
    seen = sheet.read(sheet.middle[0] + radius * np.cos(angle), sheet.middle[1] - radius * np.sin(angle))
    shown = np.linalg.norm(seen - palette[:, None, None], axis=-1) < ALIKE
    return ndimage.binary_dilation(shown, np.ones((1, 1, 5))).mean(axis=1)
