"""What is seen along an outline: how strong the edge is that it follows, and the third colour of a skin. By these one
of two outlines is chosen."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.solid.distance_transform import depth_in
from training.faces.shadow import SECTORS, sectors_of

__all__ = [
    "BARE",
    "EDGE_GAIN",
    "HALF",
    "MIXED",
    "SKINNED",
    "THIRD_COLOUR",
    "cheapest_path",
    "colours_apart",
    "edge_cost",
    "edge_strength",
    "from_mixtures",
    "largest_component",
    "nearest",
    "rims_apart",
    "skin_share",
]

EDGE_GAIN = 2.0
"""How many times cheaper the other outline has to be before the found one moves. The cost is the inverse edge strength
of an outline's pixels, summed, or in the mean where one is much longer. If both follow an edge they differ by less."""

MIXED = 3
"""Pixels on either side of an outline in which the lens mixes face and background."""

BARE, HALF, SKINNED = 0.25, 0.5, 0.75
"""Fractions of an outline that have a third colour: below the first it may be a carrier's, below the second the user is
told, and from the last it is a skin. The side of a board or the rim of a dish shows on one side of it, a skin all
around: on 0.81 and more in 26 photographs, but for one whose mask leaves the skin out."""

CALM = 150
"""Width of a thing over the standard deviation of the Gaussian that calms its colours, up to one of two pixels: skins
are so thin in small pictures that more would mix them with what is beside them."""

THIRD_COLOUR = 0.05
"""RGB distance from all mixtures of two colours that makes a third. For plates and boards the distance is 0.01, by
noise of 3 8-bit steps and JPEG's; for the skins of 29 photographs it is 0.13 and more."""

SKIN, FLESH = 0.05, (0.06, 0.12)
"""How deep a skin is looked for, and the depths from which the flesh under it is learnt, as fractions of the face's
diameter. Most rinds are thicker: then the lens and the outermost peel are the third colour."""

BEHIND = 4.0, 0.06
"""Distances between which what is behind a face is learnt: in pixels, and as a fraction of the face's diameter."""


def edge_strength(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W). How fast the colours of a picture (H, W, 3) change, per pixel."""
    steps = [ndimage.gaussian_gradient_magnitude(rgb[..., c], 1.5) for c in range(3)]
    return np.asarray(np.sqrt(np.square(steps).sum(0)))


def edge_cost(strength: NDArray[np.float32]) -> NDArray[np.float64]:
    """(H, W). What a pixel of an outline costs: the less, the stronger its edge (Caselles et al. 1997)."""
    return np.asarray(1 / (strength + 0.005), np.float64)  # one 8-bit step a pixel is no edge


def rims_apart(
    part: NDArray[np.bool_], ours: NDArray[np.bool_], theirs: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(H, W), (H, W). The pixels of each of two faces' outlines along a part (H, W) that only one of the faces has,
    without those near both outlines."""
    rims = [inside & ~ndimage.binary_erosion(inside, border_value=1) for inside in (ours, theirs)]
    apart = ndimage.binary_dilation(part) & ~ndimage.binary_dilation(rims[0] & rims[1], iterations=MIXED)
    return rims[0] & apart, rims[1] & apart


