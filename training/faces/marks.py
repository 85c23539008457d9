"""A user's marks on the face in a picture: its outline, and where the axis meets it.

Places are fractions of the picture's width and height, from its top left corner, after a camera's orientation is
applied: they stay right when the picture is reduced. Marks come in a request; the axis may also come in a file beside
the photograph, `apple.axis.json` for `apple.jpg`:

    {"core": [0.52, 0.48]}                       of a horizontal cut
    {"line": [[0.50, 0.06], [0.53, 0.97]]}       of a radial cut, from its upper to its lower end

A cut-out made elsewhere is a black and white picture beside it, `apple.mask.png`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.fields import Fields
from engine.io.files import read_file
from engine.io.strict_json import parse

__all__ = [
    "MOST_POINTS",
    "UNMARKED",
    "Marks",
    "Place",
    "axis_beside",
    "is_mask",
    "marks_record",
    "mask_beside",
    "read_axis_file",
    "read_marks",
]

Place = tuple[float, float]
"""(x, y), fractions of a picture's width and height. Range [0, 1]."""

MOST_POINTS = 2000
"""Largest number of points of an outline; one around a face has a hundred."""

MASK = ".mask.png"

LIMIT = 1 << 12
"""Bytes of the largest axis file that is read; a real one has a hundred."""


@dataclass(frozen=True)
class Marks:
    """What is known of a picture's face; None for what is still to be found."""

    outline: tuple[Place, ...] | None = None
    """Corners of a closed polygon, three or more."""
    core: Place | None = None
    """Where the axis passes through a horizontal cut."""
    line: tuple[Place, Place] | None = None
    """Upper and lower end of the axis in a radial cut."""


UNMARKED = Marks()


def axis_beside(photograph: Path) -> Path | None:
    """The photograph's axis file; None if there is none."""
    path = photograph.with_name(f"{photograph.stem}.axis.json")
    return path if path.is_file() else None


def mask_beside(photograph: Path) -> Path | None:
    """The photograph's mask; None if there is none."""
    path = photograph.with_name(photograph.stem + MASK)
    return path if path.is_file() else None


def is_mask(path: Path) -> bool:
    """Whether a picture is another one's mask, by its name."""
    return path.name.endswith(MASK)


def read_axis_file(path: Path) -> Marks:
    """The axis in a file. Raises InputError in one line for anything else."""
    raw = read_file(path, LIMIT)
    try:
        value = parse(raw)
    except ValueError as error:
        raise InputError(f"{path}: not an axis file: it is no JSON") from error
    reader = Fields(path, "axis file")
    record = reader.table(value, "the file")
    known = bool(record) and record.keys() <= {"core", "line"}
    reader.require(known, "it has other fields than 'core' and 'line'")
    return read_marks(reader, record)


def marks_record(marks: Marks) -> dict[str, Any]:
    """Marks as JSON, without what is not known."""
    values = {"outline": marks.outline, "core": marks.core, "line": marks.line}
    return {name: value for name, value in values.items() if value is not None}


def read_marks(reader: Fields, record: dict[str, Any]) -> Marks:
    """The marks in a `marks_record`. Raises InputError if the record is not valid."""

    def place(value: Any) -> Place:
        x, y = reader.numbers(value, 2, "a place in a picture")
        reader.require(0 <= x <= 1 and 0 <= y <= 1, "a place is outside of its picture")
        return x, y

    outline = line = None
    if record.get("outline") is not None:
        outline = reader.each(record, "outline", place)
        reader.require(3 <= len(outline) <= MOST_POINTS, f"an outline has not 3 to {MOST_POINTS} points")
    if record.get("line") is not None:
        ends = reader.each(record, "line", place)
        reader.require(len(ends) == 2 and ends[0] != ends[1], "a core line has not two different ends")
        line = ends[0], ends[1]
    return Marks(outline, place(record["core"]) if record.get("core") is not None else None, line)
