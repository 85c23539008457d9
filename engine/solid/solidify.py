"""Turns a hollow capture into a solid of atoms, still without interior colours.

The trainer and the window both begin here and must agree atom by atom, or the window could not show the colours of a
training in progress.
"""

from __future__ import annotations

from dataclasses import replace

from engine.scene.atoms import Atoms
from engine.scene.gather import gathered
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.solid.atomise import Atomised, atomise
from engine.solid.fill import fill
from engine.solid.find_body import Enclosure, find_body
from engine.solid.visible_skin import out_to_front

__all__ = ["atomise_surface", "find_enclosure", "solidify"]

BODY_CELLS = 128
"""Least number of cells along the longest side of the grid on which the body is found; its depth is accurate to a
fraction of a cell."""

MOST_GAUSSIANS = 500_000
"""Gaussians above which a capture is gathered, and about how many small ones are then left: the skin then has cells of
a 400th of the object's longest side. No ordinary capture is as large."""


def find_enclosure(gaussians: Gaussians, cells: int, name: str) -> Enclosure:
    """The body that a capture encloses, fine enough for `cells` atoms along its longest side.

    A very large capture is gathered first (engine.scene.gather), so that its shell has about MOST_GAUSSIANS.
    Raises InputError, which begins with `name`, if it encloses nothing.
    """
    shown = gathered(gaussians, MOST_GAUSSIANS)
    enclosure = find_body(shown, max(BODY_CELLS, cells), name)
    if shown is gaussians:
        return enclosure
    note = f"{len(gaussians):,} Gaussians are more than a solid can show: they were gathered into {len(shown):,}"
    return replace(enclosure, notes=(note, *enclosure.notes))


def atomise_surface(enclosure: Enclosure, cells: int, tolerance: float) -> tuple[Atomised, float]:
    """The body's surface atoms (engine.solid.atomise), and their pitch: the body's longest side over `cells`."""
    low, high = enclosure.body.bounds()
    pitch = float((high - low).max()) / cells
    return atomise(enclosure, pitch, tolerance), pitch


def solidify(enclosure: Enclosure, cells: int, tolerance: float, seed: int) -> tuple[Atoms, Body]:
    """The body's surface atoms with an even grey interior, and the body that it fills: out to the front that the atoms
    show. Bit-equal for the same input."""
    surface, pitch = atomise_surface(enclosure, cells, tolerance)
    body = out_to_front(enclosure.body, surface.atoms, pitch)
    return Atoms(surface.atoms, fill(body, pitch, seed), pitch), body
