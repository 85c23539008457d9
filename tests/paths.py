"""Paths that the tests read from."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[1]
"""Folder of the project."""

SAMPLES = ROOT / "sample_scenes"

SHARED = ROOT.parent / "shared/data"
"""Data by other people, where that folder exists."""

HELPERS = ROOT / "tests/helpers"
"""Modules that tests import, and programs that they start."""

SLICE = HELPERS / "slice.png"
"""A melon's face cut out of its picture (`exemplar_faces.disc`), extruded along an axis: the inside that is quickest to
make, for tests of everything else."""
