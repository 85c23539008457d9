"""From a hollow capture to a solid of atoms without colours inside: what the trainer and the window both begin with.

They must agree atom by atom, or the window could not show the colours that a training has reached.
"""

from __future__ import annotations

from engine.scene.atoms import Atoms
from engine.scene.gaussians import Gaussians
from engine.solid.atomise import Atomised, atomise
from engine.solid.fill import fill
from engine.solid.find_body import Enclosure, find_body

__all__ = ["enclosed", "skin_of", "solidify"]

BODY_CELLS = 128
"""Cells along the longest side of the grid on which the body is found; its depth is exact to a part of a cell."""


def enclosed(gaussians: Gaussians, cells: int, name: str) -> Enclosure:
    """The body that a capture encloses, for atoms of which `cells` lie along its longest side.

    Raises InputError, which begins with `name`, where it encloses nothing.
    """
    return find_body(gaussians, max(BODY_CELLS, cells), name)


def skin_of(gaussians: Gaussians, enclosure: Enclosure, cells: int) -> tuple[Atomised, float]:
    """The body's skin in atoms, and their pitch: `cells` of them lie along the body's longest side."""
    low, high = enclosure.body.bounds()
    pitch = float((high - low).max()) / cells
    return atomise(gaussians, pitch, enclosure), pitch


def solidify(gaussians: Gaussians, enclosure: Enclosure, cells: int, seed: int) -> Atoms:
    """The body's skin and an even grey inside. Bit-equal for the same input."""
    skin, pitch = skin_of(gaussians, enclosure, cells)
    return Atoms(skin.atoms, fill(enclosure.body, pitch, seed, skin.atoms), pitch)
