"""The one error a user may see: what is wrong, in which file, and what to do."""

from __future__ import annotations

__all__ = ["InputError"]


class InputError(ValueError):
    """Input that cannot be used. The message is one line in the user's language.

    The commands print it without a traceback and exit with status 2; the app shows it in the window.
    """
