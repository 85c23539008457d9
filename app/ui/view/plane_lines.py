"""Lines where planes intersect objects: planes of families, of the knife's stroke and of slices; nets around bodies;
and the sheet of the active section."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.model.document import Cut, Document, Key
from app.model.outline import body_of_atoms, body_of_shell, clipped_lines, contours, wires
from app.model.pieces import Cell, Member, PlacedPiece
from app.session.workspace import Workspace
from app.ui.theme import palette, px, rgb, rgba
from engine.render.gl.overlay import Lines, Sheet
from engine.scene.grid import Body
from engine.scene.plane import Plane, frame
from training.families import Family

__all__ = ["PlaneLines"]

MOST = 40
"""Most planes of a family that are drawn; if it has more, only every second or third is."""

OUTSET = 0.6
"""Cells between the skin and the lines: on the skin itself, which is slightly uneven, parts would be hidden."""


class PlaneLines:
    """Finds lines on the workspace's objects, again only if an object or a family has changed."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._bodies: dict[int, tuple[object, Body]] = {}
        self._families: dict[tuple[str, Key, bool], tuple[object, NDArray[np.float64]]] = {}
        self._wires: dict[int, tuple[Body, NDArray[np.float64]]] = {}
        """The net around each body, by the object's number."""
        self._cut_wires: dict[tuple[int, tuple[Cell, ...]], NDArray[np.float64]] = {}
        """The last frame's nets on pieces."""
        self._slices: dict[tuple[int, Plane, tuple[Cell, ...]], NDArray[np.float64]] = {}
        """The lines of the last frame's slices, by the body, the plane and the cells of the piece."""

    def families(self, kinds: Collection[str], pieces: Sequence[PlacedPiece], scale: float) -> list[Lines]:
        """Lines of the planes that training uses for these kinds of families, on pieces where they are placed.

        `scale`: pixels of the screen per unit of the window.
        """
        p = palette()
        result = []
        for family in self.workspace.document.families:
            if family.kind in kinds:
                colour = p.text if family.kind == "horizontal" else p.curve
                result.append(lines(self.of_family(family, pieces), colour, 0.75, px(1.2) * scale, 0.1))
                result.append(lines(self.of_family(family, pieces, own=True), colour, 1.0, px(2.4) * scale, 0.2))
        return result

    def of_family(self, family: Family, pieces: Sequence[PlacedPiece], own: bool = False) -> NDArray[np.float64]:
        """(S, 2, 3). Lines of a family's planes on pieces, or of its own plane, which its pictures show."""
        parts = [moved(piece, self._of(family, piece, own)) for piece in pieces if piece.visible]
        return np.concatenate([np.zeros((0, 2, 3)), *parts])

    def body(self, members: Sequence[Member], scale: float) -> list[Lines]:
        """The bodies of pieces as nets of lines; without pieces, what the active object's capture encloses."""
        kept, self._cut_wires = self._cut_wires, {}
        found = [np.zeros((0, 2, 3))]
        for member in members:
            document, piece = self.workspace.documents[member.index], member.piece
            net = self._net(document)
            key = (id(net), piece.cells)
            ends = kept.get(key)
            self._cut_wires[key] = clipped_lines(net, halfspaces(piece)) if ends is None else ends
            found.append(moved(piece, self._cut_wires[key]))
        if not members and len(self.workspace.solid.points):
            found.append(self._net(self.workspace.document))
        return [lines(np.concatenate(found), palette().text, 0.5, px(1.1) * scale, 0.16)]

    def _net(self, document: Document) -> NDArray[np.float64]:
        body = self.body_of(document)
        if document.number not in self._wires or self._wires[document.number][0] is not body:
            self._wires[document.number] = (body, wires(body, OUTSET))
        return self._wires[document.number][1]

    def cut(self, plane: Plane, members: Sequence[Member], scale: float) -> list[Lines]:
        """Lines where a plane in world space intersects pieces of objects."""
        found = []
        for member in members:
            piece, body = member.piece, self.body_of(self.workspace.documents[member.index])
            found.append(
                moved(piece, contours(body, [piece.motion.inverse().carried(plane)], halfspaces(piece), OUTSET))
            )
        ends = np.concatenate([np.zeros((0, 2, 3)), *found])
        return [lines(ends, palette().accent, 0.95, px(2.4) * scale, 0.4)]

    def slices(
        self, planes: Sequence[Plane], colours: Sequence[str], pieces: Sequence[PlacedPiece], scale: float
    ) -> list[Lines]:
        """Lines of planes of object space on the active object's pieces, each plane in its colour."""
        if not planes:
            return []
        result, body = [], self.body_of(self.workspace.document)
        kept, self._slices = self._slices, {}
        for plane, colour in zip(planes, colours, strict=True):
            found = []
            for piece in pieces:
                if piece.visible:
                    key = (id(body), plane, piece.cells)
                    ends = kept.get(key)
                    self._slices[key] = contours(body, [plane], halfspaces(piece), OUTSET) if ends is None else ends
                    found.append(moved(piece, self._slices[key]))
            ends = np.concatenate([np.zeros((0, 2, 3)), *found])
            result.append(lines(ends, colour, 0.95, px(1.6) * scale, 0.15))
        return result

    def sheets(self) -> list[Sheet]:
        """The active section plane as a translucent sheet."""
        solid, cut = self.workspace.solid, self._active_section()
        if cut is None:
            return []
        plane = cut.plane(cut.parts[0])
        e1, e2, n = frame(plane.normal)
        foot = solid.centre - n * float(plane.distance(solid.centre))
        side = 1.1 * solid.radius
        corners = np.stack([foot + side * (a * e1 + b * e2) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])
        return [Sheet(corners, (*rgb(palette().text), 0.05), hidden=0.0)]

    def _active_section(self) -> Cut | None:
        workspace = self.workspace
        if (
            workspace.active_cut is None
            or workspace.tool in ("knife", "blade")
            or workspace.atoms is None
            or workspace.mode == "capture"
        ):
            return None
        cut = workspace.document.cut(workspace.active_cut)
        return cut if cut.kind == "section" and cut.on else None

    def body_of(self, document: Document) -> Body:
        """The body of an object as it is shown: that of the solid, or what the capture encloses."""
        workspace, number = self.workspace, document.number
        loaded, solid = workspace.loaded.get(number), workspace.solid_of(document)
        atoms = None if loaded is None else loaded.atoms
        key = (workspace.geometry_version, atoms is None, id(solid))
        if number not in self._bodies or self._bodies[number][0] != key:
            body = body_of_shell(solid.points) if atoms is None else body_of_atoms(atoms)
            self._bodies[number] = (key, body)
        return self._bodies[number][1]

    def _of(self, family: Family, piece: PlacedPiece, own: bool) -> NDArray[np.float64]:
        """(S, 2, 3). Lines of a family on one piece, or of its own plane, in object space."""
        body, place = self.body_of(self.workspace.document), (family.kind, piece.key, own)
        key = (replace(family, exemplars=(), prompt="", marks=()), piece.cells, id(body), self.workspace.up)
        cached = self._families.get(place)
        if cached is None or cached[0] != key:
            planes = family.planes(body, np.asarray(self.workspace.up, np.float64))
            middle = len(planes) // 2 if family.kind in ("horizontal", "parallel") else 0
            chosen = [planes[middle]] if own else planes[:: max(1, -(-len(planes) // MOST))]
            cached = (key, contours(body, chosen, halfspaces(piece), OUTSET))
            self._families[place] = cached
        return cached[1]


def halfspaces(piece: PlacedPiece) -> list[tuple[Plane, ...]]:
    """The half-spaces of each cell of a piece."""
    return [cell.planes for cell in piece.cells]


def moved(piece: PlacedPiece, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """(S, 2, 3). Lines in object space, moved along with a piece."""
    return piece.motion.apply(ends.reshape(-1, 3)).reshape(ends.shape)


def lines(ends: NDArray[np.float64], colour: str, alpha: float, width: float, hidden: float) -> Lines:
    """The renderer's lines, in a colour '#RRGGBB'. `width`: in pixels. `hidden`: opacity behind the object."""
    c = rgba(colour)
    return Lines(ends, (c.x, c.y, c.z, alpha), width, hidden)
