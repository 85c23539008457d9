"""An object of atoms as the renderers draw it: in chunks, relative to its centre, with the splats of each mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.render.culling.backface import backface_culling
from engine.render.culling.boundary import boundary_atoms
from engine.render.culling.store import Ellipsoids, Spheres
from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.constants import EPSILON_PITCHES

__all__ = ["Drawable", "reach_of"]

Float = NDArray[np.float32]

BOUNDARY_SCALE = 1.2
"""Factor on the boundary layer's atoms if there is no skin: the core of a splat (1.48 sigma, `CORE_Q`) then reaches
1.78 sigma: past the middle of a lattice cell, 1.41 sigma away, by nearly the 0.4 sigma of the jitter."""


def reach_of(atoms: Atoms) -> tuple[float, float]:
    """Radius around the middle of the bounds that holds all of an object, splats included, and radius of the range of
    depths, world units."""
    centre, widest = atoms.bounds.astype(np.float64).mean(0), _widest(atoms)
    both = (atoms.surface.means, atoms.interior.means)
    far = max(float(np.linalg.norm(means - centre, axis=1).max(initial=0)) for means in both)
    # Depths extend to the corners of a splat's quad, a factor of sqrt(2), and the layer lies in front.
    return far + 3 * widest, far + 4.5 * widest + 2 * EPSILON_PITCHES * atoms.pitch


def _widest(atoms: Atoms) -> float:
    """Largest standard deviation, world units."""
    return max(float(atoms.surface.scales.max(initial=0)), float(atoms.interior.sigmas.max(initial=0)))


class Drawable:
    """Surface and interior atoms in separate stores."""

    def __init__(self, atoms: Atoms) -> None:
        bounds = atoms.bounds.astype(np.float64)
        skin, inside = atoms.surface, atoms.interior
        widest = _widest(atoms)
        self.centre = bounds.mean(0)
        """(3,). Everything is drawn relative to it, so that scenes far from the origin keep their digits."""
        self.reach, self.radius = reach_of(atoms)
        """Radius of the object around the centre, splats included, and of the range of depths, world units."""
        half = (bounds[1] - bounds[0]) / 2 + 3 * widest
        self.box = -half, half
        """Corners (3,) of the object's box, splats included, relative to the centre."""
        self.pitch = float(atoms.pitch)
        culling = backface_culling(atoms)
        culling = replace(culling, low=culling.low - self.centre)
        self.skin = Ellipsoids(self._shifted(skin.means), skin.scales, skin.quats, skin.sh, culling)
        self.inside = Spheres(self._shifted(inside.means), inside.sigmas, inside.rgb)
        self.atoms = atoms
        """The atoms it was made from; their colours may have been replaced since."""
        self._boundary: Ellipsoids | None = None
        self._boundary_rows = np.zeros(0, np.intp)
        self._rgb = inside.rgb

    def _shifted(self, means: Float) -> Float:
        return (means.astype(np.float64) - self.centre).astype(np.float32)

    def _as_splats(self, rows: NDArray[np.integer]) -> Ellipsoids:
        """Interior atoms as splats of the boundary layer."""
        inside = self.atoms.interior
        unit = np.tile(np.array([1, 0, 0, 0], np.float32), (len(rows), 1))
        scales = np.repeat(np.float32(BOUNDARY_SCALE) * inside.sigmas[rows, None], 3, 1)
        return Ellipsoids(self._shifted(inside.means[rows]), scales, unit, sh.rgb_to_sh(inside.rgb[rows, None]))

    def splats(self, interior_only: bool) -> Ellipsoids:
        """The splats of the outside: the skin, or the interior's boundary layer."""
        if not interior_only:
            return self.skin
        if self._boundary is None:
            inside = self.atoms.interior
            self._boundary_rows = np.flatnonzero(boundary_atoms(inside.means, inside.sigmas))
            self._boundary = self._as_splats(self._boundary_rows)
            self._boundary.update(sh.rgb_to_sh(self._rgb[self._boundary_rows, None]))
        return self._boundary

    def update(self, sh_coefficients: Float | None, rgb: Float | None) -> None:
        """Replaces the colours of the same atoms, (S, (d+1)^2, 3) and (I, 3); None leaves them unchanged."""
        if sh_coefficients is not None:
            self.skin.update(sh_coefficients)
        if rgb is not None:
            self._rgb = rgb
            self.inside.update(rgb)
            if self._boundary is not None:
                self._boundary.update(sh.rgb_to_sh(rgb[self._boundary_rows, None]))
