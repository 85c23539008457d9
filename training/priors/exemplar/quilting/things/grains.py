"""Grains of a face: things so close that there is nothing calm between them, such as the arils of a pomegranate.

A thing on calm ground closes over it with the distance from the picture's plane (`relief`). Where things lie among
things there is nothing to close over, and what is carried beside the plane ends wherever a seam passes, in rods and
shards. Such faces have chambers, known by the colours of their grains, in which these touch one another: every pixel of
a chamber belongs to one. `tessellation` lays them anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.cluster.vq import kmeans2
from skimage.measure import euler_number, regionprops
from skimage.segmentation import relabel_sequential, watershed

from training.priors.exemplar.quilting.disc import DISC_PIXELS, REACH, Disc
from training.priors.exemplar.quilting.things.forms import depth_of
from training.priors.exemplar.quilting.things.stamps import Things
from training.priors.exemplar.sampling import blurred, reduced

__all__ = ["Grains"]

FINE = 2
"""Pixels of the disc per pixel on which grains are looked for: the smallest is eight of these wide."""

RADII = np.geomspace(0.015, 0.11, 9)
"""Radii of the grains that are looked for, a quarter apart, in radii of the disc. Seeds, arils and pores have these."""

AROUND = 0.12
"""Standard deviation in radii of the neighbourhood from which a grain has to stand out: some grains wide."""

STRENGTH = 0.35
"""Least response of the normalised Laplacian at a grain, over the spread around it. Among grains a disc with a sharp
rim has 1.5 and one that fades into the next about 0.5. A sharp straight edge has as much, so discs drawn with hard rims
may be found finer than they are; photographs have none."""

CONTRAST, VISIBLE = 0.35, 0.04
"""The same over the spread in the whole face, so that grains are found in a darker or paler photograph as well, and in
RGB, as mottles and noise are no grains. Without the second a faint pattern would be grains, however faint."""

EXTENT = 1.1
"""Radius of a grain over that at which it is found, so that its rim is part of it."""

APART = 0.6
"""Distance of two grains over the larger one's radius below which they are one thing found twice."""

ENDS = 1.5
"""Least height over radius of a grain with nothing calm around it; what closes earlier is left to the relief."""

CLOSE, PACKED = 0.6, 0.68
"""Least part of a neighbourhood that grains cover where they lie close, and least part of a face where they do so for
it to be made of grains. Of 24 photographs five pomegranates have 0.81 to 0.88, and 0.70 to 0.82 with half of their
light or contrast; two oranges with fibrous cores have 0.51 and 0.52, the others at most 0.4. Bread, taken for a round
fruit, has 0.48 to 0.65."""

ROUND, MOSTLY = 0.05, 0.5
"""Least curvature of a grain's contrast along it over that across it, as a line has none along itself; and least part
of what grains cover that these alone do. In five pomegranates it is 0.82 or more, in drawn wood, whose annual rings
would be rows of grains, 0.06, in a drawn geode 0.43."""

TOUCHING, NEARBY = 1.2, 0.08
"""Factor by which grains are enlarged to count what they cover, as the gaps between touching discs are no ground; and
standard deviation in radii of the neighbourhood of which they cover a part."""

FACE = 0.9
"""Radius of the disc in which grains are looked for: outside is the rind."""

PURE = 0.65
"""Least part of a grain that differs from its surroundings as grains of this face do: arils are darker than membranes.
What lies between grains has less; arils with pale seeds have 0.7."""

STRANGE = 2.5
"""Multiple of the median distance from the grains' median colour beyond which one is something else: a bit of the
core."""

SIZES = (0.6, 1.5)
"""Least and largest size, over the typical one, of grains whose colours are the face's: a smaller one is a highlight in
a grain, a larger one several grains."""

BINS = 16
"""Bins of each channel in which the colours of grains and of what is not near any are counted, blurred by one bin."""

FAR, APART_FROM = 0.15, 0.06
"""Most of the neighbourhood, with this standard deviation in radii, that grains may cover for a place to be ground."""

INSIDE = 0.97
"""Radius in which chambers lie: outside, a photograph shows its background."""

