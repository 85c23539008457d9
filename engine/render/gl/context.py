"""The OpenGL context, its compiled programs, and buffers that grow."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.render.defines import CONSTANTS
from shaders import source

__all__ = ["GLMissing", "Growing", "Programs", "layout", "offscreen_context", "write_uniforms"]


class GLMissing(InputError):
    """OpenGL 3.3 is not available without a window; the message names what to install."""


def offscreen_context() -> moderngl.Context:
    """A context without a window, through EGL. Raises GLMissing if there is none."""
    try:
        options: dict[str, Any] = {"require": 330, "backend": "egl"}
        return moderngl.create_standalone_context(**options)
    except Exception as error:  # the loaders raise all kinds: OSError, RuntimeError, plain Exception
        raise GLMissing(f"no offscreen OpenGL 3.3 (install libegl1 and libgl1-mesa-dri): {error}") from error


class Programs:
    """Programs by file names and defines, compiled on first use."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._compiled: dict[tuple[Any, ...], moderngl.Program] = {}

    def get(
        self,
        vertex: str,
        fragment: str | None,
        defines: Mapping[str, int | float] | None = None,
        varyings: Iterable[str] = (),
    ) -> moderngl.Program:
        """The program of these files of `shaders`; a define of 0 is left out."""
        given = {name: value for name, value in (defines or {}).items() if value}
        names = tuple(varyings)
        key = (vertex, fragment, names, tuple(sorted(given.items())))
        if key not in self._compiled:
            self._compiled[key] = self.ctx.program(
                vertex_shader=source(vertex, CONSTANTS | given),
                fragment_shader=source(fragment, CONSTANTS | given) if fragment else None,
                varyings=names,
            )
        return self._compiled[key]

    def release(self) -> None:
        """Frees the programs."""
        for program in self._compiled.values():
            program.release()
        self._compiled.clear()


def write_uniforms(program: moderngl.Program, values: dict[str, Any]) -> None:
    """Sets the uniforms that the program has; its compiler may have dropped those that a variant does not use.

    Arrays are written as float32; a texture is bound to the unit in its key `name@unit`.
    """
    for key, value in values.items():
        name, _, unit = key.partition("@")
        member = program.get(name, None)
        if not isinstance(member, moderngl.Uniform):
            continue
        if unit:
            value.use(int(unit))
            member.value = int(unit)
        elif isinstance(value, np.ndarray):
            member.write(np.ascontiguousarray(value, np.float32).tobytes())
        else:
            member.value = value


class Growing:
    """A GPU buffer that is rewritten every frame and only ever grows."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self.buffer = ctx.buffer(reserve=1 << 12, dynamic=True)

    def reserve(self, size: int) -> bool:
        """Makes the buffer hold `size` bytes; True if it was replaced, so that vertex arrays over it must be too."""
        if size <= self.buffer.size:
            return False
        capacity = -(-max(size, 3 * self.buffer.size // 2) // 4096) * 4096  # transform feedback needs whole words
        self.buffer.release()
        self.buffer = self.ctx.buffer(reserve=capacity, dynamic=True)
        return True

    def write(self, data: NDArray[Any]) -> bool:
        """Replaces the content; returns what `reserve` returns."""
        fresh = self.reserve(data.nbytes)
        if not fresh:
            self.buffer.orphan()  # the driver need not wait for the last frame's draws
        if data.nbytes:
            self.buffer.write(np.ascontiguousarray(data))
        return fresh

    def release(self) -> None:
        """Frees the buffer."""
        self.buffer.release()


def layout(
    program: moderngl.Program, buffer: moderngl.Buffer, fields: dict[str, int], instanced: bool = False
) -> tuple[Any, ...]:
    """The entry of a vertex array for interleaved floats: `fields` are attributes in order, with their numbers of
    floats. Those that the program does not use (its compiler may drop attributes) are skipped.
    """
    names = [name for name in fields if program.get(name, None) is not None]
    parts = [f"{n}f" if name in names else f"{4 * n}x" for name, n in fields.items()]
    return (buffer, " ".join(parts) + ("/i" if instanced else ""), *names)
