"""What lies behind a cut face: one or two plain surfaces, lit or in shadow, or a pattern of a few colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["Background", "find_background", "find_main_surface", "find_pattern", "is_patterned"]

MIN_CORNERS = 2
"""Least number of the picture's corners that each surface covers: a table and the wall behind it have two each. A face
cropped by the border covers none, or the one it lies in."""

BAND = 0.03
"""Width of the border from which the background is learnt, as a fraction of the picture's shorter side."""

MIN_SHARE = 0.1
"""Least fraction of the border that a second surface covers: with less it cannot own two corners and their side."""

NOISE = 0.012, 0.04
"""Least and greatest spread of a surface's colours that is believed. JPEG leaves three 8-bit steps on white; beyond a
spread of a tenth of the range (wood, cloth), three spreads would reach into any face."""

BIN = 0.06
"""Width of the bins in which the most frequent colour is searched: about as wide as the noise of a plain wall."""

TOLERANCE = 3.0
"""Spreads by which a background pixel may differ in colour: 99.7 % of a normal distribution."""

LIT = 2 * TOLERANCE
"""TOLERANCE for light and colour together: light is less even than colour."""

COLOURS = 8
"""Number of colours searched in a pattern: a chequered cloth has three, and what the lens mixes of them."""

ALL_AROUND, STRIP = 0.01, 0.12
"""Least fraction of a strip along every side of the picture that shows a colour for it to be the pattern's, and the
width of the strips as a fraction of the shorter side. A pattern goes on behind the face, whereas other things cross one
or two sides of the border. A narrower strip may run along a single row of squares."""

PLAIN = 0.75
"""Least fraction of the border that surfaces explain where there is no pattern: 0.82 and more of 29 photographs and of
wood, marble, linen, plates and slate, but 0.64 of speckled granite and a half of a chequered cloth."""

DEEPEST = 0.2
"""Least fraction of its light that a shadow leaves a surface. Contact shadows under real fruit leave 0.25 and more;
anything darker has no colour left to tell it by."""

DARK = 0.2
"""Brightest channel of a surface so dark that a shadow on it is black."""


@dataclass(frozen=True)
class Background:
    """The surfaces behind a face, as far as the border of the picture tells."""

    lit: NDArray[np.bool_]
    """(H, W). Pixels that have a surface's colour in full light."""
    shaded: NDArray[np.bool_]
    """(H, W). The lit pixels and those that have a surface's colour dimmed by a shadow."""
    corners: NDArray[np.bool_]
    """(4,). Corners of the picture that show a surface; clockwise from the top left."""


def find_background(rgb: NDArray[np.float32]) -> Background | None:
    """The background of a picture (H, W, 3), range [0, 1]; None if the border shows none.

    A shadow takes light away and leaves the colour: its pixels are a surface's times one number.
    """
    height, width = rgb.shape[:2]
    band, border = _border(height, width)
    smooth = ndimage.gaussian_filter(rgb, (1, 1, 0))
    lit, shaded, corners = np.zeros((height, width), bool), np.zeros((height, width), bool), np.zeros(4, bool)
    for _ in range(2):
        rest = border & ~shaded
        if rest.sum() < MIN_SHARE * border.sum():
            break
        surface, spread = _fit_surface(rgb, rest)
        own = _is_dimmed(smooth, surface, spread)
        own_corners = _corners(own & ~shaded, band)  # a curved surface may end in the first one's colour
        if own_corners.sum() < MIN_CORNERS:
            break
        lit |= np.linalg.norm(smooth - surface, axis=-1) < LIT * spread
        shaded |= own
        corners |= own_corners
    return Background(lit, shaded, corners) if corners.any() else None


def is_patterned(plain: Background | None) -> bool:
    """Whether the surfaces found leave too much of the picture's border unexplained to be the whole background."""
    return plain is None or float(plain.shaded[_border(*plain.shaded.shape)[1]].mean()) < PLAIN


