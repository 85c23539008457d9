"""Atoms on the GPU: a buffer of geometry and one of colours for each store."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.culling.store import Ellipsoids, Spheres

__all__ = ["Buffers", "Streams"]

Streams = tuple[tuple[moderngl.Buffer, dict[str, int]], ...]
"""Interleaved buffers, each with its attributes and their numbers of floats."""


@dataclass
class _Uploaded:
    """A store's buffers on the GPU."""

    store: Ellipsoids | Spheres
    geometry: moderngl.Buffer
    colours: moderngl.Buffer
    version: int


class Buffers:
    """Uploads stores when they are first drawn, and their colours again when they have changed."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._uploads: dict[int, _Uploaded] = {}

    def streams(self, store: Ellipsoids | Spheres, flat: bool = False) -> Streams:
        """The buffers of a store; `flat` leaves out the colours that depend on the view."""
        uploaded = self._upload(store)
        if isinstance(store, Spheres):
            return (uploaded.geometry, {"mean": 3, "sigma": 1}), (uploaded.colours, {"rgb": 3})
        floats = 4 * store.vectors
        colours = {"dc": 3, "rest": floats - 3} if flat else {"sh": floats}
        return (uploaded.geometry, {"mean": 3, "scale": 3, "quat": 4}), (uploaded.colours, colours)

    def _upload(self, store: Ellipsoids | Spheres) -> _Uploaded:
        geometry, colours = store.arrays
        uploaded = self._uploads.get(id(store))
        if uploaded is None:
            uploaded = _Uploaded(store, self._buffer(geometry), self._buffer(colours), store.version)
            self._uploads[id(store)] = uploaded
        elif uploaded.version != store.version:
            uploaded.colours.write(colours)
            uploaded.version = store.version
        return uploaded

    def _buffer(self, rows: NDArray[np.float32]) -> moderngl.Buffer:
        data: Any = rows
        return self.ctx.buffer(data) if len(rows) else self.ctx.buffer(reserve=4 * rows.shape[1])

    def release(self) -> None:
        """Frees all buffers."""
        for uploaded in self._uploads.values():
            uploaded.geometry.release()
            uploaded.colours.release()
        self._uploads.clear()