BLURRED = 0.4
"""Standard deviation, over the radius of a grain, of the blur of how much each pixel looks like grains: a chamber goes
on across the gaps between them."""

FEWEST, HOLE, LINKED = 6.0, 1.5, 0.5
"""Least size of chambers, and largest size of a hole in one, in grains: a dark crown is no chamber, and a pale seed in
an aril no membrane. Grains this far apart, in their radii, lie together for the first of these."""

SMOOTH = 0.35
"""Standard deviation, over the radius of a grain, of the blur under which grains are told apart: highlights are
gone."""

USUAL = 0.6
"""Least mean of how much a cell's pixels look like grains for it to be laid elsewhere: of 501 cells in five photographs
479 do."""

DEEP = 0.7
"""Least depth of a cell's middle over that of its deepest pixel: a bent cell's centroid may lie outside of it."""


@dataclass(frozen=True)
class Grains:
    """The grains of one picture, none if it is not made of them."""

    cells: NDArray[np.int32]
    """(P, P). Number of the grain at each pixel of the disc, from 1; 0 for none. What lies between two of them is the
    rim of both."""
    places: NDArray[np.float32]
    """(B, 2). Places of their middles on the disc."""
    radii: NDArray[np.float32]
    """(B,). Radii of discs as large, in radii of the disc."""
    turns: NDArray[np.float32]
    """(B,). Angle from the disc's x axis to the longer axis, radians."""
    are_usual: NDArray[np.bool_]
    """(B,). Whether they look like most."""

    @classmethod
    def of(cls, things: Disc, heights: NDArray[np.float32]) -> Grains:
        """The grains of the things of a face (`texture.Parts`) that end at these heights (H, W, L), see `Relief`."""
        rgb = reduced(things.rgb, FINE)
        size = len(rgb)
        pixels = size / (2 * REACH)
        axis = ((np.arange(size) + 0.5) / size * 2 - 1) * REACH
        face = np.hypot(axis[:, None], axis) < FACE
        grey = _main_contrast(rgb, face, AROUND * pixels)
        best: NDArray[np.bool_] = np.zeros_like(face)
        for places, radii in _blobs(rgb, grey, reduced(heights, FINE), axis, face):
            likeness = _likeness(rgb, axis, places, radii)
            chambers = _chambers(likeness, axis, _typical(radii))
            if chambers.sum() > best.sum():  # the other is what lies between grains
                best, alike, typical = chambers, likeness, _typical(radii)
        if not best.any():
            return cls.none()
        cells = _cells(grey, best, typical * pixels)
        regions = regionprops(cells)
        if not regions:
            return cls.none()
        places = np.array([(_middle(region) + 0.5) / pixels - REACH for region in regions], np.float32)
        radii = np.sqrt([region.area / np.pi for region in regions]) / pixels
        turns = np.array([region.orientation for region in regions], np.float32)
        are_usual = ndimage.mean(alike, cells, np.arange(len(regions)) + 1) > USUAL
        fine = cells.repeat(FINE, 0).repeat(FINE, 1)
        return cls(fine.astype(np.int32), places, radii.astype(np.float32), turns, are_usual)

    @classmethod
    def none(cls) -> Grains:
        """The grains of a face without any."""
        nothing = np.zeros((DISC_PIXELS, DISC_PIXELS), np.int32)
        empty = np.empty(0, np.float32)
        return cls(nothing, np.empty((0, 2), np.float32), empty, empty, np.empty(0, np.bool_))

    @cached_property
    def depth(self) -> NDArray[np.float32]:
        """(P, P). How deep each pixel is in a chamber, in radii; negative outside of them."""
        return depth_of(self.regions).astype(np.float32)

    @cached_property
    def regions(self) -> NDArray[np.bool_]:
        """(P, P). The chambers in which they lie."""
        return self.cells > 0

    def things(self, disc: Disc) -> Things:
        """The grains as the disc, which is this face in some light, shows them."""
        return Things.of_cells(disc, self.places, self.radii, self.turns, self.cells)

    def usual_things(self, disc: Disc) -> Things:
        """Those of them that look like most."""
        return self.things(disc).chosen(self.are_usual)


