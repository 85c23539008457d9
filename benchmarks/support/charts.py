"""Charts: drawn without a window, written atomically."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from engine.io.files import atomic

mpl.use("Agg")
from matplotlib import pyplot as plt

__all__ = ["ACCENT", "OTHER", "QUIET", "front", "plt", "save_chart"]

ACCENT, OTHER, QUIET = "#FF6B4A", "#5B7A99", "#8F949C"
"""Colours of our own or marked figures, of the rest, and of guide lines."""

DPI = 120
"""A ten-inch chart is then as wide as the README's page."""


def save_chart(figure: plt.Figure, path: Path) -> None:
    """Writes the figure as PNG, and closes it."""
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)
    plt.close(figure)


def front(cost: Sequence[float], value: Sequence[float]) -> list[int]:
    """The Pareto front: indices of the points for which no other is both cheaper and better, by rising cost."""
    order = sorted(range(len(cost)), key=lambda i: (cost[i], -value[i]))
    kept: list[int] = []
    for i in order:
        if not kept or value[i] > value[kept[-1]]:
            kept.append(i)
    return kept
