"""The weight of a fragment, and what a pixel of the opaque image's outside makes of the sums of weights.

A thin layer behind the front gives the pixel its colour. At an edge inside a silhouette the layer covers the pixel only
in part, and what lies behind it covers the rest, so that a closed object lets no background through. What lies behind
changes alpha alone. shaders/outside_look.glsl has the same laws.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.core import types
from numba.extending import overload

from engine.scene.constants import MIN_WEIGHT

__all__ = ["BEHIND", "FUSED", "SUMS", "coverage", "falloff", "outside_alpha", "resolve", "resolve_backward"]

FUSED = {"contract"}
"""Lets a product and a sum be fused and rounded once: as accurate, a tenth faster, always the same on one machine."""

BEHIND = 5
"""Place of the first of the sums behind the layer."""

SUMS = BEHIND + 2
"""Sums of a pixel: of the layer's fragments weight, weight times sharpness and weight times RGB; of those behind the
layer weight and weight times sharpness."""


def falloff(h: float) -> float:
    """exp(-h) for h in [0, CUTOFF_Q / 2]; a call of the library's would keep a row from becoming vectors."""
    return math.exp(-h)


@overload(falloff, jit_options={"fastmath": FUSED})
def _falloff(h):
    if h != types.float32:
        return lambda h: math.exp(-h)

    one = np.float32(1)
    eighth, a, b, c, d = (np.float32(v) for v in (1 / 8, 1 / 2, 1 / 6, 1 / 24, 1 / 120))
    e = np.float32(1 / 720)

    def polynomial(h):
        # exp(-h / 8) by its series, then squared three times: no table and no branch.
        x = -h * eighth
        y = one + x * (one + x * (a + x * (b + x * (c + x * (d + x * e)))))
        y *= y
        y *= y
        return y * y

    return polynomial


@njit(cache=True, error_model="numpy")
def coverage(weight, edge):
    """Covered part of a pixel, range [0, 1], from its sums of weights and of weights times sharpness."""
    if not weight > MIN_WEIGHT:
        return 0.0
    return min(max(0.5 + (weight - 0.5) * (edge / weight), 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def coverage_backward(weight, edge, given):
    """Gradients of weight and edge, given that of their `coverage`. None where it is clamped to 0 or 1."""
    if 0.0 < coverage(weight, edge) < 1.0:
        return given * 0.5 * edge / (weight * weight), given * (1.0 - 0.5 / weight)
    return 0.0, 0.0


@njit(cache=True, error_model="numpy")
def outside_alpha(weight, edge, behind_weight, behind_edge):
    """Alpha of a pixel from the sums of the layer and of what lies behind it, which cover it independently:
    1 - alpha = (1 - layer) (1 - behind). Without a layer there is no colour, and the pixel is empty."""
    if not weight > MIN_WEIGHT:
        return 0.0
    layer = coverage(weight, edge)
    return layer + (1.0 - layer) * coverage(behind_weight, behind_edge)


@njit(cache=True, error_model="numpy", nogil=True)
def resolve(y, sums, rgb, alpha):
    """Fills row y of rgb (H, W, 3), weighted by alpha, and alpha (H, W) from sums (H, W, SUMS)."""
    for x in range(sums.shape[1]):
        weight = sums[y, x, 0]
        covered = outside_alpha(weight, sums[y, x, 1], sums[y, x, BEHIND], sums[y, x, BEHIND + 1])
        alpha[y, x] = covered
        for c in range(3):
            rgb[y, x, c] = sums[y, x, 2 + c] / weight * covered if covered > 0.0 else 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def resolve_backward(y, sums, d_rgb, d_alpha, d_sums):
    """Fills row y of d_sums (H, W, SUMS): `resolve` backwards. A coverage clamped to 0 or 1 passes no gradient on."""
    for x in range(sums.shape[1]):
        d_sums[y, x, :] = 0
        weight, edge = float(sums[y, x, 0]), float(sums[y, x, 1])
        behind_weight, behind_edge = float(sums[y, x, BEHIND]), float(sums[y, x, BEHIND + 1])
        if not weight > MIN_WEIGHT:
            continue
        covered = outside_alpha(weight, edge, behind_weight, behind_edge)
        along = 0.0
        for c in range(3):
            along += d_rgb[y, x, c] * sums[y, x, 2 + c] / weight
            d_sums[y, x, 2 + c] = d_rgb[y, x, c] * covered / weight
        total = d_alpha[y, x] + along
        uncovered, open_behind = 1.0 - coverage(weight, edge), 1.0 - coverage(behind_weight, behind_edge)
        d_weight, d_edge = coverage_backward(weight, edge, total * open_behind)
        d_behind_weight, d_behind_edge = coverage_backward(behind_weight, behind_edge, total * uncovered)
        d_sums[y, x, 0] = d_weight - along * covered / weight
        d_sums[y, x, 1] = d_edge
        d_sums[y, x, BEHIND], d_sums[y, x, BEHIND + 1] = d_behind_weight, d_behind_edge
