"""Recognises pictures that are slices of one object and interpolates between them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from training.priors.exemplar.frames import ScaledPicture

__all__ = ["SliceStack", "match_slices"]

DISC_SIZE = 160
"""Pixels along a side of the unit disc on which slices are compared: fine enough to follow a muscle."""

MIN_CORRELATION, MIN_LEAD = 0.3, 0.2
"""Smallest correlation of neighbouring slices of one object, and smallest lead over other angles.

Slices of a thigh 5 cm apart have 0.4 to 0.6 and those of one orange 0.6. Those of one melon or loaf, whose seeds and
pores come and go, have 0.1, like slices of different objects.
"""

FLOW_SIGMA = 0.03
"""Smoothing of the flow, in disc diameters: neighbours move together, yet a bone may pass a muscle."""


class SliceStack:
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
        """(M, 3). Colours; slice k of n stands at (k + 1/2) / n, with constant extrapolation beyond the first and
        last."""
        at = np.clip(t * len(self.discs) - 0.5, 0, len(self.discs) - 1)
        out = np.empty((len(x), 3), np.float32)
        below = np.minimum(at.astype(int), len(self.discs) - 2)
        for k, (forth, back) in enumerate(self.flows):
            rows = below == k
            f = (at[rows] - k).astype(np.float32)
            u, v = x[rows], y[rows]
            # Both slices are warped to the position between them, so that common features coincide.
            a = _sample(self.discs[k], *_origin(forth, u, v, f))
            b = _sample(self.discs[k + 1], *_origin(back, u, v, 1 - f))
            # A quick cross-fade half way blurs less than a slow one all the way.
            w = np.clip((f - 0.5) / 0.4 + 0.5, 0, 1)[:, None]
            out[rows] = a + w * w * (3 - 2 * w) * (b - a)
        return out


def match_slices(pictures: Sequence[ScaledPicture]) -> SliceStack | None:
    """The pictures as slices of one object, in their order; None if they are not, or if there is only one.

    Slices of one object correlate at the angle at which they were given, and at no other.
    """
    if len(pictures) < 2:
        return None
    discs = [_disc(s) for s in pictures]
    inner = np.hypot(*_grid()) < 0.85
    for a, b in pairwise(discs):
        upright = _correlation(a[inner], b[inner])
        rotated = [_correlation(a[inner], _rotated(b, n * np.pi / 6)[inner]) for n in range(2, 11)]
        if upright < MIN_CORRELATION or upright < np.median(rotated) + MIN_LEAD:
            return None
    return SliceStack(discs)


def _grid() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pixel centres of the disc, x to the right and y up, range (-1, 1)."""
    axis = (np.arange(DISC_SIZE) + 0.5) / DISC_SIZE * 2 - 1
    x, y = np.meshgrid(axis, -axis)
    return x, y


def _disc(scaled: ScaledPicture) -> NDArray[np.float32]:
    """(DISC_SIZE, DISC_SIZE, 3). The picture with its outline stretched to the unit circle."""
    x, y = _grid()
    angle = np.arctan2(y, x)
    r = np.minimum(np.hypot(x, y), 1) * scaled.rim(angle)
    return scaled.read(scaled.middle[0] + r * np.cos(angle), scaled.middle[1] - r * np.sin(angle))


def _rotated(disc: NDArray[np.float32], angle: float) -> NDArray[np.float32]:
    x, y = _grid()
    c, s = np.cos(angle), np.sin(angle)
    return _sample(disc, (c * x - s * y).ravel(), (s * x + c * y).ravel()).reshape(disc.shape)


def _sample(picture: NDArray[np.floating], x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.float32]:
    """(M, C). Bilinear values at positions on the disc."""
    at = np.stack([(1 - y) / 2 * DISC_SIZE - 0.5, (1 + x) / 2 * DISC_SIZE - 0.5])
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
    """(M,), (M,). The position that a fraction of the flow moves to (x, y), by fixed-point iteration."""
    u, v = x, y
    for _ in range(4):
        step = _sample(flow, u, v) * part[:, None]
        u, v = x - step[:, 0], y - step[:, 1]
    return u, v


def _correlation(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Pearson correlation of two sets of colours (M, 3), each channel centred."""
    a, b = a - a.mean(0), b - b.mean(0)
    return float((a * b).sum() / np.sqrt(max((a * a).sum() * (b * b).sum(), 1e-12)))


def _flow(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(DISC_SIZE, DISC_SIZE, 2). Optical flow on the disc: a(p) = b(p + flow(p)).

    Demons (Thirion 1998): steps along the gradient of the moved picture, smoothed, from coarse to fine.
    """
    x, y = _grid()
    flow = np.zeros((DISC_SIZE, DISC_SIZE, 2), np.float32)
    for blur in (16.0, 8.0, 4.0, 2.0):
        smooth_a, smooth_b = (ndimage.gaussian_filter(p, (blur, blur, 0)) for p in (a, b))
        sigma = max(FLOW_SIGMA * DISC_SIZE / 2, 0.5 * blur)
        for _ in range(60):
            moved = _sample(smooth_b, (x + flow[..., 0]).ravel(), (y + flow[..., 1]).ravel()).reshape(a.shape)
            rows, columns = np.gradient(moved, 2 / DISC_SIZE, axis=(0, 1))
            gap = smooth_a - moved
            force = np.stack([(gap * columns).sum(-1), -(gap * rows).sum(-1)], -1)
            # Limits a step to about a pixel at any contrast.
            scale = (columns**2 + rows**2).sum(-1) + (gap**2).sum(-1) * (DISC_SIZE / 3) ** 2
            flow += (force / np.maximum(scale, 1e-6)[..., None]).astype(np.float32)
            flow = ndimage.gaussian_filter(flow, (sigma, sigma, 0))
    return flow
