"""A cut-out made elsewhere: a black and white picture beside the photograph."""

from __future__ import annotations

from pathlib import Path

__all__ = ["is_mask", "mask_beside"]

SUFFIX = ".mask.png"


def mask_beside(photograph: Path) -> Path | None:
    """The photograph's mask, `apple.mask.png` for `apple.jpg`; None if there is none."""
    path = photograph.with_name(photograph.stem + SUFFIX)
    return path if path.is_file() else None


def is_mask(path: Path) -> bool:
    """Whether a picture is another one's mask, by its name."""
    return path.name.endswith(SUFFIX)
