"""What the window says of a face that was found, in words that need no explanation."""

from __future__ import annotations

from training.faces.axis import CutGuess
from training.families import Kind

__all__ = ["CUT_NAMES", "describe_guess"]

CUT_NAMES: dict[Kind, str] = {
    "horizontal": "a cut across the core",
    "radial": "a cut along the core",
    "parallel": "a slice",
    "custom": "a cut",
}

SURE, FAIRLY_SURE = 0.9, 0.65
"""Probabilities from which a guess is called so: of twenty that are sure at most two are wrong; below the second, two
kinds of cut are nearly as likely."""


def describe_guess(guess: CutGuess) -> str:
    """As in 'looks like a cut across the core, fairly sure'."""
    sure = "sure" if guess.sureness >= SURE else "fairly sure" if guess.sureness >= FAIRLY_SURE else "not sure"
    return f"looks like {CUT_NAMES[guess.kind]}, {sure}"
