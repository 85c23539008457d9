"""A cut-out made elsewhere: a black and white picture beside the photograph."""

from __future__ import annotations

from pathlib import Path

__all__ = ["mask_beside"]


def mask_beside(photograph: Path) -> Path | None:
    """The photograph's mask, `apple.mask.png` for `apple.jpg`; None if there is none."""
    path = photograph.with_name(f"{photograph.stem}.mask.png")
    return path if path.is_file() else None
