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

__all__ = ["Member", "PlacedPiece", "Solid", "pieces", "sections", "shown_points", "visible_pieces"]

SAMPLE = 20_000
"""Points that represent the solid when a cut divides it: 27 along each axis of a cube."""

KEPT = 0.5
"""Part of the gap that is left at least between any two of many pieces: the whole of it would take three times as many
steps, for a difference that is not seen among a hundred pieces. Few pieces keep nearly all of it."""

MOST_STEPS = 300
"""Of moving pieces apart. 14 cuts through everything, which make 280 pieces, take 150."""


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


def pieces(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces of the object, without removed ones.

    A cut divides a piece only if the solid has points on both sides; otherwise the piece stays as it is.
    """
    fragments = [_Fragment(WHOLE, (), np.arange(len(solid.points)))]
    for cut in document.cuts:
        if cut.kind != "slice" or not cut.on:
            continue
        divided: list[_Fragment] = []
        for fragment in fragments:
            plane = cut.plane_for(fragment.key)
            sides = None if plane is None else _divide(fragment, plane, cut.id, solid)
            divided += sides or [fragment]
        fragments = divided
    offsets = document.gap * solid.radius * _parted(fragments) if document.gap else np.zeros((len(fragments), 3))
    result = []
    for number, (fragment, offset) in enumerate(zip(fragments, offsets, strict=True), 1):
        placement = document.placement(fragment.key)
        if placement.removed:
            continue
        centre = solid.points[fragment.rows].mean(0) if len(fragment.rows) else solid.centre
        outwards = document.explode * (centre - solid.centre) if fragment.key else np.zeros(3)
        apart = Motion.by(offset + outwards)
        name = placement.name or (f"Piece {number}" if fragment.key else "Whole")
        motion = placement.motion.after(apart)
        result.append(PlacedPiece(fragment.key, name, fragment.planes, motion, placement.visible, fragment.rows))
    return result


def _divide(fragment: _Fragment, plane: Plane, cut_id: int, solid: Solid) -> list[_Fragment] | None:
    """The two sides of a piece; None if all of it is on one side."""
    removed = plane.distance(solid.points[fragment.rows]) > 0
    if len(fragment.rows) and (removed.all() or not removed.any()):
        return None
    return [
        _Fragment((*fragment.key, (cut_id, side)), (*fragment.planes, half), fragment.rows[rows])
        for side, half, rows in ((-1, plane, ~removed), (1, plane.flipped(), removed))
    ]


def _parted(fragments: Sequence[_Fragment]) -> NDArray[np.float64]:
    """(F, 3). How far each piece is moved so that no two are nearer than a gap of 1, for all gaps proportionally.

    Any two pieces were parted by one cut, the first that has them on different sides, and are convex: they do not
    overlap if they keep apart along its normal. Each begins half a gap away from all of its own cuts, which is right
    for one cut or for slices side by side. Of oblique cuts the later ones push pieces back over the earlier ones: these
    are then moved apart by what is missing, on average over those in the way, until all keep apart. Such averaged
    projections converge, since there are places where all keep apart: pieces moved away from the centre far enough.
    """
    count = len(fragments)
    sides: dict[Key, tuple[list[int], list[int]]] = {}
    for number, fragment in enumerate(fragments):
        for depth, (_, side) in enumerate(fragment.key):
            sides.setdefault(fragment.key[:depth], ([], []))[side > 0].append(number)
    normals = np.zeros((count, count, 3))  # towards the row's piece from the column's
    offsets = np.zeros((count, 3))
    for key, (low, high) in sides.items():
        normal = np.asarray(fragments[low[0]].planes[len(key)].normal)
        normals[np.ix_(high, low)], normals[np.ix_(low, high)] = normal, -normal
        offsets[low] -= normal / 2
        offsets[high] += normal / 2
    for _ in range(MOST_STEPS):
        along = np.matmul(normals, offsets[:, :, None])[:, :, 0]
        missing = 1.0 - (along + along.T)
        np.fill_diagonal(missing, 0.0)
        if missing.max() <= 1.0 - KEPT:
            break
        np.maximum(missing, 0.0, out=missing)
        pushing = np.maximum(np.count_nonzero(missing, axis=1), 1)
        offsets += 1 / pushing[:, None] * np.matmul(missing[:, None], normals)[:, 0]
    return offsets


def sections(document: Document) -> tuple[Plane, ...]:
    """The planes of all sections that are on; what is on their removed side is hidden."""
    return tuple(cut.plane(cut.parts[0]) for cut in document.cuts if cut.kind == "section" and cut.on)


def shown_points(piece: PlacedPiece, solid: Solid, hidden: Sequence[Plane]) -> NDArray[np.float64]:
    """(M, 3). The points of a piece that are on the kept side of all planes `hidden`, where the piece is placed."""
    points = solid.points[piece.rows]
    for plane in hidden:
        points = points[plane.distance(points) <= 0]
    return piece.motion.apply(points)


def visible_pieces(document: Document, solid: Solid) -> list[PlacedPiece]:
    """The pieces that are drawn."""
    return [piece for piece in pieces(document, solid) if piece.visible]
