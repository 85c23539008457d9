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

from training.priors.exemplar.decompose import Layers
from training.priors.exemplar.patches import OVER

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

REACH = 0.12
"""Radii, over the body's greatest, between which a thing's height is taken to be the same."""

CLOSED = 0.8
"""Height under which a structure has ended; what goes on to the poles runs through, and its ends are the rind's."""

SOFT = 0.15
"""Width of the edge of what is left, of the way from a structure's edge to its middle."""

DOUBT = 0.2
"""Chance that every half misses a thing which is there, under which they are believed that it is not."""


@dataclass(frozen=True)
class Carving:
    """Opacity left to structures by colour, radius and height."""

    palette: NDArray[np.float32]
    """(K, 3)."""
    left: NDArray[np.float32]
    """(K, RADII, HEIGHTS). Opacity left to structures of a colour that run from pole to pole, range [0, 1]."""
    shown: NDArray[np.float32]
    """(K, RADII, HEIGHTS). Where a colour stands in a structure that ends, range [0, 1]."""
    ends: NDArray[np.float32]
    """(RADII, 2). Least and greatest height of the structures as a whole; 0 and 0 where nothing is known."""
    main: NDArray[np.intp]
    """(RADII,). The colour of which they mostly are."""
    held: NDArray[np.bool_]
    """(K, RADII). Colours of what lies in a structure, as seeds in a carpel: they stand out from it as it does."""
    spans: NDArray[np.float32]
    """(RADII, 2). Least and greatest height of those; 0 and 0 where there are none."""
    middle: NDArray[np.float32]
    """(H, W, 2). How far a pixel of the horizontal picture is from the edge (0) to the middle (1) of its structure, and
    of what is held there."""
    carried: NDArray[np.bool_]
    """(RADII, HEIGHTS). Where what the radial pictures show is a section of a carried structure."""

    def at(
        self,
        colours: NDArray[np.float32],
        middle: NDArray[np.float32],  # [M, 2]
        radius: NDArray[np.floating],
        height: NDArray[np.floating],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(M,), (M, 3). The opacity left to structures, and their colours.

        For colours (M, 3) as far in the middle (M, 2), at radii over the body's greatest (M,) and heights in [-1, 1]
        (M,). A structure closes towards its ends like an ellipsoid. So does a seed in it, and gives way to what it is
        in.
        """
        i, j = _cells(radius, height)
        kind = ((colours[:, None] - self.palette) ** 2).sum(-1).argmin(1)
        left = self.left[kind, i, j] * _closing(self.ends[i], height, middle[:, 0])
        own = np.where(self.ends[i, 1] > self.ends[i, 0], self.shown[kind, i, j], 1)
        own = np.where(self.held[kind, i], _closing(self.spans[i], height, middle[:, 1]), own)[:, None]
        mixed = own * colours + (1 - own) * self.palette[self.main[i]]
        return left.astype(np.float32), mixed.astype(np.float32)

    def explains(self, radius: NDArray[np.floating], height: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(M,). Whether what the radial pictures show there is a structure that is carried already."""
        return self.carried[_cells(radius, height)]


def _closing(
    ends: NDArray[np.float32], height: NDArray[np.floating], middle: NDArray[np.floating]
) -> NDArray[np.floating]:
    """(M,). What heights (M,) leave of ellipsoids between ends (M, 2), at places so far in their middle (M,).

    At the ends only the middle is left, half way all of it: with u the share of the way, 1 - sqrt(1 - u^2). All is left
    of what has no ends.
    """
    low, high = ends.T
    known = high > low
    share = np.where(known, np.abs(2 * height - low - high) / np.where(known, high - low, 1), 0)
    edge = 1 - np.sqrt(np.maximum(1 - share * share, 0))
    return np.asarray(np.clip((middle - edge) / SOFT + 1, 0, 1) * (share < 1))


def _cells(radius: NDArray[np.floating], height: NDArray[np.floating]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    i = np.clip(radius * RADII, 0, RADII - 1).astype(int)
    j = np.clip((height + 1) / 2 * HEIGHTS, 0, HEIGHTS - 1).astype(int)
    return i, j


def carving(carrier: Layers, radial: Sequence[Layers], rng: np.random.Generator) -> Carving | None:
    """What radial pictures leave of the structures of a horizontal one; None where it has none."""
    sheet = carrier.sheet
    pixels = sheet.rgb[(carrier.structure > 0.5) & (sheet.depth > 1.2 * carrier.rind)]
    if len(pixels) < 50:
        return None
    few = pixels[rng.integers(len(pixels), size=4000)].astype(np.float64)
    palette = kmeans2(few, COLOURS, minit="++", seed=rng)[0].astype(np.float32)
    t, h = np.meshgrid((np.arange(RADII) + 0.5) / RADII, (np.arange(HEIGHTS) + 0.5) / HEIGHTS * 2 - 1, indexing="ij")
    halves, tight = [], []
    for parts in radial:
        middle, half = parts.sheet.middle, parts.sheet.half
        for side in (1, -1):
            seen = parts.sheet.read(middle[0] + side * t * half[0], middle[1] - h * half[1])
            shown = np.linalg.norm(seen - palette[:, None, None], axis=-1) < ALIKE
            # Things need not stand where the picture happens to have them to the pixel.
            halves.append(ndimage.binary_dilation(shown, np.ones((1, 5, 9))))
            tight.append(ndimage.binary_dilation(shown, np.ones((1, 3, 3))))
    seen = np.stack(halves)  # [halves, colours, radii, heights]
    known = seen[..., np.abs(h[0]) < OWN_HEIGHT].any(-1).mean(0) >= KNOWN
    # What covers few directions is met by chance: that it is not met elsewhere says nothing.
    known &= (1 - _coverage(carrier, palette)) ** len(halves) < DOUBT
    # What is nearly flesh is the edge of something; it goes with the thing and not by itself.
    flesh = np.median(sheet.rgb[(carrier.structure < 0.1) & (carrier.detail < 0.1) & (sheet.depth > 0)], axis=0)
    flesh_like = np.linalg.norm(palette - flesh, axis=1) <= 1.5 * ALIKE
    known &= ~flesh_like[:, None]
    near, exact = (ndimage.gaussian_filter(np.any(a, axis=0).astype(np.float32), (0, 0.7, 1)) for a in (seen, tight))
    sure = np.where(known[..., None], exact, 0).max(0) > 0.5
    # A thing that is heard on at some of its radii goes on to the others, as far as it is tall at those.
    tall = np.array([_run(row, h[0]) for row in sure])
    level = (h >= tall[:, 0].min()) & (h <= tall[:, 1].max())
    things, _ = ndimage.label(level & (exact[known.any(1)].max(0, initial=0) > 0.5))
    whole = sure | np.isin(things, np.unique(things[sure & (things > 0)]))
    ends = np.array([_run(row, h[0]) for row in whole], np.float32)
    heard = _at_own_height(ends)
    left = np.ones_like(near)
    if (np.abs(ends[heard]) >= CLOSED).any():
        # What goes to the poles does not close; it is only left out where it is not seen.
        left = np.where(known[..., None], near, 1)
        heard[:] = False
    # A thing that reaches a little farther out or in than the radial pictures meet it ends as it does there; so do
    # those of its colours that are too rare to be heard on.
    own, within = np.arange(RADII), heard
    if heard.any():
        distance, nearest = ndimage.distance_transform_edt(~heard, return_indices=True)
        own, within = nearest[0], distance <= REACH * RADII
    blind = flesh_like | ~seen.any((0, 2, 3))
    shown = np.where(blind[:, None, None], 1, exact)[:, own]
    # Over some radii, for at some of them seeds are more than what they lie in.
    most = ndimage.uniform_filter1d(np.where(known, _coverage(carrier, palette), 0), round(2 * REACH * RADII), axis=1)
    nearest = ndimage.distance_transform_edt(~known.any(0), return_distances=False, return_indices=True)[0]
    main = most.argmax(0)[nearest[own]]
    apart = np.linalg.norm(palette[:, None] - palette[main], axis=-1) > np.linalg.norm(palette[main] - flesh, axis=-1)
    held = apart & ~blind[:, None] & within
    spans = np.array([_run(row, h[0]) for row in ((shown > 0.5) & held[..., None]).any(0)], np.float32)
    held &= _at_own_height(spans)
    structure = carrier.structure > 0.5
    kinds = ((sheet.rgb[structure][:, None] - palette) ** 2).sum(-1).argmin(1)
    seeds = structure.copy()
    seeds[structure] = held.any(1)[kinds]
    inner = sheet.depth > 1.2 * carrier.rind
    return Carving(
        palette,
        left,
        shown,
        np.where(within[:, None], ends[own], 0),
        main,
        held,
        spans,
        np.stack([_middle(structure, inner), _middle(seeds, inner)], -1),
        ndimage.binary_closing(whole[own] & within[:, None], np.ones((5, 9))),
    )


def _middle(things: NDArray[np.bool_], inner: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(H, W). How far each pixel is from the edge (0) of things to the middle (1), of the widest within that width."""
    inside = ndimage.distance_transform_edt(things)
    widest = ndimage.maximum_filter(inside, size=2 * int(inside[inner].max(initial=0)) + 1)
    return (inside / np.maximum(widest, 1)).astype(np.float32)


def _at_own_height(ends: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(R,). Which runs of heights (R, 2) the horizontal picture meets; others are of other things."""
    return (ends[:, 1] > ends[:, 0]) & (ends[:, 0] < OWN_HEIGHT) & (ends[:, 1] > -OWN_HEIGHT)


def _run(row: NDArray[np.bool_], heights: NDArray[np.floating]) -> tuple[float, float]:
    """Least and greatest height of the run nearest to the middle; 0 and 0 where there is none."""
    runs, count = ndimage.label(row)
    if count == 0:
        return 0.0, 0.0
    levels = heights[runs == runs[row][np.abs(heights[row]).argmin()]]
    return float(levels.min()), float(levels.max())


def _coverage(carrier: Layers, palette: NDArray[np.floating]) -> NDArray[np.floating]:
    """(K, RADII). Share of the directions in which a horizontal picture shows structures of each colour at a radius."""
    sheet = carrier.sheet
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)[:, None]
    radius = (np.arange(RADII) + 0.5) / RADII * sheet.rim(angle)
    x, y = sheet.middle[0] + radius * np.cos(angle), sheet.middle[1] - radius * np.sin(angle)
    runs = ndimage.map_coordinates(carrier.structure, np.stack([y, x]) * OVER, order=1) > 0.5
    shown = runs & (np.linalg.norm(sheet.read(x, y) - palette[:, None, None], axis=-1) < ALIKE)
    return ndimage.binary_dilation(shown, np.ones((1, 1, 5))).mean(axis=1)
