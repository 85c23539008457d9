"""The chart of seconds by stage against threads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.support.charts import ACCENT, QUIET, plt, save_chart

__all__ = ["chart"]

SMALL = 0.01
"""Part of the whole on one thread below which a stage has no line."""


def chart(rows: Sequence[dict[str, Any]], cores: int, path: Path) -> None:
    """A panel for each scene and part: a line for each stage, and one for work that is shared evenly."""
    panels: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in sorted(rows, key=lambda row: row["threads"]):
        panels.setdefault((row["scene"], row["part"]), []).append(row)
    figure, axes = plt.subplots(
        1, len(panels), figsize=(5.4 * len(panels), 4.6), constrained_layout=True, squeeze=False
    )
    for axis, ((scene, part), lines) in zip(axes[0], panels.items(), strict=True):
        threads, first = [row["threads"] for row in lines], lines[0]["seconds"]
        names = [name for name in first if first[name] >= SMALL * first.get("whole", 0)]
        for name in names:
            seconds = [row["seconds"][name] for row in lines]
            style: dict[str, Any] = {"color": ACCENT, "linewidth": 2.2} if name == "whole" else {"linewidth": 1.2}
            axis.plot(threads, seconds, "o-", markersize=4, label=name, **style)
        largest = max(first[name] for name in names)
        ideal = [largest * threads[0] / n for n in threads]
        axis.plot(threads, ideal, "--", color=QUIET, linewidth=1, label="evenly shared")
        axis.set(xscale="log", yscale="log", xlabel="threads", ylabel="seconds", title=f"{scene}, {part}")
        axis.set_xticks(threads, [str(n) for n in threads])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, ncols=4, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.13))
    figure.suptitle(f"Seconds against threads, a machine of {cores} processors", fontsize=10)
    save_chart(figure, path)
