"""What the window says about a face that was found, in plain words."""

from __future__ import annotations

from app.translation import _
from training.faces.axis import CutGuess
from training.families import Kind

__all__ = ["CUT_NAMES", "describe_guess"]

CUT_NAMES: dict[Kind, str] = {
    "horizontal": _("a cut across the core"),
    "radial": _("a cut along the core"),
    "parallel": _("a slice"),
    "custom": _("a cut"),
}

FAIRLY_SURE = 0.85
"""Sureness from which a guess is called fairly sure. Of 29 photographs and 12 pictures of our own, 11 of 13 above it
are right, and the others are level cuts of a loaf, which look like slices of one; below it 6 of 28 are wrong."""


def describe_guess(guess: CutGuess) -> str:
    """The guess in words, as in 'looks like a cut across the core, fairly sure'."""
    sure = _("fairly sure") if guess.sureness >= FAIRLY_SURE else _("not sure")
    return _("looks like {cut}, {sure}").format(cut=CUT_NAMES[guess.kind], sure=sure)
