"""From cuts to pieces: which there are, which half-spaces each is, and where it lies in the window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.model.document import WHOLE, Document, Key
from app.model.rigid_transform import Motion
from engine.scene.atoms import Atoms
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["PlacedPiece", "Solid", "pieces", "sections", "shown"]

SAMPLE = 20_000
"""Points that stand for the solid when a cut asks what lies on which side: 27 along each axis of a cube."""


@dataclass(frozen=True)
class Solid:
    """Where the object is, in a few thousand points."""

    points: NDArray[np.float64]
    """(N, 3). Spread over surface and inside, the surface's first."""
    centre: NDArray[np.float64]
    """(3,). Middle of the bounds."""
    radius: float
    """Of the sphere around the centre that holds all points, world units. Range (0, inf)."""
    skin: int = 0
    """How many of the points lie on the surface. Range [0, N]."""

    @staticmethod
    def of(given: NDArray[np.floating], limit: int = SAMPLE) -> Solid:
        """From given points (N, 3), of which at most `limit` are kept, the same ones every time."""
        points = _sample(given, limit)
        if not len(points):
            return Solid(np.zeros((0, 3)), np.zeros(3), 1.0)
        low, high = points.min(0), points.max(0)
        centre = (low + high) / 2
        radius = float(np.sqrt(((points - centre) ** 2).sum(1).max())) or 1.0
        return Solid(points, centre, radius)

    @staticmethod
    def of_atoms(atoms: Atoms) -> Solid:
        """From the centres of atoms. Stray surface atoms far from the inside do not count as solid."""
        skin, inside = (_sample(means, SAMPLE // 2) for means in (atoms.surface.means, atoms.interior.means))
        if len(inside):
            reach = 2.5 * float(np.ptp(inside, axis=0).max()) / max(len(inside), 1) ** (1 / 3)
            skin = skin[cKDTree(inside).query(skin, distance_upper_bound=reach)[0] < np.inf]
        return replace(Solid.of(np.concatenate([skin, inside])), skin=len(skin))

    @property
    def spacing(self) -> float:
        """About the distance between neighbouring points, world units."""
        return 2 * self.radius / max(len(self.points), 1) ** (1 / 3)


def _sample(points: NDArray[np.floating], limit: int) -> NDArray[np.float64]:
    """At most `limit` of some points (N, 3), in their order."""
    if len(points) > limit:
        points = points[np.sort(np.random.default_rng(0).choice(len(points), limit, replace=False))]
    return points.astype(np.float64)


@dataclass(frozen=True)
class PlacedPiece:
    """A piece as it lies in the window."""

    key: Key
    name: str
    planes: tuple[Plane, ...]
    """Half-spaces of the object's own space."""
    motion: Motion
    """From the object's space to the window's world: the user's motion, the gap and the explosion."""
    visible: bool
    rows: NDArray[np.intp]
    """(M,). The solid's points in this piece; empty only where nothing is loaded."""

    def piece(self, extra: Sequence[Plane] = ()) -> Piece:
        """As the renderers take it, cut further by these planes of the object's space."""
        return Piece((*self.planes, *extra), self.motion.matrix)


@dataclass(frozen=True)
class _Share:
    """A piece while the cuts are gone through."""

    key: Key
    planes: tuple[Plane, ...]
    rows: NDArray[np.intp]
    parting: NDArray[np.float64]
    """(3,). Sum of signed normals of its cuts: the direction in which it parts from the others."""


def pieces(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces of the object, without removed ones.

    A cut divides a piece only if some of the solid lies on both sides; otherwise the piece stays as it is.
    """
    shares = [_Share(WHOLE, (), np.arange(len(solid.points)), np.zeros(3))]
    for cut in document.cuts:
        if cut.kind != "slice" or not cut.on:
            continue
        divided: list[_Share] = []
        for share in shares:
            plane = cut.plane_for(share.key)
            sides = None if plane is None else _divide(share, plane, cut.id, solid)
            divided += sides or [share]
        shares = divided
    result = []
    for number, share in enumerate(shares, 1):
        placement = document.placement(share.key)
        if placement.removed:
            continue
        centre = solid.points[share.rows].mean(0) if len(share.rows) else solid.centre
        outwards = document.explode * (centre - solid.centre) if share.key else np.zeros(3)
        apart = Motion.by(share.parting * (document.gap / 2 * solid.radius) + outwards)
        name = placement.name or (f"Piece {number}" if share.key else "Whole")
        motion = placement.motion.after(apart)
        result.append(PlacedPiece(share.key, name, share.planes, motion, placement.visible, share.rows))
    return result


def _divide(share: _Share, plane: Plane, cut_id: int, solid: Solid) -> list[_Share] | None:
    """Both sides of a piece; None where the solid lies on one side alone."""
    removed = plane.distance(solid.points[share.rows]) > 0
    if len(share.rows) and (removed.all() or not removed.any()):
        return None
    normal = np.asarray(plane.normal)
    return [
        _Share((*share.key, (cut_id, side)), (*share.planes, half), share.rows[rows], share.parting + side * normal)
        for side, half, rows in ((-1, plane, ~removed), (1, plane.flipped(), removed))
    ]


def sections(document: Document) -> tuple[Plane, ...]:
    """The planes of sections that are on: what lies on their removed side is not shown."""
    return tuple(cut.plane(cut.parts[0]) for cut in document.cuts if cut.kind == "section" and cut.on)


def shown(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces that are to be drawn."""
    return [piece for piece in pieces(document, solid) if piece.visible]
