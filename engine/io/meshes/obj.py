"""Relative indices of .obj files, which trimesh takes for those of the whole file."""

from __future__ import annotations

import io
import re
from typing import BinaryIO

__all__ = ["absolute_indices"]

RELATIVE = re.compile(rb"^[ \t]*f[ \t].*[ \t/]-[0-9]", re.MULTILINE)
"""A face with an index that counts back from the last point, texture coordinate or normal so far."""

LISTS = (b"v", b"vt", b"vn")
"""Words before what the parts of a corner, as in 1/2/3, are indices of."""


def absolute_indices(file: BinaryIO) -> BinaryIO:
    """The .obj file, or one in memory in which all indices count from its beginning."""
    text = file.read()
    file.seek(0)
    if not RELATIVE.search(text):
        return file
    counts = dict.fromkeys(LISTS, 0)
    lines = text.split(b"\n")
    for n, line in enumerate(lines):
        word, *corners = line.split() or [b""]
        if word in counts:
            counts[word] += 1
        elif word == b"f":
            absolute = [
                b"/".join(_absolute(index, counts[of]) for index, of in zip(corner.split(b"/"), LISTS, strict=False))
                for corner in corners
            ]
            lines[n] = b" ".join([word, *absolute])
    return io.BytesIO(b"\n".join(lines))


def _absolute(index: bytes, count: int) -> bytes:
    return b"%d" % (count + 1 + int(index)) if re.fullmatch(rb"-[0-9]{1,9}", index) else index
