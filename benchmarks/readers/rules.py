"""What every reader promises, whatever it is given, and what may become of an input."""

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

__all__ = ["Target", "refused", "words_wrong"]

LONGEST = 1000
"""Characters of the longest line that a user is shown: a path, what is wrong with it, what to do."""

CODE_WORDS = re.compile(
    r"Traceback|dtype|<class|<\w[\w.]* object|object at 0x|\[Errno|\b[A-Z]\w*(Error|Exception|Warning)\b"
    r"|\bb'|\\x[0-9a-f]{2}|\bNoneType\b|\bndarray\b|codec can't"
)
"""What belongs to programmers: a message that holds it was not written for people."""


@dataclass(frozen=True)
class Target:
    """Something that reads what a user may give it."""

    inputs: st.SearchStrategy[Any]
    check: Callable[[Any, Path], bool]
    """Whether the input was accepted; raises where the promise is broken. The path is a folder to write in."""
    share: float
    """Of all inputs."""


def words_wrong(text: str, *quoted: str) -> str:
    """What is wrong with a message to the user; empty: nothing. `quoted`: what it may repeat of a file."""
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


def refused(read: Callable[[], Any], *near: Path) -> Any:
    """What `read` gives, None where it refuses as it should: an InputError of printable lines.

    It may read what is in the folders `near`, and do nothing else.
    """
    try:
        with guarded(*near) as tried:
            result = read()
    except InputError as error:
        result = None
        for line in str(error).split("\n") if isinstance(error, ManifestErrors) else [str(error)]:
            # What it quotes of a file is not its own words.
            assert not (wrong := words_wrong(re.sub(r"'[^']*'", "", line))), (
                f"a refusal that is {wrong}: {line!r:.1000}"
            )
            assert line.isprintable() and len(line) <= LONGEST, f"no readable line: {line[:LONGEST]!r}"
    except Forbidden as error:
        raise AssertionError(f"it should only read: {error}") from error
    assert not tried, f"it should only read: {tried[0]}"
    return result
