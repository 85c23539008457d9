"""Words that the user reads, in the user's language: GNU gettext's catalogues, by the standard library.

A catalogue lies in app/locale/LANGUAGE/LC_MESSAGES/fruitninja.mo; which one counts is said by LANGUAGE, LC_ALL,
LC_MESSAGES or LANG, as in other programs. Without one, words are as they are written in the code.
"""

from __future__ import annotations

import gettext
from pathlib import Path

__all__ = ["_", "install", "ngettext"]

LOCALE = Path(__file__).parent / "locale"

_catalogue = gettext.translation("fruitninja", LOCALE, fallback=True)


def _(text: str) -> str:
    """The text in the user's language. Placeholders are filled in afterwards: `_("Saved {name}.").format(...)`.

    Called when a module with a table of words is imported, too: the language is chosen before that, and stays.
    """
    return _catalogue.gettext(text)


def ngettext(one: str, many: str, count: int) -> str:
    """One of the two, or of as many as the language has, for a count."""
    return _catalogue.ngettext(one, many, count)


def install(catalogue: gettext.NullTranslations) -> None:
    """Takes this catalogue, whatever the user's language is. For tests, before anything with words is imported."""
    global _catalogue
    _catalogue = catalogue
