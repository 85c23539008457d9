"""Grains of a face: things so close that there is nothing calm between them, such as the arils of a pomegranate.

A thing on calm ground closes over it with the distance from the picture's plane (`relief`). Where things lie among
things there is nothing to close over, and what is carried beside the plane ends wherever a seam passes, in rods and
shards. Such faces follow a germ-grain model (Stoyan, Kendall and Mecke 1995): overlapping discs, which are cuts of
balls that `packing` lays anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.quilting.disc import REACH, Disc, to_pixels
from training.priors.exemplar.quilting.things.stamps import Things
from training.priors.exemplar.sampling import blurred, reduced

__all__ = ["Grains"]

FINE = 2
"""Pixels of the disc per pixel on which grains are looked for: the smallest is eight of these wide."""

RADII = np.geomspace(0.015, 0.11, 9)
"""Radii of the grains that are looked for, a quarter apart, in radii of the disc. Seeds, arils and pores have these."""

AROUND = 0.12
"""Standard deviation in radii of the neighbourhood from which a grain has to stand out: some grains wide."""

STRENGTH, CONTRAST = 0.35, 0.08
"""Least response of the normalised Laplacian at a grain, over the spread around it and in RGB. Among grains a disc with
a sharp rim has 1.5 and one that fades into the next about 0.5. A sharp straight edge has as much, so discs drawn
with hard rims may be found finer than they are; photographs have none."""

EXTENT = 1.1
"""Radius of a grain over that at which it is found, so that its rim is part of it."""

APART = 0.6
"""Distance of two grains over the larger one's radius below which they are one thing found twice."""

ENDS = 1.5
"""Least height over radius of a grain with nothing calm around it; what closes earlier is left to the relief."""

CLOSE, PACKED = 0.6, 0.68
"""Least part of a neighbourhood that grains cover where they lie close, and least part of a face where they do so for
it to be made of grains. Of 22 photographs five pomegranates have 0.82 to 0.90, two oranges with fibrous cores 0.52 and
0.53, the other oranges, apples and melons at most 0.4."""

TOUCHING = 1.2
"""Factor by which grains are enlarged to count what they cover: the gaps between touching discs are no ground."""

FACE = 0.9
"""Radius of the disc in which grains are looked for: outside is the rind."""

PURE = 0.65
"""Least part of a grain that differs from its surroundings as grains of this face do: arils are darker than membranes.
What lies between grains has less; arils with pale seeds have 0.7."""

STRANGE = 2.5
"""Multiple of the median distance from the grains' median colour beyond which one is something else: a bit of the
core."""

SIZES = (0.6, 1.5)
"""Least and largest size, over the typical one, of grains that are kept: a smaller one is a highlight in a grain, a
larger one several grains."""


