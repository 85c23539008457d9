"""Bad input is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from engine.errors import InputError

__all__ = ["refusal"]


def refusal(read: Callable[[], object], begins: str | Path = "") -> str:
    """The line with which input is refused; asserts that it begins with these words and has no programmers' words."""
    with pytest.raises(InputError) as caught:
        read()
    line = str(caught.value)
    assert line.startswith(str(begins))
    assert "\n" not in line
    assert not begins or len(line) < len(str(begins)) + 160
    assert not any(word in line for word in ("Error", "Traceback", "plyfile", "numpy", "dtype"))
    return line
