"""The result of a renderer, colours in 8 bits, and how close two pictures are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Picture", "decibels", "psnr", "to_8bit"]


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

    def straight_alpha(self) -> NDArray[np.uint8]:
        """(H, W, 4). This picture, rendered over black, as 8 bits with straight alpha, as files and textures store."""
        alpha = np.clip(self.alpha[..., None], 0, 1)
        rgb = np.where(alpha > 1e-3, self.rgb / np.maximum(alpha, 1e-3), 0.0)
        return to_8bit(np.concatenate([rgb, alpha], 2))


def to_8bit(values: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Values of range [0, 1], clamped and rounded to bytes."""
    return (np.clip(values, 0, 1) * 255 + 0.5).astype(np.uint8)


def psnr(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Peak signal-to-noise ratio in dB of two arrays of one shape, for a range of 1; infinite where they are equal."""
    assert a.shape == b.shape, (a.shape, b.shape)
    return decibels(float(np.mean((a.astype(np.float64) - b) ** 2)))


def decibels(error: float) -> float:
    """Peak signal-to-noise ratio in dB of a mean squared error, for a range of 1."""
    return float("inf") if error <= 0 else -10 * float(np.log10(error))
