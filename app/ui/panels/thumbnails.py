"""Small pictures from files, as textures."""

from __future__ import annotations

from pathlib import Path

import moderngl
from PIL import Image, ImageOps

from engine.errors import InputError
from engine.io.picture_file import open_picture

__all__ = ["Thumbnails"]

SIDE = 192
"""Pixels of the longer side: sharp at twice the usual density."""

KEPT = 64


class Thumbnails:
    """Loads when asked, forgets the oldest."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self.ctx = ctx
        self._held: dict[Path, tuple[int, moderngl.Texture | None]] = {}

    def get(self, path: Path) -> moderngl.Texture | None:
        """The picture, made anew when the file has changed; None where it is no picture."""
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            changed = -1
        held = self._held.pop(path, None)
        if held is None or held[0] != changed:
            if held is not None and held[1] is not None:
                held[1].release()
            held = (changed, self._load(path) if changed >= 0 else None)
        self._held[path] = held
        while len(self._held) > KEPT:
            _, old = self._held.pop(next(iter(self._held)))
            if old is not None:
                old.release()
        return held[1]

    def _load(self, path: Path) -> moderngl.Texture | None:
        try:
            with open_picture(path) as image:
                image.draft("RGB", (SIDE, SIDE))
                small = ImageOps.exif_transpose(image).convert("RGBA")
                small.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
        except InputError:
            return None
        return self.ctx.texture(small.size, 4, small.tobytes())

    def release(self) -> None:
        """Frees all."""
        for _, texture in self._held.values():
            if texture is not None:
                texture.release()
        self._held.clear()
