"""What of a cut face continues beside its plane: the law of shape.

A closed thing is about as tall as it is long, and a membrane that joins core and rind runs through. Neither depends on
what a colour stands for: the median over a disc of radius t is what remains of a picture at distance t, as it rounds
off and then removes things narrower than that.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from engine.scene.grid import read_cells
from engine.threads import for_spans
from training.priors.exemplar.medians import Ranks
from training.priors.exemplar.quilting.disc import (
    DISC_PIXELS,
    REACH,
    REDUCTION,
    Disc,
    Medians,
    disc_grid,
    disc_radius,
    read_map,
    to_pixels,
)
from training.priors.exemplar.sampling import blurred, lengths, read_as_scipy, read_bilinear, reduced

__all__ = ["Persistence", "even_along", "find_membranes"]

DISTANCES = (0.02, 0.04, 0.07, 0.11, 0.16, 0.22)
"""Distances in radii at which the medians are taken; seeds, pores and carpels have half widths in this range."""

WIDTHS = (0.07, 0.16, 21), (0.175, 0.4, 51)
"""Of thin membranes, and of walls such as a tomato's: distance in radii at which they are gone; one to compare that
with; and samples around the middle over whose median they stand out, some 20 and 50 degrees. The median over a disc
removes a line as wide as 0.8 of its radius. Anything wider is flesh or a hollow, which ends as closed things do."""

SURE = (0.5, 1.5), (1.0, 1.5)
"""Contrasts at these two widths, over the standard deviation in the flesh, from which a line may be a membrane and
certainly is one. Between walls the flesh may be darker here and there, so a wall has to be surer than a thin membrane.
"""

BORDER = 0.01
"""Radii over which a membrane's surety is smoothed across its edges."""

MEMBRANE_LENGTH = 0.42
"""Length in radii along which a membrane is followed: longer than seeds and carpels, and shorter than the flesh."""

BENDS = np.radians(np.linspace(-8, 8, 9))
"""Angles by which a membrane may lean over that length."""

MEMBRANE_QUANTILE = 0.25
"""Quantile of the contrast along that length that counts. A mean would take seeds and carpels, strong but short, for
membranes."""

ANGLES, RADII = 360, 128
"""Samples around and along the radius when membranes are looked for."""

MEMBRANE_RADII = (0.12, 0.93)
"""Radii between which membranes lie: inside is the core, outside the rind."""

ALONG, FINE, ACROSS = 0.1, 1440, 1.5
"""Standard deviation in radii of the mean along a membrane that leaves its usual colour; samples around the middle, as
a membrane has few pixels across; and standard deviation in degrees of the blur under which it is looked for which way
it leans: by its middle, from which its edges do not lean away."""

ROWS = 8
"""Radii that a thread takes at a time."""


