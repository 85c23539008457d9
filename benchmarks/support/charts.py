"""Charts: drawn without a window, written as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from engine.io.files import atomic

mpl.use("Agg")
from matplotlib import pyplot as plt

__all__ = ["ACCENT", "OTHER", "QUIET", "front", "plt", "save_chart"]

ACCENT, OTHER, QUIET = "#FF6B4A", "#5B7A99", "#8F949C"
"""Colours of what is ours or marked, of the rest, and of lines that lead the eye."""

DPI = 120
"""A chart ten inches wide is then as wide as the README's page is drawn."""


def save_chart(figure: plt.Figure, path: Path) -> None:
    """Writes the figure as PNG, and closes it."""
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=DPI)
    plt.close(figure)


def front(cost: Sequence[float], value: Sequence[float]) -> list[int]:
    """The Pareto front: indices of the points than which no other is both cheaper and better, by rising cost."""
    order = sorted(range(len(cost)), key=lambda i: (cost[i], -value[i]))
    kept: list[int] = []
    for i in order:
        if not kept or value[i] > value[kept[-1]]:
            kept.append(i)
    return kept
