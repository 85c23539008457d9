"""Compiles the render kernels before the window needs them, by drawing one small frame.

With software OpenGL the solid is drawn by kernels that are compiled at their first use and cached on disk. That would
stop the window for half a minute on the first day; in the process that loads the scene nobody notices.
"""

from __future__ import annotations

import contextlib
from functools import cache

import numpy as np

from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import orbit
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["warm_up"]

SIZE = 256
"""Pixels of a side: enough that atoms are wider than pixels, as they mostly are in the window."""

PITCH = 0.1
"""Spacing of the ball's atoms, in its radii."""


@cache
def warm_up() -> None:
    """Draws a ball whole, cut open and in interior mode, once per process. Does nothing without windowless OpenGL."""
    axis = np.arange(-1, 1, PITCH) + PITCH / 2
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    lattice = lattice[np.linalg.norm(lattice, axis=1) < 0.95]
    n = 4000
    z, turn = np.linspace(-1, 1, n), np.pi * (1 + 5**0.5) * np.arange(n)
    out = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    half = out + np.array([0, 0, 1 + 1e-6])  # turns z to the normal
    quats = np.column_stack([np.zeros(n), half / np.linalg.norm(half, axis=1, keepdims=True)])
    skin = SurfaceAtoms(
        out.astype(np.float32),
        np.tile(np.array([0.6, 0.6, 0.1], np.float32) * PITCH, (n, 1)),
        quats.astype(np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    m = len(lattice)
    inside = InteriorAtoms(lattice, np.full(m, PITCH / 2, np.float32), np.full((m, 3), 0.5, np.float32))
    plane = Plane.of((0, 0, 1), 0)
    apart = np.eye(4)
    apart[2, 3] = 1.0
    with contextlib.suppress(GLMissing), Renderer() as renderer:
        renderer.set_atoms(Atoms(skin, inside, PITCH))
        for pieces in ((Piece(()),), (Piece((plane,)), Piece((plane.flipped(),), apart))):
            for exact in (True, False, False):  # a plane's grid is built when the plane is drawn again
                renderer.render(orbit([0, 0, 0], [0, 0, 1], 30, 40, 4, SIZE, SIZE), pieces, exact=exact, light=True)
        renderer.render(orbit([0, 0, 0], [0, 0, 1], 30, 40, 4, SIZE, SIZE), (Piece(()),), mode="interior")
        renderer.read()