def skin_share(rgb: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """The fraction of the outline of a thing (H, W) in a picture (H, W, 3) that has a third colour between the thing
    and what is behind it. Range [0, 1]."""
    depth, away = depth_in(mask), depth_in(~mask)
    across = np.sqrt(4 / np.pi * mask.sum())
    flesh = (depth > FLESH[0] * across) & (depth < FLESH[1] * across)
    behind = (away > BEHIND[0]) & (away < max(2 * BEHIND[0], BEHIND[1] * across))
    if not flesh.any() or not behind.any():
        return 0.0
    sigma = min(2.0, across / CALM)
    smooth = ndimage.gaussian_filter(rgb, (sigma, sigma, 0))
    band = (depth <= SKIN * across) & (away <= 1.5)
    at = np.nonzero(band)
    ends = [smooth[tuple(place[at] for place in nearest(where))] for where in (flesh, behind)]
    third = from_mixtures(ndimage.gaussian_filter(rgb, (sigma / 2, sigma / 2, 0))[at], *ends)
    layer = np.round(depth[at]).astype(int)
    sector = sectors_of(mask, at)
    shape = SECTORS, int(layer.max()) + 1
    total, count = np.zeros(shape), np.zeros(shape)
    np.add.at(total, (sector, layer), third)
    np.add.at(count, (sector, layer), 1)
    # A skin lies at one depth; one or two pixels are too few for a mean.
    most = np.where(count > 2, total / np.maximum(count, 1), 0).max(1)
    return float((most > THIRD_COLOUR).mean())


def from_mixtures(
    colours: NDArray[np.float32], first: NDArray[np.float32], second: NDArray[np.float32]
) -> NDArray[np.float64]:
    """(N,). RGB distance of colours (N, 3) from the nearest sum of any amounts of two others (N, 3), which is what a
    lens mixes from two surfaces in any light."""
    a, b, p = (c.astype(np.float64) for c in (first, second, colours))
    aa, bb, ab, pa, pb = ((u * v).sum(-1) for u, v in ((a, a), (b, b), (a, b), (p, a), (p, b)))
    size = aa * bb - ab * ab
    plane = size > 1e-4 * aa * bb + 1e-9  # two colours of one hue span no plane
    of_a, of_b = (pa * bb - pb * ab) / np.where(plane, size, 1), (pb * aa - pa * ab) / np.where(plane, size, 1)
    alone = [
        np.linalg.norm(p - (np.maximum(pc, 0) / np.maximum(cc, 1e-9))[:, None] * c, axis=-1)
        for c, cc, pc in ((a, aa, pa), (b, bb, pb))
    ]
    both = np.linalg.norm(p - of_a[:, None] * a - of_b[:, None] * b, axis=-1)
    return np.where(plane & (of_a >= 0) & (of_b >= 0), both, np.minimum(*alone))


def colours_apart(
    some: NDArray[np.float32], others: NDArray[np.float32], lights: tuple[float, float]
) -> NDArray[np.float32]:
    """(M, P). RGB distance of colours (M, 3) from each of others (P, 3), whose light may be multiplied by a factor in
    this range."""
    product, square = some @ others.T, np.square(others).sum(1)
    light = np.clip(product / np.maximum(square, 1e-6), *lights)
    squared = np.square(some).sum(1)[:, None] + light * (light * square - 2 * product)
    return np.asarray(np.sqrt(np.maximum(squared, 0)))


def nearest(known: NDArray[np.bool_]) -> NDArray[np.int32]:
    """(2, H, W). Row and column of the nearest place that is `known` (H, W)."""
    return ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)


def largest_component(found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The largest connected component with its holes filled: a hole is a dark or white part of the face."""
    parts, count = ndimage.label(found)
    if count == 0:
        return np.zeros_like(found)
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return ndimage.binary_fill_holes(parts == sizes.argmax())


@njit(cache=True, nogil=True)
def cheapest_path(costs: NDArray[np.float64]) -> NDArray[np.int64]:
    """(N,). The row in each column of the cheapest way across costs (R, N), at most one row up or down per column."""
    rows, columns = costs.shape
    total = costs[:, 0].copy()
    before = np.empty((columns, rows), np.int64)
    for column in range(1, columns):
        so_far = total.copy()
        for row in range(rows):
            best = row
            for other in (row - 1, row + 1):
                if 0 <= other < rows and so_far[other] < so_far[best]:
                    best = other
            before[column, row] = best
            total[row] = so_far[best] + costs[row, column]
    path = np.empty(columns, np.int64)
    path[-1] = total.argmin()
    for column in range(columns - 1, 0, -1):
        path[column - 1] = before[column, path[column]]
    return path
