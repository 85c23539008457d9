"""What a renderer returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Picture"]


@dataclass(frozen=True)
class Picture:
    """One rendered view, H x W pixels, float32."""

    rgb: NDArray[np.float32]
    """(H, W, 3). Colours over the background, as computed: at least 0, above 1 where the scene says so."""
    alpha: NDArray[np.float32]
    """(H, W). How much of the pixel is covered. Range [0, 1]."""
    depth: NDArray[np.float32]
    """(H, W). Depth along the camera's axis of what is seen, world units; inf where nothing is."""

    def __post_init__(self) -> None:
        shape = self.alpha.shape
        assert len(shape) == 2, shape
        assert self.rgb.shape == (*shape, 3), self.rgb.shape
        assert self.depth.shape == shape, self.depth.shape