def _blobs(
    rgb: NDArray[np.floating],
    grey: NDArray[np.floating],
    heights: NDArray[np.floating],
    axis: NDArray[np.floating],
    face: NDArray[np.bool_],
) -> list[tuple[NDArray[np.floating], NDArray[np.floating]]]:
    """Places (B, 2) and radii (B,) of what may be grains of a face (H, W, 3), by their contrast `grey` (H, W): of the
    darker and of the brighter things in it; nothing if it is not made of grains. They follow a germ-grain model
    (Stoyan, Kendall and Mecke 1995): overlapping discs."""
    pixels = len(axis) / (2 * REACH)
    spread = np.sqrt(blurred(grey * grey, AROUND * pixels)) + 0.01
    sigmas = RADII * pixels / np.sqrt(2)  # at which the Laplacian of a disc is strongest
    laplacian = np.stack([ndimage.gaussian_laplace(grey, s) * s * s for s in sigmas])
    strength = np.abs(laplacian) / spread
    peaks = (strength == ndimage.maximum_filter(strength, size=3)) & (strength > STRENGTH)
    peaks &= np.abs(laplacian) > max(CONTRAST * grey[face].std(), VISIBLE)
    order = np.argsort(-strength[peaks], kind="stable")
    level, i, j = (a[order] for a in np.nonzero(peaks))
    radii = RADII[level] * EXTENT
    lasting = heights.min(-1)[i, j] > ENDS * radii
    level, i, j, radii = (a[lasting] for a in (level, i, j, radii))
    places = np.stack([axis[i], axis[j]], -1)
    apart = _thinned(places, radii)
    level, i, j, radii, places = (a[apart] for a in (level, i, j, radii, places))
    close = _close(axis, places, radii)
    packed = (close > CLOSE)[face].mean()
    if packed < PACKED:
        return []
    are_round = _roundness(grey, sigmas, level, i, j) > ROUND
    if (_close(axis, places[are_round], radii[are_round]) > CLOSE)[face].mean() < MOSTLY * packed:
        return []
    share = radii / _typical(radii)
    sized = (share > SIZES[0]) & (share < SIZES[1]) & face[i, j] & (close[i, j] > CLOSE)
    # The Laplacian is positive where the middle is darker.
    darker = laplacian[level, i, j] > 0
    found = []
    for are_darker in (True, False):
        inside = [_within(axis, place, radius) for place, radius in zip(places, radii, strict=True)]
        pure = np.array([((grey[box][at] < 0) == are_darker).mean() for box, at in inside])
        colours = np.array([rgb[box][at].mean(0) for box, at in inside])
        ours = sized & (darker == are_darker) & (pure > PURE)
        if ours.any():
            strange = np.linalg.norm(colours - np.median(colours[ours], axis=0), axis=1)
            found.append(ours & (strange <= STRANGE * np.median(strange[ours])))
    return [(places[ours], radii[ours]) for ours in found]


