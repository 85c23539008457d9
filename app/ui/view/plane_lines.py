"""Lines on the object: where the planes of families stand, and where the knife would go."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.model.document import Key
from app.model.outline import body_of_atoms, body_of_shell, contours
from app.model.pieces import PlacedPiece
from app.session.session import Session
from app.ui.theme import palette, px, rgba
from engine.render.gl.overlay import Lines
from engine.scene.grid import Body
from engine.scene.plane import Plane
from training.families import Family

__all__ = ["PlaneLines"]

MOST = 40
"""Planes of a family that are drawn: of more, every second or third."""

OUTSET = 0.6
"""Cells by which lines stand off the skin, which is a little uneven and would swallow parts of them."""


class PlaneLines:
    """Lines of one session's object; they are found anew only where the object or a family has changed."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._body: tuple[object, Body] | None = None
        self._families: dict[tuple[str, Key], tuple[object, NDArray[np.float64]]] = {}

    def families(self, kinds: Collection[str], pieces: Sequence[PlacedPiece], scale: float) -> list[Lines]:
        """The planes of these kinds as they will be trained, on pieces as they lie, on a screen of `scale` pixels a
        unit."""
        p = palette()
        result = []
        for family in self.session.document.families:
            if family.kind in kinds:
                parts = [moved(piece, self._of(family, piece)) for piece in pieces if piece.visible]
                ends = np.concatenate([np.zeros((0, 2, 3)), *parts])
                colour = p.text if family.kind == "horizontal" else p.curve
                result.append(lines(ends, colour, 0.75, px(1.2) * scale, 0.1))
        return result

    def cut(self, plane: Plane, pieces: Sequence[PlacedPiece], scale: float) -> list[Lines]:
        """Where a plane of the world meets pieces."""
        found = [
            moved(piece, contours(self.body, [piece.motion.inverse().carried(plane)], piece.planes, OUTSET))
            for piece in pieces
        ]
        ends = np.concatenate([np.zeros((0, 2, 3)), *found])
        return [lines(ends, palette().accent, 0.95, px(2.4) * scale, 0.4)]

    @property
    def body(self) -> Body:
        """Of what is shown: the solid, or what a capture encloses."""
        session = self.session
        key = (session.geometry_version, session.atoms is None, id(session.solid))
        if self._body is None or self._body[0] != key:
            atoms = session.atoms
            body = body_of_shell(session.solid.points) if atoms is None else body_of_atoms(atoms)
            self._body = (key, body)
        return self._body[1]

    def _of(self, family: Family, piece: PlacedPiece) -> NDArray[np.float64]:
        """(S, 2, 3). In the object's space."""
        body, place = self.body, (family.kind, piece.key)
        key = (replace(family, exemplars=(), prompt=""), piece.planes, id(body), self.session.up)
        kept = self._families.get(place)
        if kept is None or kept[0] != key:
            planes = family.planes(body, np.asarray(self.session.up, np.float64))
            kept = (key, contours(body, planes[:: max(1, -(-len(planes) // MOST))], piece.planes, OUTSET))
            self._families[place] = kept
        return kept[1]


def moved(piece: PlacedPiece, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """(S, 2, 3). Where lines of the object's space lie with a piece."""
    return piece.motion.apply(ends.reshape(-1, 3)).reshape(ends.shape)


def lines(ends: NDArray[np.float64], colour: str, alpha: float, width: float, hidden: float) -> Lines:
    """In a colour '#RRGGBB'."""
    c = rgba(colour)
    return Lines(ends, (c.x, c.y, c.z, alpha), width, hidden)
