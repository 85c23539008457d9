"""Compiles and loads the render kernels before the window needs them, by drawing small frames.

With software OpenGL the solid is drawn by kernels that are compiled at their first use and cached on disk. In the
window that would cause a halt of half a minute on the first day; in the process that loads the scene nobody notices.
Loading the kernels from disk takes most of a second in each process; the window does it in a thread.
"""

from __future__ import annotations

import contextlib
from functools import cache

import numpy as np

from engine.render.cpu.software import SoftwareMode
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.drawable import Drawable
from engine.render.culling.groups import group_pieces
from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import orbit
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.scene.rotations import facing

__all__ = ["load_kernels", "warm_up"]

SIZE = 256
"""Pixels along a side: enough that atoms are wider than pixels, as they mostly are in the window."""

PITCH = 0.1
"""Spacing of the ball's atoms, in radii of the ball."""


PLANE = Plane.of((0, 0, 1), 0)

CAMERA = orbit([0, 0, 0], [0, 0, 1], 30, 40, 4, SIZE, SIZE)


@cache
def warm_up() -> None:
    """Draws a ball whole, cut open and in interior mode, once per process. Does nothing without windowless OpenGL."""
    with contextlib.suppress(GLMissing), Renderer() as renderer:
        renderer.set_atoms(ball())
        for pieces in ((Piece(()),), halves()):
            for exact in (True, False, False):  # a plane's grid is built when the plane is drawn again
                renderer.render(CAMERA, pieces, exact=exact, light=True)
        renderer.render(CAMERA, (Piece(()),), mode="interior")
        renderer.read()


def load_kernels() -> None:
    """Draws the same ball without OpenGL, in any thread."""
    software, solids = SoftwareMode(), [Drawable(ball())]
    for pieces in ((Piece(()),), halves()):
        for exact in (True, False, False):
            options = DrawOptions(interior_only=False, light=True, exact=exact, level=0, cull=True)
            software.draw(solids, CAMERA, pieces, group_pieces(pieces), np.ones(3), options)
    software.release()


def halves() -> tuple[Piece, Piece]:
    """The two sides of a cut through the middle, one of them moved away."""
    apart = np.eye(4)
    apart[2, 3] = 1.0
    return Piece((PLANE,)), Piece((PLANE.flipped(),), apart)


def ball() -> Atoms:
    """A solid ball around the origin, radius 1."""
    axis = np.arange(-1, 1, PITCH) + PITCH / 2
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    lattice = lattice[np.linalg.norm(lattice, axis=1) < 0.95]
    n = 4000
    z, turn = np.linspace(-1, 1, n), np.pi * (1 + 5**0.5) * np.arange(n)
    out = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    skin = SurfaceAtoms(
        out.astype(np.float32),
        np.tile(np.array([0.6, 0.6, 0.1], np.float32) * PITCH, (n, 1)),
        facing(out).astype(np.float32),
        np.zeros((n, 1, 3), np.float32),
    )
    m = len(lattice)
    inside = InteriorAtoms(lattice, np.full(m, PITCH / 2, np.float32), np.full((m, 3), 0.5, np.float32))
    return Atoms(skin, inside, PITCH)
