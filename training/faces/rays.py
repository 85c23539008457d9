"""The outline of a face as it is seen from its middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["Rays", "diameter_of"]

OUTLYING = 4.0
"""Spreads outside of the oval from which a place does not count in fitting it; twice as many inside of it, where a face
may have a dent, but no bulge."""

LEAST_SPREAD = 0.003
"""Least spread as a fraction of the radius: half a pixel of a small face."""

FITS = 30
"""Rounds of fitting, each with weights from the one before."""


@dataclass(frozen=True)
class Rays:
    """Rays from the middle of a face to its outline, evenly over all directions."""

    middle: NDArray[np.float64]
    """(2,). Row and column."""
    turns: NDArray[np.float64]
    """(N,). Their directions, from that of the columns towards that of the rows, in radians."""
    reach: NDArray[np.float64]
    """(N,). Their lengths in pixels, at least one."""
    diameter: float
    """That of a disc as large as the face."""

    @classmethod
    def of(cls, mask: NDArray[np.bool_], count: int) -> Rays:
        """The rays of a face (H, W), not empty."""
        middle = np.array([places.mean() for places in np.nonzero(mask)])
        turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
        return cls(middle, turns, _reach(mask, middle, _directions(turns)), diameter_of(mask))

    def oval(self) -> NDArray[np.float64]:
        """(N,). The radius of an oval that most of the outline follows; the more a place stands out, the less it
        counts."""
        basis = np.stack([np.ones_like(self.turns), *(f(k * self.turns) for k in (1, 2) for f in (np.cos, np.sin))], -1)
        wanted, weights = np.log(self.reach), np.ones_like(self.reach)
        for _ in range(FITS):
            found = basis @ np.linalg.lstsq(basis * weights[:, None], wanted * weights, rcond=None)[0]
            apart = wanted - found
            spread = max(float(1.48 * np.median(np.abs(apart))), LEAST_SPREAD)
            outlying = apart / (OUTLYING * spread)
            weights = np.clip(1 - np.square(np.where(apart > 0, outlying, outlying / 2)), 1e-3, 1)  # Tukey's
        return np.exp(found)

    def read(self, image: NDArray[np.floating], radii: NDArray[np.floating]) -> NDArray[np.floating]:
        """(M, N). What an image (H, W) shows on the rays at these distances (M, N) from the middle, bilinear."""
        places = self.middle[:, None, None] + _directions(self.turns)[:, None] * radii
        return np.asarray(ndimage.map_coordinates(image, places, order=1, mode="nearest"))

    def within(self, radii: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """(H, W). The pixels of a picture within an outline of these radii (N,)."""
        rows, columns = (axis - start for axis, start in zip(np.indices(shape), self.middle, strict=True))
        turn = np.arctan2(rows, columns) % (2 * np.pi)
        return np.asarray(np.hypot(rows, columns) <= np.interp(turn, self.turns, radii, period=2 * np.pi))


def diameter_of(mask: NDArray[np.bool_]) -> float:
    """Diameter in pixels of a disc as large as a face (H, W)."""
    return float(np.sqrt(4 / np.pi * mask.sum()))


def _directions(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, N). Steps of one pixel, rows and columns, in directions (N,)."""
    return np.stack([np.sin(turns), np.cos(turns)])


def _reach(mask: NDArray[np.bool_], middle: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,). How far a mask (H, W) reaches from a place (2,) along rays (2, N), pixels, at least one."""
    steps = np.arange(1, int(np.hypot(*mask.shape)))
    places = np.round(middle[:, None, None] + rays[:, None] * steps[:, None]).astype(int)
    size = np.array(mask.shape)[:, None, None]
    seen = ((places >= 0) & (places < size)).all(0)
    rows, columns = np.clip(places, 0, size - 1)
    return (steps[:, None] * (seen & mask[rows, columns])).max(0).clip(1).astype(np.float64)
