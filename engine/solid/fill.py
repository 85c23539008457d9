"""Interior atoms that fill a body (paper, section 3.1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from engine.scene.atoms import InteriorAtoms
from engine.scene.grid import Body
from engine.solid.octree import COARSEST, leaf_levels
from engine.solid.skin_cover import inward_normals
from engine.threads import side_by_side

Float = NDArray[np.float32]

__all__ = ["Colours", "fill"]

UNDER_SKIN = 0.75
"""Sigmas. Least depth of an interior atom: at half height, 1.18 sigmas from its centre, it then stays behind the
surface atoms."""

JITTER = 0.2
"""Pitches. Hides the lattice in cuts along it, yet keeps the sum of the weights above half everywhere inside."""

Colours = Callable[[NDArray[np.floating]], Float]
"""Colours (N, 3) at world points (N, 3), also slightly outside the body."""


def fill(body: Body, pitch: float, seed: int = 0, colours: Colours | None = None) -> InteriorAtoms:
    """Spheres on a cubic lattice, one for each cell whose centre lies inside the body; sigma is half the spacing.

    Without `colours` all are grey and of one size: count times pitch^3 is the body's volume, and the mean sum of the
    weights is LATTICE_DENSITY. With `colours` the spheres take these, and one sphere replaces 2^3, 4^3 or 8^3 cells of
    even colour (engine.solid.octree), which leaves the sum of the weights unchanged. Atoms near the skin are pushed
    below it.
    """
    assert pitch > 0, pitch
    low, high = body.bounds()
    block = 2**COARSEST  # also without colours, so that an adaptive fill has the cells of the uniform one
    counts = -(-(np.ceil((high - low) / pitch).astype(int) + 2) // block) * block
    start = (low + high) / 2 - counts * pitch / 2
    solid = np.empty(tuple(counts), bool)
    rgb = None if colours is None else np.empty((*counts, 3), np.float32)

    def fill_layer(layer: int) -> None:  # layer by layer: a grid of points takes six times the grid's memory
        cells = np.stack(np.meshgrid([layer], *map(np.arange, counts[1:]), indexing="ij"), -1)
        centres = start + (cells[0] + 0.5) * pitch
        solid[layer] = body.at(centres) > 0
        if rgb is not None and colours is not None:
            rgb[layer] = colours(centres.reshape(-1, 3)).reshape(*centres.shape)

    side_by_side(fill_layer, range(counts[0]))
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
    points = _push_under(body, points, UNDER_SKIN * sigma)
    colour = np.full(points.shape, 0.5, np.float32) if colours is None else colours(points).astype(np.float32)
    return InteriorAtoms(points.astype(np.float32), sigma, colour)


def _push_under(body: Body, points: NDArray[np.float64], depth: Float) -> NDArray[np.float64]:
    """(N, 3). The points, those closer to the skin than their `depth` (N,) moved inwards as far as the body allows."""
    points = points.copy()
    for _ in range(3):
        short = np.flatnonzero(body.at(points) < depth)
        if not len(short):
            break
        missing = depth[short] - body.at(points[short])
        points[short] += inward_normals(body, points[short]) * missing[:, None]
    return points
