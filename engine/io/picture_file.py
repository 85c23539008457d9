"""Pictures from files: the one place where they are decoded, by a few decoders that only decode.

Pillow goes by a file's content and knows some forty kinds of it. PostScript is one: whoever opens such a "picture"
starts Ghostscript with a stranger's program. So what is none of KINDS is refused before any decoder sees it.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from engine.errors import InputError
from engine.io.files import open_file

__all__ = ["PICTURES", "bounded", "decoding", "known_decoders", "open_picture", "read_pixels"]

KINDS = ("PNG", "JPEG", "WEBP", "BMP", "GIF", "TIFF", "AVIF")
"""Decoders as Pillow calls them: what cameras, browsers and painting programs write, and nothing that is a program."""

PICTURES = f"{', '.join(KINDS[:-1])} or {KINDS[-1]}"

MOST_PIXELS = 89_478_485
"""Pillow's own line: a quarter of a gigabyte at three bytes a pixel."""

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
"""What people take for pictures, by how it begins, so that they are told what they have."""

HEIF = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1")
"""Brands of the pictures that telephones take."""

_changing = Lock()


@contextmanager
def open_picture(source: str | Path | bytes, name: str | Path | None = None) -> Iterator[Image.Image]:
    """Yields a picture, decoded as far as its header. The rest follows when the block uses it, which should do no more.

    `source` is a path, or the file's content, which messages then call `name`. Raises InputError as `decoding`, and
    for a file that is not there or of another kind. Whoever wants it upright applies `ImageOps.exif_transpose`.
    """
    name = source if name is None and not isinstance(source, bytes) else name
    with BytesIO(source) if isinstance(source, bytes) else open_file(source) as file, decoding(name):
        try:
            image = Image.open(file, formats=KINDS)
        except Image.UnidentifiedImageError as error:
            raise InputError(f"{name}: this is {_kind(file)}; give a {PICTURES} picture") from error
        with image:
            yield bounded(image)


def read_pixels(path: str | Path) -> NDArray[np.uint8]:
    """(H, W, 3). A picture's colours, whatever it holds besides. Raises InputError as `open_picture`."""
    with open_picture(path) as image:
        return np.asarray(image.convert("RGB"))


def bounded(image: Image.Image) -> Image.Image:
    """The picture. Raises DecompressionBombError where it has more than MOST_PIXELS."""
    if image.width * image.height > MOST_PIXELS:
        raise Image.DecompressionBombError
    return image


@contextmanager
def decoding(name: str | Path | None) -> Iterator[None]:
    """Turns whatever Pillow raises in the block into an InputError about the picture `name`, and silences it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of sizes, which `bounded` knows, and of oddities that do no harm
            yield
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"{name}: larger than {MOST_PIXELS // 10**6} megapixels; scale it down") from error
    except MemoryError as error:
        raise InputError(f"{name}: there is not enough memory for this picture; scale it down") from error
    except Exception as error:  # decoders let through whatever they stumble over, such as struct.error or KeyError
        raise InputError(f"{name}: this picture is damaged; save it again as {PICTURES}") from error


@contextmanager
def known_decoders() -> Iterator[None]:
    """Until the block ends, Pillow has no decoders but KINDS: for a library that opens pictures by itself.

    That holds for the whole process, and other threads wait for the end of such a block before they get into one.
    """
    with _changing, warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        Image.init()  # registers all there are, so that none is added while the list is short
        every = Image.ID[:]
        Image.ID[:] = KINDS
        try:
            yield
        finally:
            Image.ID[:] = every


def _kind(file: BinaryIO) -> str:
    """What a file is that is no picture, as far as its beginning tells."""
    file.seek(0)
    start = file.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
    if start[4:8] == b"ftyp" and start[8:12] in HEIF:
        return "a HEIC picture"
    if not start:
        return "an empty file"
    return next((kind for magic, kind in OTHERS.items() if start.startswith(magic)), "no picture that can be read")
