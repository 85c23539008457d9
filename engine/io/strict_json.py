"""JSON from somewhere else, read without the liberties that Python's reader takes."""

from __future__ import annotations

import json
import math
from typing import Any

__all__ = ["parse"]


def parse(text: bytes) -> Any:
    """The value. Raises ValueError for anything that is no JSON, also NaN, infinities, numbers that are infinite as
    floats or have thousands of digits, nesting that Python cannot follow, and keys that appear twice: which of the two
    is meant depends on the reader."""
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite, object_pairs_hook=_distinct)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text[:40])
    return number


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) < len(pairs):
        raise ValueError("a key appears twice")
    return fields
