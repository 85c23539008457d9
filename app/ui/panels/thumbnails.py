"""Thumbnails of picture files, as textures."""

from __future__ import annotations

from pathlib import Path

import moderngl
from PIL import Image, ImageOps

from engine.errors import InputError
from engine.io.picture_file import open_picture

__all__ = ["Thumbnails"]

SIDE = 192
"""Pixels of the longer side: sharp even on a screen of twice the usual density."""

CAPACITY = 64
"""Thumbnails in the cache: more than a window shows at once, a few MB of textures."""


class Thumbnails:
    """A cache of thumbnails that drops the least recently used one."""

    def __init__(self, ctx: moderngl.Context, side: int = SIDE) -> None:
        self.ctx, self.side = ctx, side
        self._cache: dict[Path, tuple[int, moderngl.Texture | None]] = {}

    def get(self, path: Path) -> moderngl.Texture | None:
        """The thumbnail of a file, loaded again if the file has changed; None if it is not a picture."""
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            changed = -1
        entry = self._cache.pop(path, None)
        if entry is None or entry[0] != changed:
            if entry is not None and entry[1] is not None:
                entry[1].release()
            entry = (changed, self._load(path) if changed >= 0 else None)
        self._cache[path] = entry
        while len(self._cache) > CAPACITY:
            _, dropped = self._cache.pop(next(iter(self._cache)))
            if dropped is not None:
                dropped.release()
        return entry[1]

    def _load(self, path: Path) -> moderngl.Texture | None:
        try:
            with open_picture(path) as image:
                image.draft("RGB", (self.side, self.side))
                small = ImageOps.exif_transpose(image).convert("RGBA")
                small.thumbnail((self.side, self.side), Image.Resampling.LANCZOS)
        except InputError:
            return None
        return self.ctx.texture(small.size, 4, small.tobytes())

    def release(self) -> None:
        """Frees all textures."""
        for _, texture in self._cache.values():
            if texture is not None:
                texture.release()
        self._cache.clear()
