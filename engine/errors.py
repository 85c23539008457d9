"""The one error a user may see: what is wrong, in which file, and what to do."""

from __future__ import annotations

__all__ = ["InputError", "one_line"]

LONGEST = 1000
"""Characters of a message. Files and arguments are quoted in it, and they may be of any length."""


class InputError(ValueError):
    """Input that cannot be used. The message is one line in the user's language.

    The commands print it without a traceback and exit with status 2; the app shows it in the window.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(message: str) -> str:
    """The message without line breaks and other signs that a terminal obeys, the middle left out where it is long."""
    plain = message if message.isprintable() else "".join(c if c.isprintable() else "?" for c in message)
    return plain if len(plain) <= LONGEST else f"{plain[: LONGEST * 2 // 3]} ... {plain[-LONGEST // 4 :]}"
