"""What every reader promises for any input, and the checks of these promises."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from benchmarks.readers.guard import Forbidden, guarded
from engine.errors import InputError
from training.batch.manifest import ManifestErrors

__all__ = ["Target", "result_or_refusal", "words_wrong"]

LONGEST = 1000
"""Characters of the longest message a user is shown: a path, what is wrong with it, what to do."""

CODE_WORDS = re.compile(
    r"Traceback|dtype|<class|<\w[\w.]* object|object at 0x|\[Errno|\b[A-Z]\w*(Error|Exception|Warning)\b"
    r"|\bb'|\\x[0-9a-f]{2}|\bNoneType\b|\bndarray\b|codec can't"
)
"""Programmers' words: a message with one of them was not written for users."""


@dataclass(frozen=True)
class Target:
    """A reader of something that a user may supply."""

    inputs: st.SearchStrategy[Any]
    check: Callable[[Any, Path], bool]
    """Whether the input was accepted; raises if the promise is broken. The path is a folder to write in."""
    share: float
    """Inputs of this target, as a fraction of the number asked for."""


def words_wrong(text: str, *quoted: str) -> str:
    """What is wrong with a message to the user; empty if nothing is. `quoted`: text from the file it may repeat."""
    if not text.strip():
        return "empty"
    if not text.isprintable():
        return "not one printable line"
    if len(text) > LONGEST:
        return f"{len(text)} characters long"
    for name in quoted:
        text = text.replace(name, "")
    found = CODE_WORDS.search(text)
    return f"in a programmer's words ('{found[0]}')" if found else ""


def result_or_refusal(read: Callable[[], Any], *near: Path) -> Any:
    """The result of `read`, or None if it refuses properly: with an InputError of printable lines.

    `read` may read files in the folders `near`, and do nothing else.
    """
    try:
        with guarded(*near) as tried:
            result = read()
    except InputError as error:
        result = None
        for line in str(error).split("\n") if isinstance(error, ManifestErrors) else [str(error)]:
            # Text quoted from a file is not the message's own.
            assert not (wrong := words_wrong(re.sub(r"'[^']*'", "", line))), (
                f"a refusal that is {wrong}: {line!r:.1000}"
            )
            assert line.isprintable() and len(line) <= LONGEST, f"no readable line: {line[:LONGEST]!r}"
    except Forbidden as error:
        raise AssertionError(f"it should only read: {error}") from error
    assert not tried, f"it should only read: {tried[0]}"
    return result
