"""Procedural solids. Each function takes a seed; every seed gives a different specimen."""

from __future__ import annotations

from collections.abc import Callable

from sample_scenes.solids.apple import apple
from sample_scenes.solids.bread import bread
from sample_scenes.solids.cake import cake
from sample_scenes.solids.orange import orange
from sample_scenes.solids.pomegranate import pomegranate
from sample_scenes.solids.solid import Solid
from sample_scenes.solids.watermelon import watermelon

__all__ = ["SOLIDS", "Solid", "apple", "bread", "cake", "orange", "pomegranate", "watermelon"]

SOLIDS: dict[str, Callable[[int], Solid]] = {
    "watermelon": watermelon,
    "orange": orange,
    "bread": bread,
    "apple": apple,
    "pomegranate": pomegranate,
    "cake": cake,
}
"""Functions that make a solid, by name."""
