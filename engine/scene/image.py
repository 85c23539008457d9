"""The result of a renderer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Picture"]


@dataclass(frozen=True)
class Picture:
    """One rendered view, H x W pixels, float32."""

    rgb: NDArray[np.float32]
    """(H, W, 3). Colours over the background, unclamped. Range [0, inf)."""
    alpha: NDArray[np.float32]
    """(H, W). Coverage of the pixel. Range [0, 1]."""
    depth: NDArray[np.float32]
    """(H, W). Depth of the visible surface along the camera's axis, world units; inf for an empty pixel."""

    def __post_init__(self) -> None:
        shape = self.alpha.shape
        assert len(shape) == 2, shape
        assert self.rgb.shape == (*shape, 3), self.rgb.shape
        assert self.depth.shape == shape, self.depth.shape
