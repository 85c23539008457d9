"""The one place where picture files are decoded, by a few safe decoders, and where PNG files are written.

Pillow recognises some forty formats by content. PostScript is one of them: opening such a "picture" starts Ghostscript
with a stranger's program. So any format outside KINDS is refused before a decoder sees it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

import numpy as np
import pi_heif
from numpy.typing import NDArray
from PIL import Image, ImageCms

from engine.errors import InputError
from engine.io.files import atomic, open_file
from engine.scene.image import to_8bit

__all__ = [
    "PICTURES",
    "PICTURE_SUFFIXES",
    "check_size",
    "decoding",
    "in_srgb",
    "open_picture",
    "read_pixels",
    "restricted_decoders",
    "save_png",
]

pi_heif.register_heif_opener()

KINDS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "AVIF", "HEIF")
"""Formats by Pillow's names: those of cameras, phones, browsers and painting programs, none of which can hold a
program."""

PICTURES = f"{', '.join(KINDS[:-1])} or {KINDS[-1]}"

PICTURE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jfif", ".webp", ".bmp", ".gif"),
    *(".tif", ".tiff", ".avif", ".heic", ".heif", ".hif"),
)
"""Name endings, in lower case, by which pictures of cut faces are picked out of a folder or of dropped files."""

MAX_PIXELS = 89_478_485
"""Pillow's own limit: a quarter of a gigabyte at three bytes per pixel."""

OTHERS = {
    b"%!PS": "a PostScript file",
    b"\xc5\xd0\xd3\xc6": "a PostScript file",
    b"%PDF": "a PDF document",
    b"<svg": "an SVG drawing",
    b"<?xml": "an XML document",
    b"<!DOCTYPE": "a web page",
    b"<html": "a web page",
    b"8BPS": "a Photoshop document",
    b"\xabKTX": "a KTX texture",
    b"DDS ": "a DDS texture",
    b"#?RADIANCE": "a Radiance HDR picture",
    b"v/1\x01": "an OpenEXR picture",
    b"\0\0\0\x0cjP  ": "a JPEG 2000 picture",
    b"\0\0\0\x0cJXL ": "a JPEG XL picture",
    b"\xff\x0a": "a JPEG XL picture",
    b"PK\x03\x04": "a ZIP archive",
}
"""Files that people mistake for pictures, by their first bytes, for the error message."""

HEIF = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1")
"""ISO base media brands of phones' pictures."""

_decoder_lock = Lock()


class _Silence:
    """Hides warnings while any thread is in a block that asks for it.

    Python keeps its warning filters for the whole process: if two threads catch warnings on their own, the one that
    leaves last restores the other's filters, and the process never warns again.
    """

    def __init__(self) -> None:
        self._lock, self._blocks = Lock(), 0
        self._before = warnings.catch_warnings()

    @contextmanager
    def of(self, category: type[Warning]) -> Iterator[None]:
        """A block without warnings of this category."""
        with self._lock:
            if not self._blocks:
                self._before = warnings.catch_warnings()
                self._before.__enter__()
            self._blocks += 1
            warnings.simplefilter("ignore", category)
        try:
            yield
        finally:
            with self._lock:
                self._blocks -= 1
                if not self._blocks:
                    self._before.__exit__(None, None, None)


_silence = _Silence()


@contextmanager
def open_picture(source: str | Path | bytes, name: str | Path | None = None) -> Iterator[Image.Image]:
    """Yields a picture with only its header decoded. The block decodes the rest on use, and should do no more.

    `source` is a path, or the content of a file that messages call `name`. Raises InputError as `decoding` does, and
    for a missing file or another format. EXIF rotation is not applied; use `ImageOps.exif_transpose`.
    """
    name = source if name is None and not isinstance(source, bytes) else name
    with BytesIO(source) if isinstance(source, bytes) else open_file(source) as file, decoding(name):
        try:
            image = Image.open(file, formats=KINDS)
        except Image.UnidentifiedImageError as error:
            raise InputError(f"{name}: this is {_describe(file)}; give a {PICTURES} picture") from error
        with image:
            yield check_size(image)


def read_pixels(path: str | Path) -> NDArray[np.uint8]:
    """(H, W, 3). A picture's RGB values. Raises InputError as `open_picture` does."""
    with open_picture(path) as image:
        return np.asarray(image.convert("RGB"))


def in_srgb(image: Image.Image) -> Image.Image:
    """An 8-bit picture converted to sRGB, as RGB or RGBA, by its embedded profile: pictures of phones and cameras look
    dull without it. A profile that cannot be used is ignored."""
    mode = "RGBA" if image.has_transparency_data else "RGB"
    profile = image.info.get("icc_profile")
    if profile:
        with suppress(ImageCms.PyCMSError, OSError, ValueError):  # damaged, or of other colours than the picture
            own = ImageCms.ImageCmsProfile(BytesIO(profile))
            if image.mode not in ("RGB", "RGBA", "CMYK", "L"):
                image = image.convert(mode)
            to = "RGBA" if image.mode == "RGBA" else "RGB"
            turned = ImageCms.profileToProfile(image, own, ImageCms.createProfile("sRGB"), outputMode=to)
            if turned is not None:
                return turned.convert(mode)
    return image.convert(mode)


def save_png(path: Path, pixels: NDArray[Any], *, optimize: bool = False) -> None:
    """Writes a picture (H, W, 3 or 4), bytes or numbers of range [0, 1]; smaller, but ten times as slow, if optimised.

    Raises InputError if the file cannot be written.
    """
    image = Image.fromarray(pixels if pixels.dtype == np.uint8 else to_8bit(pixels))
    with atomic(path) as temporary:
        image.save(temporary, format="PNG", optimize=optimize)


def check_size(image: Image.Image) -> Image.Image:
    """Returns the picture. Raises DecompressionBombError if it has more than MAX_PIXELS."""
    if image.width * image.height > MAX_PIXELS:
        raise Image.DecompressionBombError
    return image


@contextmanager
def decoding(name: str | Path | None) -> Iterator[None]:
    """Turns any error that Pillow raises in the block into an InputError about picture `name`; hides its warnings."""
    try:
        with _silence.of(Warning):  # about sizes, which `check_size` limits, and harmless oddities
            yield
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"{name}: larger than {MAX_PIXELS // 10**6} megapixels; scale it down") from error
    except MemoryError as error:
        raise InputError(f"{name}: there is not enough memory for this picture; scale it down") from error
    except Exception as error:  # decoders raise anything, such as struct.error or KeyError
        raise InputError(f"{name}: this picture is damaged; save it again as {PICTURES}") from error


@contextmanager
def restricted_decoders() -> Iterator[None]:
    """Leaves Pillow only the decoders of KINDS in the block, for a library that opens pictures by itself.

    This affects the whole process; other threads wait before they enter such a block.
    """
    with _decoder_lock, _silence.of(Image.DecompressionBombWarning):
        Image.init()  # registers all decoders, so that none is added inside the block
        every = Image.ID[:]
        Image.ID[:] = KINDS
        try:
            yield
        finally:
            Image.ID[:] = every


def _describe(file: BinaryIO) -> str:
    """What a file that is not a picture is, judging by its first bytes."""
    file.seek(0)
    start = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
    if start[4:8] == b"ftyp" and start[8:12] in HEIF:
        return "a damaged HEIC picture"
    if not start:
        return "an empty file"
    return next((kind for magic, kind in OTHERS.items() if start.startswith(magic)), "no picture that can be read")