@dataclass(frozen=True)
class Grains:
    """The grains of one picture, none if it is not made of them."""

    places: NDArray[np.float32]
    """(B, 2). Places of their middles on the disc."""
    radii: NDArray[np.float32]
    """(B,). Their radii, in radii of the disc."""
    cover: NDArray[np.float32]
    """(H, W). Part of the surroundings that they cover, over the disc's array. Range [0, 1]."""

    @classmethod
    def of(cls, things: Disc, heights: NDArray[np.float32]) -> Grains:
        """The grains of the things of a face (`texture.Parts`) that end at these heights (H, W, L), see `Relief`."""
        rgb = reduced(things.rgb, FINE)
        size = len(rgb)
        pixels = size / (2 * REACH)
        axis = ((np.arange(size) + 0.5) / size * 2 - 1) * REACH
        face = np.hypot(axis[:, None], axis) < FACE
        grey = _main_contrast(rgb, face, AROUND * pixels)
        spread = np.sqrt(blurred(grey * grey, AROUND * pixels)) + 0.01
        sigmas = RADII * pixels / np.sqrt(2)  # at which the Laplacian of a disc is strongest
        laplacian = np.stack([ndimage.gaussian_laplace(grey, s) * s * s for s in sigmas])
        strength = np.abs(laplacian) / spread
        peaks = (strength == ndimage.maximum_filter(strength, size=3)) & (strength > STRENGTH)
        peaks &= np.abs(laplacian) > CONTRAST
        order = np.argsort(-strength[peaks], kind="stable")
        level, i, j = (a[order] for a in np.nonzero(peaks))
        radii = RADII[level] * EXTENT
        lasting = reduced(heights, FINE).min(-1)[i, j] > ENDS * radii
        level, i, j, radii = (a[lasting] for a in (level, i, j, radii))
        places = np.stack([axis[i], axis[j]], -1)
        apart = _thinned(places, radii)
        level, i, j, radii, places = (a[apart] for a in (level, i, j, radii, places))
        close = blurred(_covered(axis, places, radii), 0.08 * pixels)
        none = cls(np.empty((0, 2), np.float32), np.empty(0, np.float32), np.zeros_like(close))
        if (close > CLOSE)[face].mean() < PACKED:
            return none
        share = radii / _typical(radii)
        sized = (share > SIZES[0]) & (share < SIZES[1]) & face[i, j] & (close[i, j] > CLOSE)
        # The Laplacian is positive where the middle is darker. Gaps are found as well, but are fainter or smaller.
        darker = laplacian[level, i, j] > 0
        weight = strength[level, i, j] * radii**2 * sized
        major = 1 if weight[darker].sum() > weight[~darker].sum() else -1
        inside = [_within(axis, place, radius) for place, radius in zip(places, radii, strict=True)]
        pure = np.array([(grey[box][at] * -major > 0).mean() for box, at in inside])
        colours = np.array([rgb[box][at].mean(0) for box, at in inside])
        ours = sized & (darker == (major > 0)) & (pure > PURE)
        if not ours.any():
            return none
        strange = np.linalg.norm(colours - np.median(colours[ours], axis=0), axis=1)
        ours &= strange <= STRANGE * np.median(strange[ours])
        cover = blurred(_covered(axis, places[ours], radii[ours]), 0.03 * pixels)
        return cls(places[ours].astype(np.float32), radii[ours].astype(np.float32), cover)

    def things(self, disc: Disc) -> Things:
        """The grains as the disc, which is this face in some light, shows them."""
        return Things.of(disc, self.places, np.repeat(self.radii[:, None], 2, 1), np.zeros(len(self.radii)))

    def cover_at(self, x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
        """(M,). The part that grains cover around places (M,), (M,) of the disc."""
        at = np.stack(to_pixels(x, y, len(self.cover)))
        return ndimage.map_coordinates(self.cover, at, order=1, mode="nearest", output=np.float32)


def _main_contrast(rgb: NDArray[np.floating], face: NDArray[np.bool_], around: float) -> NDArray[np.floating]:
    """(H, W). Difference of colours (H, W, 3) from those around them, along the RGB direction of most difference."""
    local = rgb - blurred(rgb, around)
    main = np.linalg.eigh(local[face].T @ local[face])[1][:, -1]
    return local @ (main if main.sum() > 0 else -main)


def _thinned(places: NDArray[np.floating], radii: NDArray[np.floating]) -> NDArray[np.intp]:
    """Rows of the discs without those found twice, of which the first stays."""
    kept: list[int] = []
    for n, (place, radius) in enumerate(zip(places, radii, strict=True)):
        away = np.linalg.norm(places[kept] - place, axis=1)
        if not (away < APART * np.maximum(radii[kept], radius)).any():
            kept.append(n)
    return np.array(kept, np.intp)


def _covered(
    axis: NDArray[np.floating], places: NDArray[np.floating], radii: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(H, W). 1 on the discs and close around them."""
    covered = np.zeros((len(axis), len(axis)), np.float32)
    for place, radius in zip(places, radii, strict=True):
        box, at = _within(axis, place, TOUCHING * radius)
        covered[box][at] = 1
    return covered


def _within(
    axis: NDArray[np.floating], place: NDArray[np.floating], radius: float
) -> tuple[tuple[slice, slice], NDArray[np.bool_]]:
    """The box around a disc at a place (2,), and which of its pixels are in the disc."""
    x, y = place
    rows, columns = (slice(*np.searchsorted(axis, (at - radius, at + radius))) for at in (x, y))
    return (rows, columns), np.hypot(axis[rows, None] - x, axis[columns] - y) < radius


def _typical(radii: NDArray[np.floating]) -> float:
    """The radius up to which grains cover half of what all cover."""
    ordered = np.sort(radii)
    area = np.cumsum(ordered**2)
    return float(ordered[np.searchsorted(area, area[-1] / 2)])
