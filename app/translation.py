"""Texts that the user reads, in the user's language: GNU gettext catalogues, read by the standard library.

A catalogue lies in app/locale/LANGUAGE/LC_MESSAGES/fruitninja.mo; LANGUAGE, LC_ALL, LC_MESSAGES or LANG select one, as
in other programs. Without a catalogue, texts are shown as they are written in the code.
"""

from __future__ import annotations

import gettext
from pathlib import Path

__all__ = ["_", "install", "ngettext"]

LOCALE = Path(__file__).parent / "locale"

_catalogue = gettext.translation("fruitninja", LOCALE, fallback=True)


def _(text: str) -> str:
    """The text in the user's language. Placeholders are filled in afterwards: `_("Saved {name}.").format(...)`.

    Modules with tables of texts call this when they are imported: the language is chosen before that, and stays.
    """
    return _catalogue.gettext(text)


def ngettext(one: str, many: str, count: int) -> str:
    """The form of a text for a count: one of the two given, or of as many as the user's language has."""
    return _catalogue.ngettext(one, many, count)


def install(catalogue: gettext.NullTranslations) -> None:
    """Uses this catalogue, whatever the user's language is. For tests, before any module with texts is imported."""
    global _catalogue
    _catalogue = catalogue