class Persistence:
    """How far the colours of a disc are from what remains of them at a distance from its plane."""

    def __init__(self, disc: Disc) -> None:
        small = reduced(disc.rgb, REDUCTION)
        medians = Medians(disc.rgb)
        gone = [lengths(small - medians.over(distance)) for distance in DISTANCES]
        self._gone = np.stack([np.zeros_like(gone[0]), *gone]).astype(np.float32)

    def gone(
        self, x: NDArray[np.floating], y: NDArray[np.floating], distance: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """(M,). RGB distance between the colours at places (M,), (M,) and what remains at distances (M,), in radii."""
        step = np.interp(distance, (0, *DISTANCES), np.arange(len(DISTANCES) + 1))
        return read_cells(self._gone, np.stack([step, *to_pixels(x, y, self._gone.shape[1])], -1))


def find_membranes(disc: Disc, *, walls: bool) -> NDArray[np.float32]:
    """(DISC_PIXELS, DISC_PIXELS). How surely a horizontal face shows a membrane from core to rind. Range [0, 1].

    `walls`: also one as thick as a tomato's walls; grains in a row look like one.
    """
    medians, small = Medians(disc.rgb), reduced(disc.rgb, REDUCTION)
    angle = np.arange(ANGLES) / ANGLES * 2 * np.pi
    radius = (np.arange(RADII) + 0.5) / RADII
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    polar = Disc(blurred(disc.rgb, 1.2)).read(x, y)
    px, py = disc_grid()
    turn = np.arctan2(py, px) % (2 * np.pi) / (2 * np.pi) * ANGLES
    at = np.stack([disc_radius() * RADII - 0.5, turn])
    membranes = np.zeros(px.shape, np.float32)
    for (gone, compared, samples), (least, most) in list(zip(WIDTHS, SURE, strict=True))[: None if walls else 1]:
        surely = np.clip((_contrasts_along(polar, samples) - least) / (most - least), 0, 1)
        surely[(radius < MEMBRANE_RADII[0]) | (radius > MEMBRANE_RADII[1])] = 0
        closed = np.concatenate([surely, surely[:, :1]], axis=1)
        found = ndimage.map_coordinates(closed, at, order=1, cval=0, output=np.float32)
        both = np.stack([lengths(small - medians.over(distance)) for distance in (gone, compared)], -1)
        thin, wide = np.moveaxis(read_as_scipy(both, *to_pixels(px, py, len(both))), -1, 0)
        share = np.clip(2 * thin / (wide + 0.02) - 0.5, 0, 1)
        membranes = np.maximum(membranes, found * blurred(share, BORDER * DISC_PIXELS / (2 * REACH)))
    return membranes


def even_along(face: Disc, membranes: NDArray[np.float32]) -> Disc | None:
    """A horizontal face, even along its membranes (P, P); None without any. Meaningful only where there are any."""
    if not membranes.any():
        return None
    turn, radius = np.arange(FINE) / FINE * 2 * np.pi, (np.arange(RADII) + 0.5) / RADII
    x, y = radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn)
    surely = read_map(membranes, x, y)[..., None]
    weighted = np.concatenate([surely * face.read(x, y), surely], -1)
    found, most = np.zeros_like(weighted), np.zeros(surely.shape[:2], np.float32)
    mean = cv2.getGaussianKernel(2 * round(3 * ALONG * RADII) + 1, ALONG * RADII, cv2.CV_32F)
    for bend in BENDS / MEMBRANE_LENGTH:
        shifts = np.round(bend * radius * FINE / (2 * np.pi)).astype(int)
        straight = _turned(weighted, -shifts)
        means = cv2.sepFilter2D(straight, -1, np.ones(1, np.float32), mean, borderType=cv2.BORDER_CONSTANT)
        leant = _turned(np.asarray(means, np.float32), shifts)
        near = blurred(leant[..., 3], ACROSS * FINE / 360)
        better = near > most
        found[better], most[better] = leant[better], near[better]
    even = found[..., :3] / np.maximum(found[..., 3:], 1e-6)
    px, py = disc_grid()
    around = np.arctan2(py, px) % (2 * np.pi) / (2 * np.pi) * FINE
    closed = np.concatenate([even, even[:, :1]], axis=1)
    return Disc(read_bilinear(closed, (disc_radius() * RADII - 0.5).ravel(), around.ravel()).reshape(face.rgb.shape))


def _turned(polar: NDArray[np.float32], shifts: NDArray[np.int_]) -> NDArray[np.float32]:
    """(R, A, C). Values by radius and angle (R, A, C), turned by so many samples (R,)."""
    return np.stack([np.roll(row, shift, axis=0) for row, shift in zip(polar, shifts, strict=True)])