def find_pattern(rgb: NDArray[np.float32]) -> Background | None:
    """The background of a picture (H, W, 3), range [0, 1], as the colours, in any light, that all four sides of its
    border show: a chequered cloth, tiles, a printed board. None if something else covers a corner.

    This is weaker evidence than surfaces, as a face may well have one of those colours: the caller checks the result.
    """
    height, width = rgb.shape[:2]
    band, border = _border(height, width)
    sides = np.zeros((4, height, width), bool)
    strip = max(band, round(STRIP * min(height, width)))
    sides[0, :strip], sides[1, -strip:], sides[2, :, :strip], sides[3, :, -strip:] = True, True, True, True
    smooth = ndimage.gaussian_filter(rgb, (1, 1, 0))
    lit, shaded, rest = np.zeros((height, width), bool), np.zeros((height, width), bool), border.copy()
    for _ in range(COLOURS):
        if not rest.any():
            break
        members = _most_frequent(smooth[rest])
        surface = np.broadcast_to(members.mean(0), rgb.shape).astype(np.float64)
        spread = float(np.clip(np.sqrt(np.square(members - surface[0, 0]).sum(-1).mean()), *NOISE))
        own = _is_dimmed(smooth, surface, spread)
        alike = np.linalg.norm(smooth - surface, axis=-1) < TOLERANCE * spread
        rest &= ~own & ~alike
        if min(float(own[side].mean()) for side in sides) >= ALL_AROUND:
            lit |= alike
            shaded |= own
    corners = _corners(shaded, band)
    return Background(lit, shaded, corners) if corners.all() else None


def find_main_surface(rgb: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(H, W). The pixels, in any light, of the surface that covers most of the border of a picture (H, W, 3). It need
    not be a background."""
    surface, spread = _fit_surface(rgb, _border(*rgb.shape[:2])[1])
    return _is_dimmed(ndimage.gaussian_filter(rgb, (1, 1, 0)), surface, spread)


def _border(height: int, width: int) -> tuple[int, NDArray[np.bool_]]:
    """Width in pixels of the border from which the background is learnt, and its pixels (H, W)."""
    band = max(2, round(BAND * min(height, width)))
    border = np.ones((height, width), bool)
    border[band:-band, band:-band] = False
    return band, border


def _is_dimmed(smooth: NDArray[np.float32], surface: NDArray[np.float64], spread: float) -> NDArray[np.bool_]:
    """(H, W). Pixels of a picture (H, W, 3) that have a surface's colour (H, W, 3) or a part of its light."""
    # The light that is left, by least squares; the small number avoids division by zero on black.
    light = np.einsum("hwc,hwc->hw", smooth, surface) / (np.einsum("hwc,hwc->hw", surface, surface) + 1e-3)
    shade = np.clip(light, 0, 1)
    differs = np.linalg.norm(smooth - shade[..., None] * surface, axis=-1)
    return (differs < TOLERANCE * spread) & ((shade > DEEPEST) | (surface.max(-1) < DARK))


def _corners(own: NDArray[np.bool_], band: int) -> NDArray[np.bool_]:
    """(4,). Corners of the picture, squares of side `band`, that mostly belong to `own` (H, W)."""
    first, last = slice(None, band), slice(-band, None)
    places = ((first, first), (first, last), (last, last), (last, first))
    return np.array([own[place].mean() > 0.5 for place in places])


def _fit_surface(rgb: NDArray[np.float32], where: NDArray[np.bool_]) -> tuple[NDArray[np.float64], float]:
    """The smooth colour surface (H, W, 3) that fits most of `where` (H, W), and the spread of colours around it.

    Starts from the most frequent colour, then alternates a least-squares fit with the selection of inliers.
    """
    height, width = rgb.shape[:2]
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], -1)
    colours, terms_there = rgb[where], basis[where]
    fitted = _most_frequent(colours).mean(0, dtype=np.float64)[None]
    spread = NOISE[1]
    for terms in (1, 3, 6):
        gap = np.linalg.norm(colours - terms_there[:, : len(fitted)] @ fitted, axis=-1)
        near = gap < max(4 * spread, 0.06)
        if near.sum() < 20:  # too few to fit six terms to
            break
        # Ridge regression: unregularised, the curved terms diverge over the middle, where there are no border pixels.
        a, b = terms_there[near][:, :terms], colours[near]
        ridge = 1e-2 * len(a) * np.diag([0.0, *[1.0] * (terms - 1)])
        fitted = np.linalg.solve(a.T @ a + ridge, a.T @ b)
        spread = float(np.clip(np.sqrt(np.square(b - a @ fitted).sum(-1).mean()), *NOISE))
    return np.clip(basis[..., : len(fitted)] @ fitted, 0, 1), spread


def _most_frequent(colours: NDArray[np.float32]) -> NDArray[np.float32]:
    """(M, 3). Those of colours (N, 3) that lie in the fullest bin or one beside it."""
    bins = np.round(colours / BIN).astype(np.int64)
    low = bins.min(0)
    sizes = bins.max(0) - low + 1
    fullest = np.bincount(np.ravel_multi_index(tuple((bins - low).T), tuple(sizes))).argmax()
    return colours[(np.abs(bins - low - np.unravel_index(fullest, tuple(sizes))) <= 1).all(1)]
