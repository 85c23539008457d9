"""From a hollow capture to a solid of atoms without colours inside: what the trainer and the window both begin with.

They must agree atom by atom, or the window could not show the colours that a training has reached.
"""

from __future__ import annotations

from dataclasses import dataclass

from engine.atomise import Atomised, atomise
from engine.atoms import Atoms
from engine.body import Body
from engine.fill import Found, fill, find_body
from engine.gaussians import Gaussians

__all__ = ["Solid", "enclosed", "solidify"]

BODY_CELLS = 128
"""Cells along the longest side of the grid on which the body is found; its depth is exact to a part of a cell."""


@dataclass(frozen=True)
class Solid:
    """Atoms of a whole object, and what became of its Gaussians."""

    atoms: Atoms
    skin: Atomised


def enclosed(gaussians: Gaussians, cells: int, name: str) -> Found:
    """The body that a capture encloses, for atoms of which `cells` lie along its longest side.

    Raises InputError, which begins with `name`, where it encloses nothing.
    """
    return find_body(gaussians, max(BODY_CELLS, cells), name)


def solidify(gaussians: Gaussians, body: Body, cells: int, seed: int) -> Solid:
    """The body's skin and inside in atoms, `cells` of them along its longest side. Bit-equal for the same input."""
    low, high = body.bounds()
    pitch = float((high - low).max()) / cells
    skin = atomise(gaussians, pitch, body)
    return Solid(Atoms(skin.atoms, fill(body, pitch, seed, skin.atoms), pitch), skin)
