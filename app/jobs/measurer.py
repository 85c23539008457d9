"""Measures volume and surface area of pieces in the background."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from app.model.measure.extent import Extent, Filled, extent_of
from app.model.pieces import Cell
from engine.scene.atoms import Atoms

__all__ = ["Measurer"]


class Measurer:
    """Measures one cell at a time; results are kept while the object has the same geometry."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, "measures")
        self._running: tuple[Atoms, Cell, Future[Extent]] | None = None
        self._found: dict[Cell, Extent] = {}
        self._of: Atoms | None = None
        """The atoms that `_found` belongs to."""
        self._filled: tuple[Atoms, Filled] | None = None

    def extent(self, atoms: Atoms, cells: Sequence[Cell]) -> Extent | None:
        """The extent of cells together; None while it is not known. Never waits."""
        if self._of is None or not _same(self._of, atoms):
            self._of, self._found = atoms, {}
        if self._running is not None and self._running[2].done():
            measured, cell, future = self._running
            if _same(measured, atoms):
                self._found[cell] = future.result()
            self._running = None
        missing = [cell for cell in cells if cell not in self._found]
        if missing and self._running is None:
            self._running = (atoms, missing[0], self._worker.submit(self._measure, atoms, missing[0]))
        if missing:
            return None
        found = [self._found[cell] for cell in cells]
        return Extent(sum(e.volume for e in found), sum(e.skin for e in found), sum(e.faces for e in found))

    @property
    def busy(self) -> bool:
        """Whether something is being measured."""
        return self._running is not None

    def close(self) -> None:
        """Starts nothing more."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _measure(self, atoms: Atoms, cell: Cell) -> Extent:
        if self._filled is None or not _same(self._filled[0], atoms):
            self._filled = (atoms, Filled.of(atoms))
        return extent_of(self._filled[1], cell)


def _same(one: Atoms, other: Atoms) -> bool:
    """Whether two objects differ in nothing but colours."""
    return one.interior.means is other.interior.means and one.surface.means is other.surface.means
