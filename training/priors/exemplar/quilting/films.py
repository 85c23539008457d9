"""Points of a quilt beside its own planes, in which pictures were taken.

An own plane that shows what is not beside it is a film in the quilt, two cells thick, and a bar in cuts across it. Such
films are made thinner, and where own planes of both families cross, neither cuts a bar out of the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.priors.exemplar.quilting.chunks import OwnAzimuths, OwnHeight
from training.priors.exemplar.quilting.disc import PIXEL
from training.priors.exemplar.quilting.labels import Label

__all__ = ["Beside", "half_film"]

CROSSING = 2
"""Cells from own planes of both families within which the nearer plane is shown."""

FILM_SEAM, FILM_REACH = 1.3, 3.0
"""Cells from an own plane at which the seam of a film of two cells ends (`quilt.SEAM_WIDTH`), and up to which labels
are moved towards the plane as the film becomes thinner. With 2.3 and 5.0, what ends near the plane ends at a straight
line."""


def half_film(film: float, cell: float) -> float:
    """Radii. Distance from an own plane up to which a `film` shows its picture: at least half a pixel, at most a
    `cell`."""
    return min(max(film, PIXEL) / 2, cell)


@dataclass(frozen=True)
class Beside:
    """How M points lie beside the own planes of each label that has some."""

    numbers: NDArray[np.int32]
    """(L,). Numbers of these labels."""
    far: NDArray[np.float32]
    """(L, M). Distances from the nearest of a label's planes along its normal, radii."""
    normals: list[NDArray[np.float32]]
    """(1, 3) or (M, 3) for each label. The normals of these planes."""

    @classmethod
    def of(cls, labels: list[Label], points: NDArray[np.float32]) -> Beside:
        """For points (M, 3) of the quilt."""
        numbers, far, normals = [], [], []
        for number, chunks in enumerate(label.chunks for label in labels):
            if isinstance(chunks, OwnHeight | OwnAzimuths):
                distance, normal = chunks.off(points)
                numbers.append(number)
                far.append(distance)
                normals.append(normal)
        return cls(np.array(numbers, np.int32), np.stack(far), normals)

    def beyond_films(self, points: NDArray[np.float32], film: float, cell: float) -> NDArray[np.float32]:
        """(M, 3). Where labels are looked up for the points (M, 3), so that films are as thin as `film`, but not
        thinner than a pixel or thicker than two cells; `cell` is the width of a cell."""
        there, half = points.copy(), half_film(film, cell)
        ends = np.array([0, FILM_SEAM * half, FILM_REACH * cell])
        for far, normals in zip(self.far, self.normals, strict=True):
            rows = np.flatnonzero(np.abs(far) < ends[-1])
            distance = np.abs(far[rows])
            moved = np.interp(distance, ends, [0, FILM_SEAM * cell, ends[-1]]) - distance
            there[rows] += (np.sign(far[rows]) * moved)[:, None] * (normals if len(normals) == 1 else normals[rows])
        return there

    def share_crossing(self, best: NDArray[np.int32], apart: NDArray[np.float32], cell: float) -> None:
        """Gives points close to own planes of both families to the nearer plane: decided by cells, one would cut a bar
        out of the other. Changes the two nearest labels (M, 2) and how far the first one leads (M,)."""
        if len(self.numbers) < 2:
            return
        distances = np.abs(self.far)
        rows = np.flatnonzero(np.isin(best[:, 0], self.numbers) & (distances.max(0) < CROSSING * cell))
        order = distances[:, rows].argsort(0)
        nearer, farther = np.take_along_axis(distances[:, rows], order, 0)
        best[rows], apart[rows] = self.numbers[order].T, (farther - nearer) / (farther + nearer + 1e-9)
