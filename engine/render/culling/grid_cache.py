"""Keeps the grids of cut planes (`face_grid`) from frame to frame: what they depend on, and when they are dropped.

A grid is a texture on the graphics card and an array in the software path.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.store import Spheres

__all__ = ["GridCache", "GridKey", "grid_key"]

CACHE_BYTES = 256 << 20
"""Memory for grids that are not in the frame; the least recently used goes first."""

MOST_GRIDS = 1000
"""Most entries; a plane that allows no grid is remembered too."""

Grid = TypeVar("Grid")
GridKey = tuple[float, ...]


def grid_key(plane: NDArray[np.float64], spheres: Spheres, options: DrawOptions) -> GridKey:
    """All that the grid of a plane (4,) depends on, while the renderer holds `spheres`, as it does until `clear`."""
    return (id(spheres), *plane.tolist(), options.level, options.size)


class GridCache(Generic[Grid]):
    """Grids by their keys."""

    def __init__(self, size: Callable[[Grid], int], release: Callable[[Grid], object] = lambda grid: None) -> None:
        """`size` of a grid in bytes; `release` frees one that is dropped."""
        self._size, self._release = size, release
        self._grids: OrderedDict[GridKey, Grid | None] = OrderedDict()
        self._last: set[GridKey] = set()
        """Keys that the last frame asked for."""
        self._now: set[GridKey] = set()

    def begin(self) -> None:
        """Begins a new frame."""
        self._last, self._now = self._now, set()

    def get(self, key: GridKey, make: Callable[[], Grid | None], at_once: bool = True) -> Grid | None:
        """The grid with this key, made if it is missing; None if its plane allows none, for which `make` returns None.

        Unless `at_once`, it is only made if the last frame asked for it too, and None until then.
        """
        self._now.add(key)
        if key not in self._grids:
            if not at_once and key not in self._last:
                return None
            self._grids[key] = make()
        self._grids.move_to_end(key)
        self._evict()
        return self._grids[key]

    def clear(self) -> None:
        """Drops all grids: the atoms or their colours have changed."""
        for grid in self._grids.values():
            if grid is not None:
                self._release(grid)
        self._grids.clear()

    def _evict(self) -> None:
        total = sum(self._size(grid) for grid in self._grids.values() if grid is not None)
        for key in [key for key in self._grids if key not in self._now and key not in self._last]:
            if total <= CACHE_BYTES and len(self._grids) < MOST_GRIDS:
                return
            grid = self._grids.pop(key)
            if grid is not None:
                total -= self._size(grid)
                self._release(grid)
