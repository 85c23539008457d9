"""Removes gradients of illumination from photographs and matches the illuminant of several."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from engine.solid.distance_transform import depth_in
from training.families import Kind

__all__ = ["colour_gain", "flatten_light"]

BANDS = 12
"""Bands of depth under the edge in which colours are compared."""

MIN_LOG_GAIN = 0.04
"""|log gain| below which nothing is changed: two faces of a fruit differ as much in the same light."""

MAX_LOG_GAIN = 0.35

DARK = 0.06
"""Channel value below which a ratio is noise."""


def colour_gain(
    rgb: NDArray[np.float32], mask: NDArray[np.bool_], to: NDArray[np.float32], to_mask: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """(3,). Gains per channel that match the illuminant of a picture (H, W, 3) to that of another.

    The weighted median, over depths under the edge, of the ratios of median colours; it ignores what only one picture
    shows at some depth. Weights are squared brightness, as the variance of a ratio falls with it: red flesh has so
    little green that its shades would pass for light.
    """
    medians, to_medians = _medians(rgb, mask), _medians(to, to_mask)
    gain = np.zeros(3)
    for c in range(3):
        bright = (medians[:, c] > DARK) & (to_medians[:, c] > DARK)  # False where either is NaN
        if bright.any():
            a, b = medians[bright, c], to_medians[bright, c]
            gain[c] = np.quantile(np.log(b / a), 0.5, weights=np.minimum(a, b) ** 2, method="inverted_cdf")
    if np.abs(gain).max() < MIN_LOG_GAIN:
        return np.ones(3, np.float32)
    return np.exp(np.clip(gain, -MAX_LOG_GAIN, MAX_LOG_GAIN)).astype(np.float32)


def _medians(values: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(BANDS, C). Median of (H, W, C) in bands of depth under the edge of a mask; NaN where a band is empty."""
    band = _bands(mask)
    return np.array(
        [
            np.median(values[band == n], axis=0) if (band == n).any() else np.full(values.shape[2], np.nan)
            for n in range(BANDS)
        ]
    )


def _bands(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(H, W). Band of depth of each pixel, -1 outside."""
    depth = depth_in(mask)
    band = np.minimum((depth / max(depth.max(), 1) * BANDS).astype(np.int64), BANDS - 1)
    return np.where(mask, band, -1)


def flatten_light(rgb: NDArray[np.float32], mask: NDArray[np.bool_], kind: Kind) -> NDArray[np.float32]:
    """The picture (H, W, 3) with a linear gradient of illumination removed.

    The gradient is fitted to log brightness relative to the median at the same depth under the skin. In radial and
    parallel pictures it is horizontal only: from bottom to top a cake or a loaf may really change.
    """
    brightness = np.log(np.maximum(rgb.mean(-1), 0.02))
    rest = (brightness - _medians(brightness[..., None], mask)[_bands(mask), 0])[mask]
    y, x = np.meshgrid(np.linspace(-1, 1, rgb.shape[0]), np.linspace(-1, 1, rgb.shape[1]), indexing="ij")
    axes = [x, y] if kind == "horizontal" else [x]
    a = np.stack([np.ones(len(rest)), *[axis[mask] for axis in axes]], -1)
    weight = np.ones(len(rest))
    fit = np.zeros(a.shape[1])
    for _ in range(5):  # seeds and membranes are outliers, not light
        fit = np.linalg.lstsq(a * weight[:, None], rest * weight, rcond=None)[0]
        weight = 1 / (1 + (np.abs(rest - a @ fit) / 0.08) ** 2)
    slope = sum(c * axis for c, axis in zip(fit[1:], axes, strict=True))
    return np.clip(rgb * np.exp(-np.clip(slope, -0.35, 0.35))[..., None], 0, 1).astype(np.float32)
