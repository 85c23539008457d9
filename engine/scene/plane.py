"""A cut plane a x + b y + c z + d = 0 (paper, eq. 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.errors import InputError

__all__ = ["Plane", "frame", "stack"]


@dataclass(frozen=True)
class Plane:
    """Unit normal n and offset d: n.x + d = 0. The kept side is n.x + d <= 0."""

    normal: tuple[float, float, float]
    """Unit vector, world axes."""
    offset: float
    """d, world units."""

    @staticmethod
    def of(normal: ArrayLike, offset: float) -> Plane:
        """The plane a x + b y + c z + d = 0 from any (a, b, c) of non-zero length; d is scaled with it.

        Raises InputError if the normal has no direction or a number is not finite.
        """
        n = np.asarray(normal, np.float64)
        size = float(np.abs(n).max()) if n.shape == (3,) else 0.0  # divided by first: squares of 1e200 overflow
        if np.isfinite(size) and size > 1e-12:
            length = float(np.linalg.norm(n / size))
            a, b, c = (n / size / length).tolist()
            d = float(offset) / size / length
            if math.isfinite(d):
                return Plane((a, b, c), d)
        given = ",".join(f"{value:g}" for value in [*np.ravel(n), offset])
        raise InputError(f"plane {given}: the normal a,b,c must be finite and not zero, and d finite")

    @staticmethod
    def through(point: ArrayLike, normal: ArrayLike) -> Plane:
        """The plane through a point (3,) with a normal (3,) of any non-zero length."""
        n = np.asarray(normal, np.float64)
        return Plane.of(n, -float(n @ np.asarray(point, np.float64)))

    def distance(self, points: NDArray[np.floating]) -> NDArray[np.floating]:
        """Signed distance of points (..., 3) in world units; positive on the removed side."""
        return points @ np.asarray(self.normal, points.dtype) + points.dtype.type(self.offset)

    def flipped(self) -> Plane:
        """The same plane with the other side kept."""
        a, b, c = self.normal
        return Plane((-a, -b, -c), -self.offset)


def frame(normal: ArrayLike) -> NDArray[np.float64]:
    """(3, 3). Rows e1, e2, n: a right-handed frame with the unit normal n.

    e1 is the world axis least along n, made orthogonal to it, so the frame never degenerates.
    """
    n = np.asarray(normal, np.float64)
    n = n / np.linalg.norm(n)
    axis = np.zeros(3)
    axis[np.argmin(np.abs(n))] = 1.0
    e1 = axis - n * (n @ axis)
    e1 /= np.linalg.norm(e1)
    return np.stack([e1, np.cross(n, e1), n])


def stack(planes: Sequence[Plane]) -> NDArray[np.float64]:
    """(P, 4). Rows a, b, c, d of the planes."""
    return np.array([[*p.normal, p.offset] for p in planes], np.float64).reshape(-1, 4)
