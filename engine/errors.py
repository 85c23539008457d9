"""The only error that users see: what is wrong, in which file, and what to do."""

from __future__ import annotations

__all__ = ["InputError", "one_line"]

MAX_LENGTH = 1000
"""Most characters of a message, which quotes files and arguments of any length."""


class InputError(ValueError):
    """Input that cannot be used. The message is one line in the user's terms.

    The commands print it without a traceback and exit with status 2; the app shows it in the window.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(message: str) -> str:
    """The message without line breaks and other control characters, its middle cut out if it is too long."""
    plain = message if message.isprintable() else "".join(c if c.isprintable() else "?" for c in message)
    return plain if len(plain) <= MAX_LENGTH else f"{plain[: MAX_LENGTH * 2 // 3]} ... {plain[-MAX_LENGTH // 4 :]}"
