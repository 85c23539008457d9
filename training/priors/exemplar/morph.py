"""Several slices of one and the same thing: told from pictures of different things, and turned into one another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.frames import Sheet

__all__ = ["Slices", "slices"]

SIDE = 160
"""Pixels of the picture of the unit disc on which slices are compared: fine enough to follow a muscle."""

SAME, APART = 0.3, 0.2
"""Least correlation of neighbouring slices of one thing, and its lead over other angles.

Slices of a thigh 5 cm apart have 0.4 to 0.6, those of one orange 0.6; those of one melon or loaf, whose seeds and pores
come and go, 0.1, as have slices of different things.
"""

FLOW_SIGMA = 0.03
"""Smoothness of the flow, in discs: neighbours move together, and a bone may still pass a muscle."""


class Slices:
    """Pictures in order along an axis, evenly spaced, with the flow between neighbours."""

    def __init__(self, discs: list[NDArray[np.float32]]) -> None:
        self.discs = discs
        self.flows = [(_flow(a, b), _flow(b, a)) for a, b in pairwise(discs)]

    def read(
        self,
        x: NDArray[np.floating],  # [M] on the unit disc
        y: NDArray[np.floating],  # [M]
        t: NDArray[np.floating],  # [M] along the axis, range [0, 1]
    ) -> NDArray[np.float32]:
        """(M, 3). Colours; slice k of n stands at (k + 1/2) / n, beyond the first and last nothing changes."""
        at = np.clip(t * len(self.discs) - 0.5, 0, len(self.discs) - 1)
        out = np.empty((len(x), 3), np.float32)
        below = np.minimum(at.astype(int), len(self.discs) - 2)
        for k, (forth, back) in enumerate(self.flows):
            mine = below == k
            f = (at[mine] - k).astype(np.float32)
            u, v = x[mine], y[mine]
            # Of the two slices each moves its part of the way, so what both show is not seen twice.
            a = _sample(self.discs[k], *_origin(forth, u, v, f))
            b = _sample(self.discs[k + 1], *_origin(back, u, v, 1 - f))
            # A quick change half way blurs less than a slow one all the way.
            w = np.clip((f - 0.5) / 0.4 + 0.5, 0, 1)[:, None]
            out[mine] = a + w * w * (3 - 2 * w) * (b - a)
        return out


def slices(sheets: Sequence[Sheet]) -> Slices | None:
    """The sheets as slices of one thing, in their order; None where they are not, or there is but one.

    Slices of one thing look alike at the angle at which they were given, and at no other.
    """
    if len(sheets) < 2:
        return None
    discs = [_disc(s) for s in sheets]
    inner = np.hypot(*_grid()) < 0.85
    for a, b in pairwise(discs):
        here = _correlation(a[inner], b[inner])
        turned = [_correlation(a[inner], _turned(b, n * np.pi / 6)[inner]) for n in range(2, 11)]
        if here < SAME or here < np.median(turned) + APART:
            return None
    return Slices(discs)


def _grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x to the right and y up on the disc's pixels, range (-1, 1)."""
    axis = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    x, y = np.meshgrid(axis, -axis)
    return x, y


def _disc(sheet: Sheet) -> NDArray[np.float32]:
    """(SIDE, SIDE, 3). The picture with its outline stretched to the unit circle."""
    x, y = _grid()
    angle = np.arctan2(y, x)
    r = np.minimum(np.hypot(x, y), 1) * sheet.rim(angle)
    return sheet.read(sheet.middle[0] + r * np.cos(angle), sheet.middle[1] - r * np.sin(angle))


def _turned(disc: NDArray[np.float32], angle: float) -> NDArray[np.float32]:
    x, y = _grid()
    c, s = np.cos(angle), np.sin(angle)
    return _sample(disc, (c * x - s * y).ravel(), (s * x + c * y).ravel()).reshape(disc.shape)


def _sample(picture: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M, C). Bilinear values at places on the disc."""
    at = np.stack([(1 - y) / 2 * SIDE - 0.5, (1 + x) / 2 * SIDE - 0.5])
    return np.stack(
        [
            ndimage.map_coordinates(picture[..., c], at, order=1, mode="nearest", output=np.float32)
            for c in range(picture.shape[-1])
        ],
        axis=-1,
    )


def _origin(
    flow: NDArray[np.float32], x: NDArray[np.floating], y: NDArray[np.floating], part: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """(M,), (M,). The place that a part of the flow takes to (x, y), by fixed-point steps."""
    u, v = x, y
    for _ in range(4):
        step = _sample(flow, u, v) * part[:, None]
        u, v = x - step[:, 0], y - step[:, 1]
    return u, v


def _correlation(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Of two sets of colours (M, 3), each channel about its mean."""
    a, b = a - a.mean(0), b - b.mean(0)
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-12)))


def _flow(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(SIDE, SIDE, 2). How far, on the disc, what is seen at a place of `a` lies away in `b`: a(p) = b(p + flow(p)).

    Demons (Thirion 1998): steps along the gradient of the moved picture, smoothed, from coarse to fine.
    """
    x, y = _grid()
    flow = np.zeros((SIDE, SIDE, 2), np.float32)
    for blur in (16.0, 8.0, 4.0, 2.0):
        smooth_a, smooth_b = (ndimage.gaussian_filter(p, (blur, blur, 0)) for p in (a, b))
        sigma = max(FLOW_SIGMA * SIDE / 2, 0.5 * blur)
        for _ in range(60):
            moved = _sample(smooth_b, (x + flow[..., 0]).ravel(), (y + flow[..., 1]).ravel()).reshape(a.shape)
            rows, columns = np.gradient(moved, 2 / SIDE, axis=(0, 1))
            gap = smooth_a - moved
            force = np.stack([(gap * columns).sum(-1), -(gap * rows).sum(-1)], -1)
            # The step is at most about a pixel whatever the contrast.
            scale = (columns**2 + rows**2).sum(-1) + (gap**2).sum(-1) * (SIDE / 3) ** 2
            flow += (force / np.maximum(scale, 1e-6)[..., None]).astype(np.float32)
            flow = ndimage.gaussian_filter(flow, (sigma, sigma, 0))
    return flow
