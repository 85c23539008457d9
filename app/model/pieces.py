"""The pieces that a document's cuts divide the object into: their half-spaces, and where each is placed."""

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

__all__ = ["Member", "PlacedPiece", "Solid", "pieces", "sections", "visible_pieces"]

SAMPLE = 20_000
"""Points that represent the solid when a cut divides it: 27 along each axis of a cube."""


@dataclass(frozen=True)
class Solid:
    """A sample of the object's points, for questions about its extent and about which side of a plane it is on."""

    points: NDArray[np.float64]
    """(N, 3). Spread over surface and interior, those of the surface first."""
    centre: NDArray[np.float64]
    """(3,). Centre of the bounding box."""
    radius: float
    """Of the sphere around the centre that holds all points, world units. Range (0, inf)."""
    skin: int = 0
    """How many of the points are on the surface. Range [0, N]."""

    @staticmethod
    def of(given: NDArray[np.floating], limit: int = SAMPLE) -> Solid:
        """From points (N, 3), of which at most `limit` are sampled, the same ones every time."""
        points = _sample(given, limit)
        if not len(points):
            return Solid(np.zeros((0, 3)), np.zeros(3), 1.0)
        low, high = points.min(0), points.max(0)
        centre = (low + high) / 2
        radius = float(np.sqrt(((points - centre) ** 2).sum(1).max())) or 1.0
        return Solid(points, centre, radius)

    @staticmethod
    def of_atoms(atoms: Atoms) -> Solid:
        """From the centres of atoms. Stray surface atoms far from the interior are left out."""
        skin, inside = (_sample(means, SAMPLE // 2) for means in (atoms.surface.means, atoms.interior.means))
        if len(inside):
            reach = 2.5 * float(np.ptp(inside, axis=0).max()) / max(len(inside), 1) ** (1 / 3)
            skin = skin[cKDTree(inside).query(skin, distance_upper_bound=reach)[0] < np.inf]
        return replace(Solid.of(np.concatenate([skin, inside])), skin=len(skin))

    @property
    def spacing(self) -> float:
        """Approximate distance between neighbouring points, world units."""
        return 2 * self.radius / max(len(self.points), 1) ** (1 / 3)


def _sample(points: NDArray[np.floating], limit: int) -> NDArray[np.float64]:
    """At most `limit` of the points (N, 3), in the same order."""
    if len(points) > limit:
        points = points[np.sort(np.random.default_rng(0).choice(len(points), limit, replace=False))]
    return points.astype(np.float64)


@dataclass(frozen=True)
class PlacedPiece:
    """A piece where it is placed in the world."""

    key: Key
    name: str
    planes: tuple[Plane, ...]
    """Its half-spaces, in object space."""
    motion: Motion
    """From object space to world space: the user's motion, the gap and the explosion."""
    visible: bool
    rows: NDArray[np.intp]
    """(M,). Rows of the solid's points that are in this piece; empty only while nothing is loaded."""

    def piece(self, extra: Sequence[Plane] = ()) -> Piece:
        """The renderers' piece, cut further by these planes in object space."""
        return Piece((*self.planes, *extra), self.motion.matrix)


@dataclass(frozen=True)
class Member:
    """A piece of one of the objects, as it is drawn."""

    index: int
    """Of its object in the documents."""
    piece: PlacedPiece


@dataclass(frozen=True)
class _Fragment:
    """A piece after some of the cuts."""

    key: Key
    planes: tuple[Plane, ...]
    rows: NDArray[np.intp]
    parting: NDArray[np.float64]
    """(3,). Sum of the signed normals of its cuts: the direction in which the gap moves it."""


def pieces(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces of the object, without removed ones.

    A cut divides a piece only if the solid has points on both sides; otherwise the piece stays as it is.
    """
    fragments = [_Fragment(WHOLE, (), np.arange(len(solid.points)), np.zeros(3))]
    for cut in document.cuts:
        if cut.kind != "slice" or not cut.on:
            continue
        divided: list[_Fragment] = []
        for fragment in fragments:
            plane = cut.plane_for(fragment.key)
            sides = None if plane is None else _divide(fragment, plane, cut.id, solid)
            divided += sides or [fragment]
        fragments = divided
    result = []
    for number, fragment in enumerate(fragments, 1):
        placement = document.placement(fragment.key)
        if placement.removed:
            continue
        centre = solid.points[fragment.rows].mean(0) if len(fragment.rows) else solid.centre
        outwards = document.explode * (centre - solid.centre) if fragment.key else np.zeros(3)
        apart = Motion.by(fragment.parting * (document.gap / 2 * solid.radius) + outwards)
        name = placement.name or (f"Piece {number}" if fragment.key else "Whole")
        motion = placement.motion.after(apart)
        result.append(PlacedPiece(fragment.key, name, fragment.planes, motion, placement.visible, fragment.rows))
    return result


def _divide(fragment: _Fragment, plane: Plane, cut_id: int, solid: Solid) -> list[_Fragment] | None:
    """The two sides of a piece; None if all of it is on one side."""
    removed = plane.distance(solid.points[fragment.rows]) > 0
    if len(fragment.rows) and (removed.all() or not removed.any()):
        return None
    normal = np.asarray(plane.normal)
    return [
        _Fragment(
            (*fragment.key, (cut_id, side)),
            (*fragment.planes, half),
            fragment.rows[rows],
            fragment.parting + side * normal,
        )
        for side, half, rows in ((-1, plane, ~removed), (1, plane.flipped(), removed))
    ]


def sections(document: Document) -> tuple[Plane, ...]:
    """The planes of all sections that are on; what is on their removed side is hidden."""
    return tuple(cut.plane(cut.parts[0]) for cut in document.cuts if cut.kind == "section" and cut.on)


def visible_pieces(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces that are drawn."""
    return [piece for piece in pieces(document, solid) if piece.visible]
