"""Light as files store it: linear, or as screens show it (sRGB, IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["as_linear", "as_srgb"]

Double = NDArray[np.float64]


def as_linear(rgb: NDArray[np.floating]) -> Double:
    """Colours in linear light, range [0, 1], of sRGB in [0, 1]."""
    part = np.asarray(rgb, np.float64)
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def as_srgb(light: NDArray[np.floating]) -> Double:
    """Colours in sRGB, range [0, 1], of linear light in [0, 1]."""
    part = np.asarray(light, np.float64)
    return np.where(part <= 0.0031308, part * 12.92, 1.055 * np.maximum(part, 0.0031308) ** (1 / 2.4) - 0.055)
