"""Questions to the user, as data: the window shows them, tests answer them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Choice", "Question"]


@dataclass(frozen=True)
class Choice:
    """A button."""

    label: str
    act: Callable[[], None]
    main: bool = False


@dataclass(frozen=True)
class Question:
    """What the user must decide before anything goes on. The last choice is what Esc does."""

    title: str
    text: str
    choices: tuple[Choice, ...]
