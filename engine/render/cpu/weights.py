"""The weight of a fragment, and what a pixel of the opaque image's outside makes of the sums of weights.

A thin layer at the front, the nearest core (a splat up to CORE_Q), gives a pixel its colour. Fragments before the layer
have no core there: what they cover of the pixel hides the layer, be it the rim of a leaf or several atoms that only
together close a gap. What both leave open shows what lies behind, so that edges inside a silhouette are smooth and a
closed object lets no background through. shaders/outside_look.glsl has the same laws.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numba.core import types
from numba.extending import overload

from engine.scene.constants import FADE_LAYERS, MIN_WEIGHT

__all__ = [
    "BEFORE",
    "BEHIND",
    "FUSED",
    "SUMS",
    "coverage",
    "coverage_backward",
    "depth_weight",
    "falloff",
    "outside_shares",
    "resolve",
    "resolve_backward",
]

FUSED = {"contract"}
"""Lets a product and a sum be fused and rounded once: as accurate, a tenth faster, always the same on one machine."""

BEFORE, BEHIND = 5, 10
"""Places of the first of the sums before the layer, and of those behind it. The layer's own come first."""

SUMS = BEHIND + 6
"""Number of sums per pixel: weight, weight times sharpness and weight times RGB, each over the fragments in the layer,
before it and behind it. RGB behind is also weighted by `depth_weight`, and the last sum is that of these weights."""


def falloff(h: float) -> float:
    """exp(-h) for h in [0, CUTOFF_Q / 2]; a call to the library would keep rows from being vectorised."""
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
    """Gradients of weight and edge, given that of their `coverage`; 0 where it is clamped to 0 or 1."""
    if 0.0 < coverage(weight, edge) < 1.0:
        return given * 0.5 * edge / (weight * weight), given * (1.0 - 0.5 / weight)
    return 0.0, 0.0


@njit(cache=True, error_model="numpy")
def depth_weight(z, front, layer):
    """Weight of a fragment at depth z in the colour behind the layer: a quarter for each layer's depth.

    The nearest fragment is to show, and there is no third pass to find it. The weight falls in steps, so that a
    fragment has no gradient by its depth, as it has none by its place in the layer.
    """
    return math.ldexp(1.0, -2 * int(min(math.floor(z / layer) - math.floor(front / layer), FADE_LAYERS)))


@njit(cache=True, error_model="numpy")
def outside_shares(sums):
    """Shares of a pixel, range [0, 1], that show what is in the layer, before and behind it, from its sums (SUMS,).

    They add up to alpha, 1 - (1 - before) (1 - layer) (1 - behind): each covers its part of what the earlier ones
    leave. Without a layer there is nothing.
    """
    if not sums[0] > MIN_WEIGHT:
        return 0.0, 0.0, 0.0
    before = coverage(sums[BEFORE], sums[BEFORE + 1])
    layer = (1.0 - before) * coverage(sums[0], sums[1])
    return layer, before, (1.0 - before - layer) * coverage(sums[BEHIND], sums[BEHIND + 1])


@njit(cache=True, error_model="numpy", nogil=True)
def resolve(y, sums, rgb, alpha):
    """Fills row y of rgb (H, W, 3), weighted by alpha, and alpha (H, W) from sums (H, W, SUMS)."""
    for x in range(sums.shape[1]):
        layer, before, behind = outside_shares(sums[y, x])
        alpha[y, x] = layer + before + behind
        for c in range(3):
            colour = layer / sums[y, x, 0] * sums[y, x, 2 + c] if layer > 0.0 else 0.0
            colour += before / sums[y, x, BEFORE] * sums[y, x, BEFORE + 2 + c] if before > 0.0 else 0.0
            colour += behind / sums[y, x, BEHIND + 5] * sums[y, x, BEHIND + 2 + c] if behind > 0.0 else 0.0
            rgb[y, x, c] = colour


@njit(cache=True, error_model="numpy")
def _mean_backward(sums, first, weight, share, d_rgb, d_sums):
    """Adds to d_sums (SUMS,) the gradients of a mean colour, whose sums begin at `first` and whose weight is at
    `weight`, given that of the share that shows it times the colour. Returns the derivative by the share."""
    along = 0.0
    if sums[weight] > 0.0:  # far behind the layer a weight by depth is tiny, but its colour is what shows
        for c in range(3):
            along += d_rgb[c] * sums[first + c] / sums[weight]
            d_sums[first + c] = d_rgb[c] * share / sums[weight]
        d_sums[weight] -= along * share / sums[weight]
    return along


@njit(cache=True, error_model="numpy", nogil=True)
def resolve_backward(y, sums, d_rgb, d_alpha, d_sums):
    """Fills row y of d_sums (H, W, SUMS): `resolve` backwards. A coverage clamped to 0 or 1 passes no gradient on."""
    for x in range(sums.shape[1]):
        d_sums[y, x, :] = 0
        given, to = sums[y, x], d_sums[y, x]
        if not given[0] > MIN_WEIGHT:
            continue
        layer, before, behind = outside_shares(given)
        if layer == 1.0:  # most pixels: only the colour of the layer matters
            _mean_backward(given, 2, 0, layer, d_rgb[y, x], to)
            continue
        d_layer = d_alpha[y, x] + _mean_backward(given, 2, 0, layer, d_rgb[y, x], to)
        d_before = d_alpha[y, x] + _mean_backward(given, BEFORE + 2, BEFORE, before, d_rgb[y, x], to)
        d_behind = d_alpha[y, x] + _mean_backward(given, BEHIND + 2, BEHIND + 5, behind, d_rgb[y, x], to)
        here, rest = coverage(given[0], given[1]), coverage(given[BEHIND], given[BEHIND + 1])
        beyond = (1.0 - here) * rest * d_behind  # of what the fragments before the layer leave open
        left = 1.0 - before
        for first, gradient in (
            (0, left * (d_layer - rest * d_behind)),
            (BEFORE, d_before - here * d_layer - beyond),
            (BEHIND, left * (1.0 - here) * d_behind),
        ):
            d_weight, d_edge = coverage_backward(given[first], given[first + 1], gradient)
            to[first] += d_weight
            to[first + 1] += d_edge
