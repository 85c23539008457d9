"""Constants of the opaque and the classic image. Kernels import them; shaders get them as defines."""

from __future__ import annotations

import math

import numpy as np

__all__ = [
    "ALPHA_STEPS",
    "CLAMP_MARGIN",
    "CORE_Q",
    "CUTOFF_Q",
    "EDGE_SLOPE",
    "EPSILON_PITCHES",
    "FACE_AMBIENT",
    "FACE_LAMP",
    "FACE_OPAQUE",
    "FADE_LAYERS",
    "FILLED_DENSITY",
    "JOINT_PITCHES",
    "LATTICE_DENSITY",
    "LOW_PASS",
    "MAX_ALPHA",
    "MIN_TRANSMITTANCE",
    "MIN_WEIGHT",
    "NOTHING",
    "SOLID_DENSITY",
]

LOW_PASS = 0.3
"""px^2 added to every projected covariance: the low-pass of 3DGS, so that no splat falls between pixel centres."""

CUTOFF_Q = 9.0
"""Squared Mahalanobis distance at which a kernel is cut off: three standard deviations, 1.1 % of its height."""

CORE_Q = 2.0 * math.log(3.0)
"""Squared Mahalanobis distance at which a kernel has a third of its height: the nearest atom within this distance is
the front. With half the height, a skin has gaps that show the far side of the object as a mixture; with a fifth, the
front would reach over what lies behind an edge."""

EPSILON_PITCHES = 1.5
"""Pitches. Depth of the blended layer on either side of the front: 1.5 scale caps blend neighbours but not opposite
walls."""

FADE_LAYERS = 40
"""Layers behind the front beyond which weights fall no further: each layer has a quarter of the weight of the one
before it, and 4^-40 is still a float32."""

EDGE_SLOPE = 0.59
"""|slope| of exp(-x^2/2) at half height, sqrt(2 ln 2) / 2: an edge of sigma pixels sharpens by sigma / this."""

LATTICE_DENSITY = (2.0 * math.pi) ** 1.5 / 8.0
"""Sum of the weights inside a lattice of spheres with sigma = pitch / 2."""

FILLED_DENSITY = 0.9 * LATTICE_DENSITY
"""Weight sum from which the interior alone colours a cut face. The sum of an even lattice ripples by 4 %, that of a
jittered one by more."""

SOLID_DENSITY = LATTICE_DENSITY / 4
"""Weight sum from which a point counts as solid. On the boundary plane of an even lattice it is half of that inside,
but atoms are jittered and end a little below the skin: at a half, 6 % of the points 0.05 to 1.5 pitches below a skin
are holes; at a quarter 0.2 % are, and 0.04 % of the points 0.4 to 1 pitch above it are solid."""

MIN_WEIGHT = 1e-6
"""Weight sum below which a pixel counts as empty."""

FACE_AMBIENT = 0.85
FACE_LAMP = 1.0 - FACE_AMBIENT
"""Light on a cut face seen edge-on, and what a lamp at the eye adds when it is seen straight on. Enough to show the
slant, too little to distort colours."""

FACE_OPAQUE = 0.999
"""Coverage of a cut face from which nothing behind it counts."""

JOINT_PITCHES = 1e-3
"""Pitches. A point this close to another piece's plane touches it: pieces that have not moved apart show no face
between them."""

CLAMP_MARGIN = 0.3
"""Half widths. How far outside the picture the Jacobian still follows a mean; farther out it is clamped, because the
affine approximation diverges there (INRIA and gsplat use the same number)."""

MAX_ALPHA = float(np.float32(0.99))
"""Classic: cap of alpha, so that the derivative, which divides by 1 - alpha, stays finite. The float32 number in all
precisions: two such layers leave (1 - 0.99)^2, just under the transmittance that ends a pixel, and all renderers must
agree that they end it."""

MIN_TRANSMITTANCE = 1e-4
"""Classic: a layer that would leave less transmittance than this is not drawn and ends the pixel, as in INRIA's
renderer; on the GPU the layer that ends it is drawn, and perhaps a few more."""

ALPHA_STEPS = 255.0
"""Classic: layers with an alpha below 1 / ALPHA_STEPS, one step of an 8-bit picture, are skipped."""

NOTHING = 3.0e38
"""Depth of an empty pixel. A finite number, because shader compilers may optimise infinities away."""