def _close(
    axis: NDArray[np.floating], places: NDArray[np.floating], radii: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(H, W). How much of the neighbourhood grains at places (B, 2) with radii (B,) cover. Range [0, 1]."""
    return blurred(_covered(axis, places, TOUCHING * radii), NEARBY * len(axis) / (2 * REACH))


def _roundness(
    grey: NDArray[np.floating],
    sigmas: NDArray[np.floating],
    level: NDArray[np.intp],
    i: NDArray[np.intp],
    j: NDArray[np.intp],
) -> NDArray[np.float64]:
    """(B,). The smaller principal curvature of a contrast (H, W) over the larger at pixels (B,), (B,), blurred by the
    sigma (pixels) of each one's level (B,): 1 at a disc, 0 on a line, negative on a saddle. Lowe (2004) tells edges
    from features by it."""
    found = np.empty(len(level))
    for n in np.unique(level):
        at = i[level == n], j[level == n]
        xx, yy, xy = (ndimage.gaussian_filter(grey, sigmas[n], order)[at] for order in ((2, 0), (0, 2), (1, 1)))
        mean, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
        found[level == n] = (np.abs(mean) - apart) / np.maximum(np.abs(mean) + apart, 1e-12)
    return found


def _likeness(
    rgb: NDArray[np.floating], axis: NDArray[np.floating], places: NDArray[np.floating], radii: NDArray[np.floating]
) -> NDArray[np.float32]:
    """(H, W). How much more likely each colour is among these grains than where none is near. Range [0, 1]."""
    pixels = len(axis) / (2 * REACH)
    grain = _covered(axis, places, radii) > 0
    near = blurred(_covered(axis, places, TOUCHING * radii), APART_FROM * pixels)
    ground = (near < FAR) & (np.hypot(axis[:, None], axis) < INSIDE)
    at = (np.moveaxis(rgb, -1, 0) * BINS - 0.5).reshape(3, -1)
    likely = []
    for where in (grain, ground):
        counts, _ = np.histogramdd(np.clip(rgb[where], 0, 1), bins=BINS, range=[(0, 1)] * 3)
        smooth = ndimage.gaussian_filter(counts / max(counts.sum(), 1), 1.0)
        likely.append(ndimage.map_coordinates(smooth, at, order=1, mode="nearest").reshape(grain.shape))
    return np.asarray(likely[0] / (likely[0] + likely[1] + 1e-6), np.float32)


def _chambers(alike: NDArray[np.float32], axis: NDArray[np.floating], typical: float) -> NDArray[np.bool_]:
    """(H, W). Where a face looks `alike` (H, W) to its grains, of this typical radius."""
    pixels = len(axis) / (2 * REACH)
    held = (blurred(alike, BLURRED * typical * pixels) > 0.5) & (np.hypot(axis[:, None], axis) < INSIDE)
    area = np.pi * (typical * pixels) ** 2
    near = ndimage.distance_transform_edt(~held) < LINKED * typical * pixels
    parts, _ = ndimage.label(near)
    held &= (np.bincount(parts[held], minlength=parts.max() + 1) >= FEWEST * area)[parts]
    holes, _ = ndimage.label(~held)
    return held | (np.bincount(holes.ravel()) <= HOLE * area)[holes]


def _cells(grey: NDArray[np.floating], chambers: NDArray[np.bool_], radius: float) -> NDArray[np.int32]:
    """(H, W). Chambers cut into grains with a typical radius in pixels, along the valleys of the contrast (H, W): the
    number of each, from 1. Cells as large as several are cut into as many."""
    bright = grey > np.median(grey[chambers]) if chambers.any() else chambers
    islands = [euler_number(chambers & phase, connectivity=2) for phase in (bright, ~bright)]
    # Grains are islands in a network of gaps, whichever of them are brighter.
    peaked = ndimage.gaussian_filter(grey if islands[0] > islands[1] else -grey, SMOOTH * radius)
    peaks = (peaked == ndimage.maximum_filter(peaked, size=int(radius) | 1)) & chambers
    cells = watershed(-peaked, ndimage.label(peaks)[0], mask=chambers)
    if not cells.any():
        return cells
    sizes = np.bincount(cells.ravel())[1:]
    parts = np.round(sizes / np.median(sizes)).astype(int)
    for n in np.flatnonzero(parts > 1):
        at = np.argwhere(cells == n + 1)
        _, which = kmeans2(at.astype(float), parts[n], minit="++", seed=0)
        cells[tuple(at[which > 0].T)] = cells.max() + which[which > 0]
    return np.asarray(relabel_sequential(cells)[0], np.int32)


def _middle(cell) -> NDArray[np.float64]:  # type: ignore[no-untyped-def]
    """(2,). The pixel nearest to the centroid of a cell among those deep in it."""
    deep = ndimage.distance_transform_edt(np.pad(cell.image, 1))[1:-1, 1:-1]
    at = np.argwhere(deep >= DEEP * deep.max()) + cell.bbox[:2]
    return np.asarray(at[np.square(at - cell.centroid).sum(1).argmin()], np.float64)


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
    """(H, W). 1 on the discs."""
    covered = np.zeros((len(axis), len(axis)), np.float32)
    for place, radius in zip(places, radii, strict=True):
        box, at = _within(axis, place, radius)
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