def _contrasts_along(polar: NDArray[np.float32], samples: int) -> NDArray[np.floating]:
    """(R, A). How far colours (R, A, 3) by radius and angle stand out, along a line through each place, from the median
    over so many angles; over the standard deviation in the flesh."""
    half = samples // 2
    around = np.pad(polar, ((0, 0), (half, half), (0, 0)), mode="wrap")
    contrast = polar - Ranks.of(around).medians(np.array([half]))[:, half:-half]
    length = int(MEMBRANE_LENGTH * RADII)
    along = np.arange(-(length // 2), length // 2 + 1, 2)
    turns = np.round(BENDS[:, None] * along / length * ANGLES / (2 * np.pi)).astype(int)
    means = np.empty((len(BENDS), RADII, ANGLES, 3), np.float32)
    steady, found = np.empty((len(BENDS), RADII, ANGLES), np.float32), np.empty((RADII, ANGLES), np.float32)
    for_spans(_follow_lines, RADII, contrast, along, turns, MEMBRANE_QUANTILE, means, steady, span=ROWS)
    for_spans(_steadiest, RADII, contrast, along, turns, means, steady, found, span=ROWS)
    return found / (lengths(contrast[int(0.2 * RADII) : int(0.8 * RADII)]).std() + 0.01)


@njit(cache=True, nogil=True)
def _follow_lines(
    start: int,
    stop: int,
    contrast: NDArray[np.float32],  # [R, A, 3], by radius and angle
    along: NDArray[np.int64],  # [L], steps of the radius from a line's middle
    turns: NDArray[np.int64],  # [B, L], steps around for each bend
    quantile: float,
    means: NDArray[np.float32],  # out [B, R, A, 3]
    steady: NDArray[np.float32],  # out [B, R, A]
) -> None:
    """The mean contrast along lines through each place, and the one that all but a `quantile` of a line exceeds."""
    radii, angles, n = contrast.shape[0], contrast.shape[1], len(along)
    place = quantile * (n - 1)
    low = int(place)
    line, least = np.empty((n, 3), np.float32), np.empty(low + 2, np.float32)
    for row in range(start, stop):
        for b in range(len(turns)):
            for column in range(angles):
                red, green, blue = np.float32(0), np.float32(0), np.float32(0)
                for k in range(n):
                    i, j = min(max(row + along[k], 0), radii - 1), (column + turns[b, k]) % angles
                    line[k, 0], line[k, 1], line[k, 2] = contrast[i, j, 0], contrast[i, j, 1], contrast[i, j, 2]
                    red, green, blue = red + line[k, 0], green + line[k, 1], blue + line[k, 2]
                red, green, blue = red / np.float32(n), green / np.float32(n), blue / np.float32(n)
                size = max(np.sqrt(red * red + green * green + blue * blue), np.float32(1e-6))
                least[:] = np.inf  # the smallest shares so far, in order
                for k in range(n):
                    share = (line[k, 0] * red + line[k, 1] * green + line[k, 2] * blue) / size
                    at = low + 1
                    if share < least[at]:
                        while at > 0 and share < least[at - 1]:
                            least[at] = least[at - 1]
                            at -= 1
                        least[at] = share
                means[b, row, column, 0], means[b, row, column, 1], means[b, row, column, 2] = red, green, blue
                steady[b, row, column] = least[low] + (place - low) * (least[low + 1] - least[low])


@njit(cache=True, nogil=True)
def _steadiest(
    start: int,
    stop: int,
    contrast: NDArray[np.float32],  # [R, A, 3]
    along: NDArray[np.int64],  # [L]
    turns: NDArray[np.int64],  # [B, L]
    means: NDArray[np.float32],  # [B, R, A, 3]
    steady: NDArray[np.float32],  # [B, R, A]
    found: NDArray[np.float32],  # out [R, A]
) -> None:
    """A membrane runs all along a steady line, but ends where the picture itself does not stand out."""
    radii, angles = found.shape
    for row in range(start, stop):
        for column in range(angles):
            most = np.float32(0)
            for b in range(len(turns)):
                for k in range(len(along)):
                    i, j = row - along[k], (column - turns[b, k]) % angles
                    if not 0 <= i < radii or steady[b, i, j] <= most:
                        continue
                    dot, square = np.float32(0), np.float32(0)
                    for c in range(3):
                        dot += contrast[row, column, c] * means[b, i, j, c]
                        square += means[b, i, j, c] ** 2
                    if dot > 0.5 * square:
                        most = steady[b, i, j]
            found[row, column] = most
