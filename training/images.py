"""Float pictures as 8-bit PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from engine.io.files import atomic

__all__ = ["save_image", "to_image"]


def save_image(path: Path, rgb: NDArray[np.float32]) -> None:
    """One picture (H, W, 3) of range [0, 1] as PNG."""
    image = to_image(rgb)
    with atomic(path) as temporary:
        image.save(temporary)


def to_image(rgb: NDArray[np.float32]) -> Image.Image:
    """8-bit picture of (H, W, 3), range [0, 1], rounded."""
    return Image.fromarray((np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8))
