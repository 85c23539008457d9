"""Typed values out of parsed JSON, or one line that says which field is wrong and why."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from engine.errors import InputError

__all__ = ["LARGEST_INTEGER", "LONGEST_TEXT", "UNIT_TOLERANCE", "Fields"]

LARGEST_INTEGER = 1 << 53
"""Largest integer in our files: other JSON readers hold numbers as doubles, which are exact no further."""

LARGEST_NUMBER = 1e12
"""Largest of all other numbers: far beyond any scene, and its square and cube still fit a float32 or a double."""

LONGEST_TEXT = 10_000
LONGEST_PATH = 4096
"""Most characters of a text, and of a path as Linux allows it."""

UNIT_TOLERANCE = 1e-6
"""How far the length of a unit vector in a file may be from 1: rounding to six digits."""

T = TypeVar("T")


class Fields:
    """Reads the fields of one file. Every method raises InputError unless the value has the type and range it names."""

    def __init__(self, path: Path, kind: str) -> None:
        """`kind`: what the file should be, as in 'project'."""
        self.path, self.kind = path, kind

    def require(self, condition: bool, wrong: str) -> None:
        """Raises InputError with what is wrong unless the condition holds."""
        if not condition:
            raise InputError(f"{self.path}: not a {self.kind}: {wrong}")

    def table(self, value: Any, what: str) -> dict[str, Any]:
        """A JSON object."""
        self.require(isinstance(value, dict), f"{what} is no table")
        return value

    def each(self, fields: dict[str, Any], key: str, read: Callable[[Any], T]) -> tuple[T, ...]:
        """A list, each entry read by `read`."""
        values = fields.get(key)
        self.require(isinstance(values, list), f"no list '{key}'")
        return tuple(read(value) for value in values or ())

    def text(self, fields: dict[str, Any], key: str) -> str:
        """Text that can be shown and passed to other programs: without null characters or lone surrogates."""
        value = fields.get(key)
        text = value if isinstance(value, str) else "\0"
        plain = not any(c == "\0" or "\ud800" <= c <= "\udfff" for c in text)
        self.require(plain and len(text) <= LONGEST_TEXT, f"no text '{key}'")
        return text

    def choice(self, fields: dict[str, Any], key: str, allowed: tuple[Any, ...]) -> Any:
        """One of a few words."""
        value = fields.get(key)
        self.require(isinstance(value, str) and value in allowed, f"'{key}' is none of {', '.join(allowed)}")
        return value

    def flag(self, fields: dict[str, Any], key: str) -> bool:
        """true or false."""
        value = fields.get(key)
        self.require(isinstance(value, bool), f"'{key}' is neither true nor false")
        return bool(value)

    def integer(self, fields: dict[str, Any], key: str, low: int, high: int = LARGEST_INTEGER) -> int:
        """An integer in [low, high]."""
        value = fields.get(key)
        self.require(type(value) is int and low <= value <= high, f"'{key}' is no whole number from {low} to {high}")
        return value if isinstance(value, int) else 0

    def number(
        self, fields: dict[str, Any], key: str, low: float = -LARGEST_NUMBER, high: float = LARGEST_NUMBER
    ) -> float:
        """A number in [low, high]."""
        value = self.numbers([fields.get(key)], 1, f"'{key}'")[0]
        self.require(low <= value <= high, f"'{key}' is not between {low:g} and {high:g}")
        return value

    def numbers(self, values: Any, count: int, what: str) -> list[float]:
        """A list of `count` numbers."""
        ok = isinstance(values, list) and len(values) == count
        ok = ok and all(type(v) in (int, float) and abs(v) <= LARGEST_NUMBER for v in values)  # false for NaN
        self.require(ok, f"{what} is not {'a number' if count == 1 else f'{count} numbers'}")
        return [float(v) for v in values]

    def unit(self, fields: dict[str, Any], key: str) -> tuple[float, float, float] | None:
        """A unit vector, or null."""
        if fields.get(key) is None:
            return None
        x, y, z = self.numbers(fields[key], 3, f"'{key}'")
        self.require(abs(math.hypot(x, y, z) - 1) < UNIT_TOLERANCE, f"'{key}' has not length 1")
        return x, y, z

    def path_text(self, value: Any, what: str) -> str:
        """Text that can be a path."""
        self.require(
            isinstance(value, str) and 0 < len(value) < LONGEST_PATH and "\0" not in value, f"{what} is no path"
        )
        return value
