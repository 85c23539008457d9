"""What is at places of a quilt, as far as the picture that is shown there tells.

A place in a picture's rind is rind, wherever the picture is shown; one in a membrane is a structure that runs through.
A thing stands out from the picture and, by the law of shape (`relief`), ends at a distance from the picture's plane; so
do grains, in their pictures and as they are laid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.scene.inside import Kind
from training.priors.exemplar.quilting.disc import DISC_PIXELS, read_map, to_pixels
from training.priors.exemplar.quilting.films import Beside
from training.priors.exemplar.quilting.labels import Source
from training.priors.exemplar.quilting.quilt import Quilt

__all__ = ["QuiltKinds"]

LEAST_MEMBRANE = 0.3
"""Least surety of a membrane at which a place belongs to it, as for layers."""

COVERED = 0.5
"""Least fraction of a place that a grain, a seed or a core covers for the place to belong to it."""


@dataclass(frozen=True)
class _Face:
    """The kinds in a picture."""

    rind: float
    """Depth of the rind in radii."""
    membranes: NDArray[np.float32]
    """(P, P). How surely each place shows a membrane."""
    until: NDArray[np.float32]
    """(P, P). Distance in radii from its plane up to which each pixel shows a thing; below 0 where there is none."""

    @classmethod
    def of(cls, source: Source) -> _Face:
        until = source.relief.closed_until(source.rind)
        until = np.where(source.grains.regions, np.maximum(until, 0), until)
        return cls(source.rind, source.membranes, until.astype(np.float32))

    def at(self, x: NDArray[np.floating], y: NDArray[np.floating], distance: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(M,). The kinds at places (M,), (M,) and distances (M,) from the plane."""
        at = np.clip(np.round(to_pixels(x, y, DISC_PIXELS)), 0, DISC_PIXELS - 1).astype(int)
        out = np.where(distance <= self.until[at[0], at[1]], Kind.THING, Kind.INSIDE).astype(np.uint8)
        out[read_map(self.membranes, x, y) > LEAST_MEMBRANE] = Kind.STRUCTURE
        out[np.hypot(x, y) > 1 - self.rind] = Kind.RIND
        return out


class QuiltKinds:
    """The kinds of a quilt."""

    def __init__(self, quilt: Quilt) -> None:
        self._quilt = quilt
        shown = {id(source): source for label in quilt.labels for source in label.sources}
        self._faces = {key: _Face.of(source) for key, source in shown.items()}

    def at(self, points: NDArray[np.float32], film: float) -> NDArray[np.uint8]:
        """(M,). The `Kind` at points (M, 3) of the unit ball, never OUTSIDE; `film` as in `Quilt.read`."""
        quilt = self._quilt
        points = quilt.rinds.evened(points)
        nearest = quilt.nearest(points, film)[0][:, 0]
        out = np.full(len(points), Kind.INSIDE, np.uint8)
        for n, label in enumerate(quilt.labels):
            rows = np.flatnonzero(nearest == n)
            places = label.chunks.places(quilt.ball(points[rows]))
            in_film = places.distance < quilt.ends(film)
            for m, source in enumerate(label.sources):
                face, of_it = self._faces[id(source)], places.picture == m
                distance = np.where(in_film & source.has_grains, 0, places.distance)[of_it]
                out[rows[of_it]] = face.at(places.x[of_it], places.y[of_it], distance)
        for _, cover in quilt.solids(points, Beside.of(quilt.labels, points), film):
            out[cover > COVERED] = Kind.THING
        return out
