"""Charts of a grid, as PNG bytes."""

from __future__ import annotations

import io

import matplotlib as mpl

mpl.use("Agg")  # no window, whatever the machine
import matplotlib.pyplot as plt
import numpy as np

from training.evaluate.methods.all_methods import METHODS
from training.evaluate.tables import COLUMNS, Facts

__all__ = ["bars", "scatter"]

ACCENT, OTHER, BOUND = "#FF6B4A", "#5B7A99", "#9AA0A6"
DPI = 130


def scatter(facts: Facts, across: str, up: str, scenes: list[str]) -> bytes:
    """Methods as points, one panel per scene."""
    figure, panels = plt.subplots(1, len(scenes), figsize=(4.2 * len(scenes), 3.6), squeeze=False)
    for panel, scene in zip(panels[0], scenes, strict=True):
        for method, found in facts.items():
            row = found.get(scene, {})
            if row.get(across) is None or row.get(up) is None:
                continue
            panel.plot(row[across], row[up], "o", color=colour(method), markersize=8 if method == "ours" else 6)
            panel.annotate(
                METHODS[method].title, (row[across], row[up]), xytext=(5, 3), textcoords="offset points", fontsize=7
            )
        panel.set_title(scene)
        panel.set_xlabel(COLUMNS[across].title + COLUMNS[across].arrow)
        panel.set_ylabel(COLUMNS[up].title + COLUMNS[up].arrow)
        panel.margins(0.2)
        panel.grid(alpha=0.25)
    return picture(figure)


def bars(facts: Facts, key: str, scenes: list[str]) -> bytes:
    """One figure of every method, a bar for each scene; on a logarithmic scale if the figures span over a decade."""
    methods = list(facts)
    figure, panel = plt.subplots(figsize=(2.2 + 0.95 * len(methods), 3.2))
    width = 0.8 / max(len(scenes), 1)
    shades = np.linspace(0.45, 1.0, len(scenes))
    for number, scene in enumerate(scenes):
        found = [facts[m].get(scene, {}).get(key) for m in methods]
        heights = [np.nan if height is None else height for height in found]
        places = np.arange(len(methods)) + (number - (len(scenes) - 1) / 2) * width
        panel.bar(places, heights, width, color=[colour(m) for m in methods], alpha=shades[number], label=scene)
    known = [row[key] for of in facts.values() for row in of.values() if row.get(key)]
    if known and max(known) > 10 * min(known):
        panel.set_yscale("log")
    panel.set_xticks(np.arange(len(methods)), [METHODS[m].title for m in methods], rotation=25, ha="right", fontsize=8)
    panel.set_ylabel(COLUMNS[key].title + COLUMNS[key].arrow)
    panel.set_title("from light to dark: " + ", ".join(scenes), fontsize=8)
    panel.grid(axis="y", alpha=0.25)
    return picture(figure)


def colour(method: str) -> str:
    """The colour of a method: ours stands out, bounds recede."""
    return ACCENT if method == "ours" else OTHER if METHODS[method].competes else BOUND


def picture(figure: plt.Figure) -> bytes:
    """The figure as PNG."""
    target = io.BytesIO()
    figure.tight_layout()
    figure.savefig(target, format="png", dpi=DPI)
    plt.close(figure)
    return target.getvalue()
