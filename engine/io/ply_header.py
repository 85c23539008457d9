"""Reads and checks the header of a .ply file, up to a limit and against the size of the file.

plyfile checks the types; nothing is allocated on the header's word alone.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData, PlyElement, PlyListProperty, PlyParseError

from engine.errors import InputError
from engine.io.files import open_file

__all__ = ["Element", "Header", "read_header"]

HEADER_LIMIT = 1 << 20
"""Most bytes of a header: a 3DGS header has 2 KB, so this leaves room for any comment."""


@dataclass(frozen=True)
class Element:
    """One element of a .ply header."""

    name: str
    count: int
    properties: tuple[str, ...]
    dtype: np.dtype[np.void] | None
    """Type of a row of a binary file; None if rows hold lists and so have no fixed size."""
    layout: tuple[tuple[np.dtype[Any] | None, np.dtype[Any]], ...]
    """For each property of a binary row, the type of a list's length (None for a plain number) and of the values."""
    min_row: int
    """Least number of bytes of a row, in this file's format."""


@dataclass(frozen=True)
class Header:
    """The header of a .ply, its counts checked against the size of the file."""

    ascii: bool
    elements: tuple[Element, ...]
    data: int
    """Offset of the first row, bytes."""
    comments: tuple[str, ...]
    """The comments, without the word 'comment'."""

    def element(self, name: str) -> Element | None:
        """The element of this name, or None."""
        return next((e for e in self.elements if e.name == name), None)

    @property
    def faces(self) -> int:
        """Number of faces; 0 for anything but a mesh."""
        face = self.element("face")
        return face.count if face else 0

    @property
    def is_splats(self) -> bool:
        """Whether the vertices are Gaussians, even if incomplete or packed."""
        vertex = self.element("vertex")
        names = set(vertex.properties) if vertex else set()
        return not names.isdisjoint({"scale_0", "rot_0", "f_dc_0", "packed_position"})


def read_header(path: str | Path) -> Header:
    """The header of any .ply, mesh or splats, checked to promise no more than the file can hold.

    Reads at most 1 MB. Raises InputError if the file is no .ply or its header is broken.
    """
    path = Path(path)
    with open_file(path) as file:
        text = file.read(HEADER_LIMIT)
        size = os.fstat(file.fileno()).st_size
    if not size:
        raise InputError(f"{path}: the file is empty")
    start = re.match(rb"ply[ \t]*(\r\n|\n|\r)", text)
    if not start:
        raise InputError(f"{path}: not a .ply file")
    # A header may mix two line endings, because tools add lines without checking. A newline belongs to the data only
    # if lines end in a lone carriage return.
    mac = start[1] == b"\r"
    end = re.search(rb"\rend_header[ \t]*\r" if mac else rb"\nend_header[ \t]*\r?\n", text)
    if not end:
        raise InputError(f"{path}: broken .ply header: it does not end")
    lines = text[: end.start()].decode("latin-1").split("\r" if mac else "\n")
    header = _parse(path, lines, end.end())
    room = size - header.data + header.ascii  # the last row of an ascii file may lack its newline
    for element in header.elements:
        room -= element.count * element.min_row
        if room < 0:
            fits = max(0, room // max(1, element.min_row) + element.count)
            raise InputError(
                f"{path}: truncated or damaged: the header promises {element.count:,} rows of '{element.name}', "
                f"the file has room for {fits:,} at most"
            )
    return header


def _parse(path: Path, lines: list[str], data: int) -> Header:
    """The header from its lines, without the last one, 'end_header'.

    plyfile gets a copy of the header in which every element is empty, so it checks the types and allocates nothing.
    """
    counts: list[int] = []
    names: set[str] = set()  # of the current element
    comments: list[str] = []
    empty_copy = ["ply"]
    for number, line in enumerate(lines[1:], start=2):
        words = line.split()
        if words and words[0] in ("comment", "obj_info"):
            comments.append(" ".join(words[1:]))
            empty_copy.append("comment")  # the text may not be ASCII, or stand where plyfile accepts none
            continue
        if words and words[0] == "element":
            if len(words) != 3 or not re.fullmatch(r"[0-9]{1,18}", words[2]):
                raise InputError(f"{path}: broken .ply header: line {number} is no 'element NAME COUNT'")
            counts.append(int(words[2]))
            words[2] = "0"
            names = set()
        if words and words[0] == "property":
            if words[-1] in names:
                raise InputError(f"{path}: broken .ply header: property {words[-1][:40]!r} appears twice")
            names.add(words[-1])
        empty_copy.append(" ".join(words))
    try:
        parsed = PlyData.read(BytesIO("\n".join([*empty_copy, "end_header", ""]).encode("ascii")))
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: broken .ply header: it holds characters that are not ASCII") from error
    except (PlyParseError, ValueError) as error:
        said = " ".join(str(error).split())[:120]
        plain = said.isprintable() and "\\" not in said  # otherwise plyfile quotes unprintable text
        raise InputError(f"{path}: broken .ply header: {said if plain else 'export the file again'}") from error
    elements = tuple(_element(e, n, parsed) for e, n in zip(parsed.elements, counts, strict=True))
    return Header(parsed.text, elements, data, tuple(comments))


def _element(element: PlyElement, count: int, parsed: PlyData) -> Element:
    """An element as plyfile read it, with its real count."""
    order = parsed.byte_order
    layout = tuple(
        (np.dtype(p.list_dtype(order)[0]), np.dtype(p.list_dtype(order)[1]))
        if isinstance(p, PlyListProperty)
        else (None, np.dtype(p.dtype(order)))
        for p in element.properties
    )
    return Element(
        element.name,
        count,
        tuple(p.name for p in element.properties),
        None if any(length is not None for length, _ in layout) else np.dtype(element.dtype(order)),
        layout,
        # Text: a digit and a separator per number. Binary: a number, or the length of an empty list.
        max(1, 2 * len(layout))
        if parsed.text
        else sum((value if length is None else length).itemsize for length, value in layout),
    )
