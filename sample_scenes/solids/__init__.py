"""The solids. Each maker takes a seed: another seed is another true fruit of the kind."""

from __future__ import annotations

from collections.abc import Callable

from sample_scenes.solids.bread import bread
from sample_scenes.solids.orange import orange
from sample_scenes.solids.solid import Solid, directions
from sample_scenes.solids.watermelon import watermelon

__all__ = ["SOLIDS", "Solid", "bread", "directions", "orange", "watermelon"]

SOLIDS: dict[str, Callable[[int], Solid]] = {
    "watermelon": watermelon,
    "orange": orange,
    "bread": bread,
}
"""Makers by name."""
