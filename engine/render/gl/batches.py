"""Batches of records on the GPU: written by transform feedback, then drawn as quads."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.render.gl.context import Growing, layout

__all__ = ["Batch", "Pool"]

CORNERS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]], np.float32)


class Batch:
    """Records of one kind."""

    def __init__(self, ctx: moderngl.Context, corners: moderngl.Buffer) -> None:
        self.ctx = ctx
        self.records = Growing(ctx)
        self.corners = corners
        self.count = 0
        self._arrays: dict[moderngl.Program, moderngl.VertexArray] = {}

    def fill(self, array: moderngl.VertexArray, fields: dict[str, int], first: int, count: int) -> None:
        """Runs vertices first..first+count of the array through its program and stores the output."""
        if self.records.reserve(4 * sum(fields.values()) * count):
            self._release_arrays()
        self.count = count
        if count:
            array.transform(self.records.buffer, moderngl.POINTS, vertices=count, first=first)

    def draw(self, program: moderngl.Program, fields: dict[str, int]) -> None:
        """Draws a quad for each record with this program."""
        if not self.count:
            return
        if program not in self._arrays:
            records = layout(program, self.records.buffer, fields, instanced=True)
            self._arrays[program] = self.ctx.vertex_array(program, [records, (self.corners, "2f", "corner")])
        self._arrays[program].render(moderngl.TRIANGLE_STRIP, vertices=4, instances=self.count)

    def _release_arrays(self) -> None:
        for array in self._arrays.values():
            array.release()
        self._arrays.clear()

    def release(self) -> None:
        """Frees the buffer and its vertex arrays."""
        self._release_arrays()
        self.records.release()


class Pool:
    """Batches that are reused from frame to frame, and the list of indices that fills them."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self.indices = Growing(ctx)
        self.corners = ctx.buffer(CORNERS)
        self._batches: list[Batch] = []
        self._taken = 0
        self._sources: dict[Any, moderngl.VertexArray] = {}

    def begin(self) -> None:
        """Begins a new frame: all batches are free again."""
        self._taken = 0

    def take(self) -> Batch:
        """A batch that is not yet used in this frame."""
        if self._taken == len(self._batches):
            self._batches.append(Batch(self.ctx, self.corners))
        self._taken += 1
        return self._batches[self._taken - 1]

    def write_indices(self, rows: NDArray[np.uint32]) -> None:
        """Writes the indices that `source` arrays read from now on."""
        if self.indices.write(rows):
            self.clear_sources()

    def source(
        self, program: moderngl.Program, *streams: tuple[moderngl.Buffer, dict[str, int]]
    ) -> moderngl.VertexArray:
        """The indexed array of these interleaved buffers under this program."""
        key = (program, *(buffer for buffer, _ in streams))
        if key not in self._sources:
            content = [layout(program, buffer, fields) for buffer, fields in streams]
            content = [entry for entry in content if len(entry) > 2]
            self._sources[key] = self.ctx.vertex_array(program, content, self.indices.buffer)
        return self._sources[key]

    def clear_sources(self) -> None:
        """Frees the vertex arrays over atoms, when their buffers or the index buffer have been replaced."""
        for array in self._sources.values():
            array.release()
        self._sources.clear()

    def clear(self) -> None:
        """Frees the batches: another object needs batches of other sizes."""
        self.clear_sources()
        for batch in self._batches:
            batch.release()
        self._batches.clear()
        self._taken = 0

    def release(self) -> None:
        """Frees everything."""
        self.clear()
        self.indices.release()
        self.corners.release()
