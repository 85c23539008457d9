"""Small pictures of recent files, kept in the user's cache folder and shown in the empty window.

A picture is named by a hash of its file's path, so that the folder's listing does not reveal what was open.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from app.model.settings import cache_folder
from engine.errors import InputError
from engine.io.files import remove
from engine.io.picture_file import save_png

__all__ = ["SIZE", "keep_picture", "picture_of", "remove_pictures"]

SIZE = (400, 250)
"""Width and height in pixels: sharp on a screen of twice the usual density."""


def picture_of(name: str) -> Path:
    """Path of the picture of a file, which may not exist yet. `name`: the file as in `Settings.recent`."""
    return _folder() / f"{hashlib.sha256(name.encode('utf-8', 'surrogateescape')).hexdigest()}.png"


def keep_picture(name: str, pixels: NDArray[np.uint8]) -> None:
    """Keeps a view (H, W, 3) of a file as its picture, cropped to the middle. A full or read-only disk is ignored."""
    with suppress(InputError):
        small = ImageOps.fit(Image.fromarray(pixels), SIZE, Image.Resampling.LANCZOS)
        save_png(picture_of(name), np.asarray(small))


def remove_pictures(recent: Collection[str]) -> None:
    """Removes the pictures of all files but these."""
    kept = {picture_of(name).name for name in recent}
    with suppress(OSError, InputError):
        for path in _folder().glob("*.png"):
            if path.name not in kept:
                remove(path)


def _folder() -> Path:
    return cache_folder() / "recent"
