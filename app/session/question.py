"""Questions to the user as data: the window shows them, tests answer them without a window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Choice", "Question"]


@dataclass(frozen=True)
class Choice:
    """An answer, as a button."""

    label: str
    act: Callable[[], None]
    main: bool = False
    """Whether it is the default, which stands out."""


@dataclass(frozen=True)
class Question:
    """A decision that the user has to make before going on. Esc takes the last choice."""

    title: str
    text: str
    choices: tuple[Choice, ...]
