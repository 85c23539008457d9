"""Interior atoms that fill a body (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from engine.scene.atoms import InteriorAtoms, SurfaceAtoms
from engine.scene.grid import Body
from engine.solid.octree import COARSEST, leaf_levels
from engine.solid.skin_holes import coverage_at, inwards

Float = NDArray[np.float32]

__all__ = ["Colours", "fill"]

UNDER_SKIN = 0.75
"""Sigmas. Least depth of an interior atom: its half height, 1.18 sigmas, then stays behind the skin's own atoms."""

JITTER = 0.2
"""Pitches. Hides the lattice from cuts along it, and leaves the sum of the weights above half everywhere inside."""

COVERED = 0.25
"""Greatest weight of a surface atom at the skin above an interior atom, from which it cannot be seen."""


Colours = Callable[[NDArray[np.floating]], Float]
"""Colours (N, 3) at world points (N, 3), also a little outside of the body."""


def fill(
    body: Body, pitch: float, seed: int = 0, surface: SurfaceAtoms | None = None, colours: Colours | None = None
) -> InteriorAtoms:
    """Spheres on a cubic lattice, one for each cell whose centre lies inside the body; sigma is half the spacing.

    Without `colours` they are grey and all alike: count times pitch^3 is the body's volume, and the weights add up to
    LATTICE_DENSITY (their mean). With `colours` they take them, and where those are even one sphere
    stands for 2^3, 4^3 or 8^3 cells (engine.solid.octree), which leaves the sum of the weights as it is.
    Atoms near the skin are pushed under it. With `surface`, those above which its atoms leave a hole come first and
    are counted as exposed; without, none is.
    """
    assert pitch > 0, pitch
    low, high = body.bounds()
    whole = 2**COARSEST  # with colours or without: an adaptive inside then stands on the uniform one's cells
    counts = -(-(np.ceil((high - low) / pitch).astype(int) + 2) // whole) * whole
    start = (low + high) / 2 - counts * pitch / 2
    solid = np.empty(tuple(counts), bool)
    rgb = None if colours is None else np.empty((*counts, 3), np.float32)
    for layer in range(counts[0]):  # one layer at a time: a grid of points takes six times the grid's memory
        cells = np.stack(np.meshgrid([layer], *map(np.arange, counts[1:]), indexing="ij"), -1)
        centres = start + (cells[0] + 0.5) * pitch
        solid[layer] = body.at(centres) > 0
        if rgb is not None and colours is not None:
            rgb[layer] = colours(centres.reshape(-1, 3)).reshape(*centres.shape)
    levels = np.zeros(solid.shape, np.int8) if rgb is None else leaf_levels(rgb, solid)
    rng = np.random.default_rng(seed)
    means, sigmas = [], []
    for level in range(int(levels.max(initial=0)) + 1):
        size = 2**level
        corners = np.argwhere(((levels == level) & solid)[::size, ::size, ::size]) * size
        centres = start + (corners + size / 2) * pitch
        means.append(centres + rng.uniform(-JITTER, JITTER, centres.shape) * size * pitch)
        sigmas.append(np.full(len(centres), size * pitch / 2, np.float32))
    points, sigma = np.concatenate(means), np.concatenate(sigmas)
    points = _pushed_under(body, points, UNDER_SKIN * sigma)
    exposed = 0
    if surface is not None and len(points):
        seen = _seen(body, points, sigma, pitch, surface)
        points, sigma = np.concatenate([points[seen], points[~seen]]), np.concatenate([sigma[seen], sigma[~seen]])
        exposed = int(seen.sum())
    colour = np.full(points.shape, 0.5, np.float32) if colours is None else colours(points).astype(np.float32)
    return InteriorAtoms(points.astype(np.float32), sigma, colour, exposed)


def _pushed_under(body: Body, points: NDArray[np.float64], depth: Float) -> NDArray[np.float64]:
    """The points (N, 3), those nearer to the skin than their `depth` (N,) moved inwards as far as the body allows."""
    points = points.copy()
    for _ in range(3):
        short = np.flatnonzero(body.at(points) < depth)
        if not len(short):
            break
        missing = depth[short] - body.at(points[short])
        points[short] += inwards(body, points[short]) * missing[:, None]
    return points


def _seen(
    body: Body, means: NDArray[np.float64], sigmas: Float, pitch: float, surface: SurfaceAtoms
) -> NDArray[np.bool_]:
    """(N,). Atoms in the outermost layer where the surface atoms do not cover the skin."""
    seen = np.zeros(len(means), bool)
    depth = body.at(means)
    outer = np.flatnonzero(depth < 2 * sigmas)
    into = inwards(body, means[outer])
    skin = means[outer] - into * depth[outer, None]
    seen[outer] = coverage_at(surface, skin, -into, pitch) < COVERED
    return seen
