"""Thumbnails of picture files, as textures."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import moderngl
from PIL import Image, ImageOps

from engine.errors import InputError
from engine.io.picture_file import in_srgb, open_picture

__all__ = ["Thumbnails"]

SIDE = 192
"""Pixels of the longer side: sharp even on a screen of twice the usual density."""

CAPACITY = 64
"""Most thumbnails in the cache: more than a window shows at once, a few MB of textures."""


class Thumbnails:
    """A cache of thumbnails that drops the least recently used one. Pictures are decoded in a thread: one from a phone
    takes half a second."""

    def __init__(self, ctx: moderngl.Context, side: int = SIDE) -> None:
        self.ctx, self.side = ctx, side
        self._worker = ThreadPoolExecutor(1, "thumbnails")
        self._cache: dict[Path, _Entry] = {}

    def get(self, path: Path) -> moderngl.Texture | None:
        """The thumbnail of a file; None until there is one. For a file that has changed, the old thumbnail is returned
        until the new one is ready. Never waits."""
        entry = self._entry(path)
        if entry.read is not None and entry.read.done():
            small, entry.read = entry.read.result(), None
            entry.release()
            entry.texture = None if small is None else self.ctx.texture(small.size, 4, small.tobytes())
        return entry.texture

    def is_none(self, path: Path) -> bool:
        """Whether a file is known not to be a picture."""
        return self.get(path) is None and self._entry(path).read is None

    def _entry(self, path: Path) -> _Entry:
        try:
            changed = path.stat().st_mtime_ns
        except OSError:
            changed = -1
        entry = self._cache.pop(path, None) or _Entry()
        if entry.changed != changed:
            entry.changed, entry.read = changed, self._worker.submit(_decoded, path, self.side)
        self._cache[path] = entry
        while len(self._cache) > CAPACITY:
            self._cache.pop(next(iter(self._cache))).release()
        return entry

    def release(self) -> None:
        """Frees all textures, and stops decoding."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        for entry in self._cache.values():
            entry.release()
        self._cache.clear()


@dataclass
class _Entry:
    """The cache entry of one file."""

    changed: int | None = None
    """When the file was changed, in nanoseconds; -1 if there is no file."""
    read: Future[Image.Image | None] | None = None
    """The picture that is being decoded."""
    texture: moderngl.Texture | None = None

    def release(self) -> None:
        """Frees the texture."""
        if self.texture is not None:
            self.texture.release()


def _decoded(path: Path, side: int) -> Image.Image | None:
    """The picture in a file, reduced to at most `side` pixels along its longer side; None if it is not a picture."""
    try:
        with open_picture(path) as image:
            image.draft("RGB", (side, side))
            small = ImageOps.exif_transpose(image).convert("RGBA")
            small.thumbnail((side, side), Image.Resampling.LANCZOS)
            return in_srgb(small)
    except InputError:
        return None
