"""The numbers of the opaque image. The CPU renderers use them, and the GL engine writes them into its shaders."""

from __future__ import annotations

import math

__all__ = [
    "CORE_Q",
    "CUTOFF_Q",
    "EDGE_SLOPE",
    "EPSILON_PITCHES",
    "LATTICE_DENSITY",
    "LOW_PASS",
    "MIN_WEIGHT",
    "SOLID_DENSITY",
]

LOW_PASS = 0.3
"""px^2 added to every projected covariance: 3DGS' own low-pass, so that no splat falls between pixel centres."""

CUTOFF_Q = 9.0
"""Squared Mahalanobis distance at which a kernel ends: three standard deviations, 98.9 % of its height gone."""

CORE_Q = 2.0 * math.log(2.0)
"""Squared Mahalanobis distance of half height: nearer than this an atom hides what lies behind it."""

EPSILON_PITCHES = 1.5
"""Depth of the blended layer behind the front, in pitches: a scale cap and a half joins neighbours, not walls."""

EDGE_SLOPE = 0.59
"""|slope| of exp(-x^2/2) at half height, sqrt(2 ln 2) / 2: an edge of sigma pixels sharpens by sigma / this."""

LATTICE_DENSITY = (2.0 * math.pi) ** 1.5 / 8.0
"""Sum of the weights inside a lattice of spheres with sigma = pitch / 2."""

SOLID_DENSITY = LATTICE_DENSITY / 4
"""Weight sum from which a point counts as solid. A boundary plane of an even lattice has half of the lattice's, but
atoms are jittered and end a little under the skin: at half, 6 % of the points 0.05 to 1.5 pitches under a skin are
holes, at a quarter 0.2 %, and 0.04 % of those 0.4 to 1 pitch above it are solid."""

MIN_WEIGHT = 1e-6
"""Weight sum under which a pixel has no colour of its own."""
