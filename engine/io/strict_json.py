"""Parses untrusted JSON more strictly than Python's reader."""

from __future__ import annotations

import json
import math
from typing import Any

__all__ = ["parse"]


def parse(text: bytes) -> Any:
    """Parses JSON. Raises ValueError for anything else, including NaN, infinities, numbers that are infinite as
    floats or have thousands of digits, nesting too deep for Python, and duplicate keys, which readers resolve
    differently."""
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
