"""Pareto fronts: nothing is both cheaper and better."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["front"]


def front(cost: Sequence[float], value: Sequence[float]) -> list[int]:
    """Indices of the points than which no other is both cheaper and better, by rising cost."""
    order = sorted(range(len(cost)), key=lambda i: (cost[i], -value[i]))
    kept: list[int] = []
    for i in order:
        if not kept or value[i] > value[kept[-1]]:
            kept.append(i)
    return kept
