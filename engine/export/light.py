"""Linear light, as files of other programs store it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["linear_light"]


def linear_light(rgb: NDArray[np.generic]) -> NDArray[np.float32]:
    """(N, 3). Colours in linear light, range [0, 1], of sRGB (N, 3), range [0, 255] (IEC 61966-2-1)."""
    part = rgb.astype(np.float64) / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4).astype(np.float32)
