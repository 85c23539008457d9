"""Lines on the object where planes intersect it: those of families, and the one of the knife's stroke."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.model.document import Key
from app.model.outline import body_of_atoms, body_of_shell, contours
from app.model.pieces import PlacedPiece
from app.session.workspace import Workspace
from app.ui.theme import palette, px, rgba
from engine.render.gl.overlay import Lines
from engine.scene.grid import Body
from engine.scene.plane import Plane
from training.families import Family

__all__ = ["PlaneLines"]

MOST = 40
"""Planes of a family that are drawn; of more, only every second or third."""

OUTSET = 0.6
"""Cells between the skin and the lines: on the skin itself, which is slightly uneven, parts of them would be hidden."""


class PlaneLines:
    """Lines on the workspace's object, found again only if the object or a family has changed."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._body: tuple[object, Body] | None = None
        self._families: dict[tuple[str, Key], tuple[object, NDArray[np.float64]]] = {}

    def families(self, kinds: Collection[str], pieces: Sequence[PlacedPiece], scale: float) -> list[Lines]:
        """The planes that training uses for these kinds of families, on pieces where they are placed.

        `scale`: pixels of the screen for each of the window's units.
        """
        p = palette()
        result = []
        for family in self.workspace.document.families:
            if family.kind in kinds:
                parts = [moved(piece, self._of(family, piece)) for piece in pieces if piece.visible]
                ends = np.concatenate([np.zeros((0, 2, 3)), *parts])
                colour = p.text if family.kind == "horizontal" else p.curve
                result.append(lines(ends, colour, 0.75, px(1.2) * scale, 0.1))
        return result

    def cut(self, plane: Plane, pieces: Sequence[PlacedPiece], scale: float) -> list[Lines]:
        """Where a plane in world space intersects pieces."""
        found = [
            moved(piece, contours(self.body, [piece.motion.inverse().carried(plane)], piece.planes, OUTSET))
            for piece in pieces
        ]
        ends = np.concatenate([np.zeros((0, 2, 3)), *found])
        return [lines(ends, palette().accent, 0.95, px(2.4) * scale, 0.4)]

    @property
    def body(self) -> Body:
        """The body of the object that is shown: of the solid, or what the capture encloses."""
        workspace = self.workspace
        key = (workspace.geometry_version, workspace.atoms is None, id(workspace.solid))
        if self._body is None or self._body[0] != key:
            atoms = workspace.atoms
            body = body_of_shell(workspace.solid.points) if atoms is None else body_of_atoms(atoms)
            self._body = (key, body)
        return self._body[1]

    def _of(self, family: Family, piece: PlacedPiece) -> NDArray[np.float64]:
        """(S, 2, 3). Lines of a family on one piece, in object space."""
        body, place = self.body, (family.kind, piece.key)
        key = (replace(family, exemplars=(), prompt=""), piece.planes, id(body), self.workspace.up)
        cached = self._families.get(place)
        if cached is None or cached[0] != key:
            planes = family.planes(body, np.asarray(self.workspace.up, np.float64))
            cached = (key, contours(body, planes[:: max(1, -(-len(planes) // MOST))], piece.planes, OUTSET))
            self._families[place] = cached
        return cached[1]


def moved(piece: PlacedPiece, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """(S, 2, 3). Lines of object space, moved with a piece."""
    return piece.motion.apply(ends.reshape(-1, 3)).reshape(ends.shape)


def lines(ends: NDArray[np.float64], colour: str, alpha: float, width: float, hidden: float) -> Lines:
    """The renderer's lines, in a colour '#RRGGBB'. `width` in pixels; `hidden`: opacity behind the object."""
    c = rgba(colour)
    return Lines(ends, (c.x, c.y, c.z, alpha), width, hidden)
