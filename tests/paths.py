"""Where the tests find what they read."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
"""Of the project."""

SAMPLES = ROOT / "sample_scenes"

SHARED = ROOT.parent / "shared/data"
"""Other people's data, where the folder is at hand."""

HELPERS = ROOT / "tests/helpers"
"""Modules that tests import, and programs that they start."""

SLICE = HELPERS / "slice.png"
"""A melon's face cut out of its picture (`exemplar_faces.disc`), carried along an axis: the inside that is made
soonest, for tests of what is around it."""
