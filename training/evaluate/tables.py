"""Tables of the figures of a grid: columns, the direction in which each is better, and the best values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from training.evaluate.methods.all_methods import METHODS

__all__ = ["ABLATIONS", "COLUMNS", "Column", "Facts", "Row", "Table", "table"]

Facts = dict[str, dict[str, dict[str, Any]]]
"""Figures by method, scene and key."""


@dataclass(frozen=True)
class Column:
    """One figure."""

    key: str
    title: str
    better: Literal["high", "low", "one", ""]
    """`one`: closer to 1 is better; empty: no ranking."""
    digits: int
    times: float = 1.0
    what: str = ""
    """Explanation for the legend."""

    @property
    def arrow(self) -> str:
        """Arrow in the head of the table that shows which direction is better."""
        return {"high": " ↑", "low": " ↓", "one": " → 1", "": ""}[self.better]

    def distance_from_best(self, value: float) -> float:
        """Distance of a value from the best possible one, up to a constant; the smallest is best."""
        return {"high": -value, "low": value, "one": abs(value - 1), "": 0.0}[self.better]


_COLUMNS = (
    Column("psnr_db", "PSNR dB", "high", 2, what="over the pixels of the cut face"),
    Column("ssim", "SSIM", "high", 3, what="of the face's bounding box"),
    Column("patch", "Patch distance", "low", 3, what="sliced Wasserstein distance of 7x7 patches, times 100"),
    Column("patch_ratio", "÷ another's", "low", 2, what="the same over that of another true solid of the kind"),
    Column("sharpness", "Sharpness", "one", 2, what="RMS Laplacian inside the silhouette over the truth's"),
    Column("disagreement", "Disagreement", "", 4, what="RMS colour difference of points that two cuts both show"),
    Column("fid_random", "FID", "low", 1, what="of random cuts against the true ones, EfficientNet-Lite0 features"),
    Column("kid_random", "KID, thousandths", "low", 1, 1e3, "of random cuts, likewise"),
    Column("recognised", "Recognised", "high", 3, what="the network's probability of the right class, random cuts"),
    Column("cosine_random", "Cosine", "", 3, what="mean between features of every two random cuts"),
    Column("clip_random", "CLIP", "high", 1, what="score of random cuts with 'the cross-section of a …'"),
    Column("fid_canonical", "FID", "low", 1, what="of cuts along the families"),
    Column("kid_canonical", "KID, thousandths", "low", 1, 1e3, "of cuts along the families"),
    Column("clip_canonical", "CLIP", "high", 1, what="of cuts along the families"),
    Column("surface_psnr_db", "Surface PSNR dB", "high", 2, what="views of the outside against the input"),
    Column("section_loss", "Final loss", "low", 3, what="0.3 MSE + 0.7 (1 - SSIM) of the trained sections"),
    Column("seconds", "Seconds", "low", 0, what="for the whole run"),
    Column("busy_seconds", "Busy", "low", 0, what="processor time over cores, in seconds: other work disturbs it less"),
    Column("seconds_per_cut", "Seconds a cut", "low", 2, what="for a new cut of 224 x 224"),
    Column("peak_mb", "Peak MB", "low", 0, what="memory of the process until the run ended"),
    Column("surface_atoms", "Surface atoms", "", 0),
    Column("interior_atoms", "Interior atoms", "", 0),
    Column("file_mb", "File MB", "low", 1),
    Column("iterations", "Iterations", "", 0),
    Column("refinement_rounds", "Rounds", "", 0),
)
COLUMNS = {column.key: column for column in _COLUMNS}

# The paper's three ablations: what is shown beside the full method.
ABLATIONS: dict[str, tuple[str, ...]] = {
    "Progressive refinement": ("independent", "looped", "no_refinement", "ours"),
    "Opaque atoms": ("no_clipping", "no_opacity", "ours"),
    "Voxel smoothing": ("looped_no_smoothing", "looped", "no_smoothing", "ours"),
}


@dataclass(frozen=True)
class Row:
    """A method's formatted figures, and which of them are the best."""

    method: str
    title: str
    values: list[str]
    best: list[bool]


@dataclass(frozen=True)
class Table:
    """Figures of several methods, averaged over the same scenes."""

    columns: list[Column]
    rows: list[Row]
    scenes: list[str]


def table(facts: Facts, methods: Sequence[str], keys: Sequence[str], scenes: Sequence[str]) -> Table:
    """Means over the scenes that all methods have; columns without values are omitted."""
    present = [m for m in methods if any(scene in facts.get(m, {}) for scene in scenes)]
    common = [scene for scene in scenes if all(scene in facts[m] for m in present)]
    values = {m: [mean([facts[m][s].get(key) for s in common]) for key in keys] for m in present}
    used = [i for i in range(len(keys)) if any(values[m][i] is not None for m in present)]
    used_columns = [COLUMNS[keys[i]] for i in used]
    rivals = [m for m in present if METHODS[m].competes]
    rows = []
    for m in present:
        texts, best = [], []
        for column, i in zip(used_columns, used, strict=True):
            value = values[m][i]
            texts.append("-" if value is None else f"{value * column.times:,.{column.digits}f}")
            distances = [column.distance_from_best(v) for r in rivals if (v := values[r][i]) is not None]
            ranked = column.better != "" and m in rivals and len(distances) > 1
            best.append(value is not None and ranked and column.distance_from_best(value) <= min(distances) + 1e-12)
        rows.append(Row(m, METHODS[m].title, texts, best))
    return Table(used_columns, rows, common)


def mean(values: Sequence[float | None]) -> float | None:
    """The mean, None if any value is missing."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known and len(known) == len(values) else None
