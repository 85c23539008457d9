"""Atoms on the GPU: a buffer of geometry and one of colours for each store that a frame draws from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.store import Ellipsoids, Spheres

__all__ = ["Buffers", "Streams"]

Streams = tuple[tuple[moderngl.Buffer, dict[str, int]], ...]
"""Interleaved buffers, each with its attributes and how many floats they have."""


@dataclass
class _Uploaded:
    """What of a store is on the GPU."""

    store: Ellipsoids | Spheres
    geometry: moderngl.Buffer
    colours: moderngl.Buffer
    version: int


class Buffers:
    """Uploads stores when they are first drawn, and their colours when these have changed."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._held: dict[int, _Uploaded] = {}

    def streams(self, store: Ellipsoids | Spheres, flat: bool = False) -> Streams:
        """The buffers of a store; `flat`: without the colours that depend on the view."""
        held = self._upload(store)
        if isinstance(store, Spheres):
            return (held.geometry, {"mean": 3, "sigma": 1}), (held.colours, {"rgb": 3})
        floats = 4 * store.vectors
        colours = {"dc": 3, "rest": floats - 3} if flat else {"sh": floats}
        return (held.geometry, {"mean": 3, "scale": 3, "quat": 4}), (held.colours, colours)

    def _upload(self, store: Ellipsoids | Spheres) -> _Uploaded:
        geometry, colours = store.arrays
        held = self._held.get(id(store))
        if held is None:
            held = _Uploaded(store, self._buffer(geometry), self._buffer(colours), store.version)
            self._held[id(store)] = held
        elif held.version != store.version:
            held.colours.write(colours)
            held.version = store.version
        return held

    def _buffer(self, rows: NDArray[np.float32]) -> moderngl.Buffer:
        data: Any = rows
        return self.ctx.buffer(data) if len(rows) else self.ctx.buffer(reserve=4 * rows.shape[1])

    def release(self) -> None:
        """Frees all buffers."""
        for held in self._held.values():
            held.geometry.release()
            held.colours.release()
        self._held.clear()
