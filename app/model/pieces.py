"""The pieces that a document's cuts divide the object into: their half-spaces and placements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from app.model.document import WHOLE, Document, Key, Mark, Part
from app.model.rigid_transform import Motion
from app.translation import _
from engine.scene.atoms import Atoms
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = [
    "Cell",
    "Member",
    "PlacedPiece",
    "PointSample",
    "pieces",
    "placed_pieces",
    "sections",
    "shown_points",
    "visible_pieces",
]

SAMPLE = 20_000
"""Points that represent the solid when a cut divides it: 27 along each axis of a cube."""

KEPT = 0.5
"""Least part of the gap that is left between any two of many pieces: all of it would take three times as many steps,
for a difference that nobody sees among a hundred pieces. A few pieces keep nearly all of it."""

CLOSED = 0.3
"""Length of the mean of a blade's unit normals below which the blade has no direction. The length is 0 for a blade that
goes all around, and 0.6 for a half circle."""

MOST_STEPS = 300
"""Most steps of moving pieces apart. 14 cuts through everything, which make 280 pieces, take 150."""


@dataclass(frozen=True)
class PointSample:
    """A sample of the object's points, for questions about its extent and about which side of a plane it is on."""

    points: NDArray[np.float64]
    """(N, 3). Points spread over surface and interior, those of the surface first."""
    centre: NDArray[np.float64]
    """(3,). Centre of the bounding box."""
    radius: float
    """Radius of the sphere around the centre that holds all points, world units. Range (0, inf)."""
    skin: int = 0
    """How many of the points are on the surface. Range [0, N]."""

    @staticmethod
    def of(given: NDArray[np.floating], limit: int = SAMPLE) -> PointSample:
        """From points (N, 3), of which at most `limit` are sampled, always the same ones."""
        points = _sample(given, limit)
        if not len(points):
            return PointSample(np.zeros((0, 3)), np.zeros(3), 1.0)
        low, high = points.min(0), points.max(0)
        centre = (low + high) / 2
        radius = float(np.sqrt(((points - centre) ** 2).sum(1).max())) or 1.0
        return PointSample(points, centre, radius)

    @staticmethod
    def of_atoms(atoms: Atoms) -> PointSample:
        """From the centres of atoms. Stray surface atoms far from the interior are left out."""
        skin, inside = (_sample(means, SAMPLE // 2) for means in (atoms.surface.means, atoms.interior.means))
        if len(inside):
            reach = 2.5 * float(np.ptp(inside, axis=0).max()) / max(len(inside), 1) ** (1 / 3)
            skin = skin[cKDTree(inside).query(skin, distance_upper_bound=reach)[0] < np.inf]
        return replace(PointSample.of(np.concatenate([skin, inside])), skin=len(skin))

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
class Cell:
    """A convex part of a piece: an intersection of half-spaces in object space. After straight cuts a piece has one."""

    faces: tuple[Plane, ...] = ()
    """Planes where the piece ends."""
    walls: tuple[Plane, ...] = ()
    """Planes where the piece continues in another of its cells, or a neighbour in one of its own."""

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Faces and walls."""
        return self.faces + self.walls

    def contains(self, points: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(N,). Which of the points (N, 3) are in the cell."""
        return np.logical_and.reduce([np.ones(len(points), bool), *(p.distance(points) <= 0 for p in self.planes)])


@dataclass(frozen=True)
class PlacedPiece:
    """A piece where it is placed in the world."""

    key: Key
    name: str
    cells: tuple[Cell, ...]
    """The convex parts of the piece, at least one."""
    motion: Motion
    """From object space to world space: the gap and the explosion, then the user's motion."""
    visible: bool
    rows: NDArray[np.intp]
    """(M,). Rows of the solid's points that are in this piece; empty only while nothing is loaded."""
    group: str = ""
    mark: Mark = ""
    """As in `Placement`."""

    def drawn(self, extra: Sequence[Plane] = ()) -> list[Piece]:
        """The renderers' pieces, one for each cell, also cut by `extra` planes in object space."""
        return [Piece((*cell.planes, *extra), self.motion.matrix) for cell in self.cells]


@dataclass(frozen=True)
class Member:
    """A piece of one of the objects, as it is drawn."""

    index: int
    """Index of its object in the documents."""
    piece: PlacedPiece


@dataclass(frozen=True)
class _Fragment:
    """A piece after some of the cuts."""

    key: Key
    cells: tuple[tuple[Cell, NDArray[np.intp]], ...]
    """The cells, each with the rows of the solid's points in it."""

    @property
    def rows(self) -> NDArray[np.intp]:
        return np.concatenate([rows for _, rows in self.cells])


def pieces(document: Document, solid: PointSample) -> list[PlacedPiece]:
    """The pieces of the object except removed ones.

    A cut divides a piece only if the solid has points on both sides; otherwise the piece stays as it is.
    """
    fragments = [_Fragment(WHOLE, ((Cell(), np.arange(len(solid.points))),))]
    directions: dict[Key, NDArray[np.float64]] = {}
    for cut in document.cuts:
        if cut.kind != "slice" or not cut.on:
            continue
        divided: list[_Fragment] = []
        for fragment in fragments:
            parts = cut.parts_for(fragment.key)
            sides = _divide(fragment, parts, cut.id, solid) if parts else None
            if sides is not None:
                directions[fragment.key] = _direction(parts)
            divided += sides or [fragment]
        fragments = divided
    offsets = (
        document.gap * solid.radius * _parted(fragments, directions) if document.gap else np.zeros((len(fragments), 3))
    )
    result = []
    for number, (fragment, offset) in enumerate(zip(fragments, offsets, strict=True), 1):
        placement = document.placement(fragment.key)
        if placement.removed:
            continue
        rows = fragment.rows
        centre = solid.points[rows].mean(0) if len(rows) else solid.centre
        outwards = document.explode * (centre - solid.centre) if fragment.key else np.zeros(3)
        apart = Motion.by(offset + outwards)
        name = placement.name or (_("Piece {number}").format(number=number) if fragment.key else _("Whole"))
        motion = placement.motion.after(apart)
        cells = tuple(cell for cell, _ in fragment.cells)
        result.append(
            PlacedPiece(fragment.key, name, cells, motion, placement.visible, rows, placement.group, placement.mark)
        )
    return result


def _divide(fragment: _Fragment, parts: Sequence[Part], cut_id: int, solid: PointSample) -> list[_Fragment] | None:
    """The two sides of a piece; None if all of it is on one side."""
    sides: tuple[list[tuple[Cell, NDArray[np.intp]]], ...] = ([], [])
    for cell, rows in fragment.cells:
        points = solid.points[rows]
        for part in parts:
            # A sector extends a little beyond its points, which are a sample, so that no sliver of the object is lost.
            apart = np.array([wall.distance(points) for wall in part.walls]).reshape(len(part.walls), len(rows))
            near, within = (apart <= solid.spacing).all(axis=0), (apart <= 0).all(axis=0)
            if len(rows) and not near.any():
                continue
            walls = tuple(wall for wall, beyond in zip(part.walls, apart, strict=True) if (beyond > 0).any())
            distance = part.plane.distance(points)
            removed = distance > 0
            margin = solid.spacing if part.walls else 0.0
            for side, half, on, reached in (
                (0, part.plane, ~removed, distance <= margin),
                (1, part.plane.flipped(), removed, distance > -margin),
            ):
                if not len(rows):
                    sides[side].append((Cell((*cell.faces, half), (*cell.walls, *part.walls)), rows))
                elif (near & reached).any():
                    faces = (*cell.faces, half) if (near & ~on).any() else cell.faces
                    sides[side].append((Cell(faces, cell.walls + walls), rows[within & on]))
    if any(not len(side) for side in sides):
        return None
    found = [_Fragment((*fragment.key, (cut_id, s)), tuple(cells)) for s, cells in zip((-1, 1), sides, strict=True)]
    return found if not len(fragment.rows) or all(len(side.rows) for side in found) else None


def _direction(parts: Sequence[Part]) -> NDArray[np.float64]:
    """(3,). Unit vector along which the removed side moves away from the kept one: the mean normal of the planes.

    A blade that goes all around has no mean normal; what it encloses moves along the edges of its planes, towards the
    side from which the planes follow one another clockwise.
    """
    normals = np.array([part.plane.normal for part in parts])
    direction = normals.mean(axis=0)
    if np.linalg.norm(direction) < CLOSED:
        direction = np.cross(normals, np.roll(normals, -1, axis=0)).sum(axis=0)
    return direction / max(float(np.linalg.norm(direction)), 1e-12)


def _parted(fragments: Sequence[_Fragment], directions: Mapping[Key, NDArray[np.float64]]) -> NDArray[np.float64]:
    """(F, 3). How far each piece is moved so that no two are closer than a gap of 1; offsets scale with the gap.

    Any two pieces were parted by one cut, the first that has them on different sides: they do not overlap if they keep
    apart along its direction (`directions`, by the key of the piece that it divided). Each piece begins half a gap away
    from all of its own cuts, which is right for one cut or for slices side by side. Among oblique cuts, later ones push
    pieces back over earlier ones: pieces are then moved apart by the distance that is missing, averaged over all pieces
    in the way, until all keep apart. Such averaged projections converge, since a solution exists: pieces moved far
    enough away from the centre.
    """
    count = len(fragments)
    sides: dict[Key, tuple[list[int], list[int]]] = {}
    for number, fragment in enumerate(fragments):
        for depth, (__, side) in enumerate(fragment.key):
            sides.setdefault(fragment.key[:depth], ([], []))[side > 0].append(number)
    normals = np.zeros((count, count, 3))  # towards the row's piece from the column's
    offsets = np.zeros((count, 3))
    for key, (low, high) in sides.items():
        normal = directions[key]
        normals[np.ix_(high, low)], normals[np.ix_(low, high)] = normal, -normal
        offsets[low] -= normal / 2
        offsets[high] += normal / 2
    for __ in range(MOST_STEPS):
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
    """The planes of all sections that are on; what is on their removed sides is hidden."""
    return tuple(cut.plane(cut.parts[0]) for cut in document.cuts if cut.kind == "section" and cut.on)


def shown_points(piece: PlacedPiece, solid: PointSample, hidden: Sequence[Plane]) -> NDArray[np.float64]:
    """(M, 3). The points of a piece on the kept side of all planes `hidden`, in world space as the piece is placed."""
    points = solid.points[piece.rows]
    for plane in hidden:
        points = points[plane.distance(points) <= 0]
    return piece.motion.apply(points)


def visible_pieces(document: Document, solid: PointSample) -> list[PlacedPiece]:
    """The pieces that are not hidden."""
    return [piece for piece in pieces(document, solid) if piece.visible]


def placed_pieces(document: Document, solid: PointSample, index: int = 0) -> list[Piece]:
    """The renderer's pieces of an object's visible pieces, without what sections hide; `index`: that of its solid."""
    hidden = sections(document)
    return [replace(drawn, solid=index) for piece in visible_pieces(document, solid) for drawn in piece.drawn(hidden)]
