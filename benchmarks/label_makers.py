"""Where labels come from: per-plane SDS, per-plane x0, the paper's loop, and one volume solved for all planes.

    python -m benchmarks.label_makers [--scenes bread,orange] [--detail draft] [--quick] [-o docs/charts]

The same exemplars, fill, training and held-out cuts; one prior, queried in four ways. Writes label_makers.json,
label_makers.png (figures against processor time, which a loaded machine disturbs less) and, for each scene, three cuts
as a sheet: truth, SDS, x0, loop, volume. An interrupted run continues when it is started again; delete
out/label_makers to measure anew.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks.support.charts import ACCENT, OTHER, QUIET, plt, save_chart
from benchmarks.support.methods import compare

METHODS = {
    "independent_sds": "per plane, SDS (eq. 5)",
    "independent": "per plane, x0",
    "looped": "per plane, x0, loop",
    "ours": "one volume (solve)",
}
FIGURES = {
    "psnr_db": "PSNR dB",
    "patch": "patch distance (truth 0)",
    "sharpness": "sharpness (truth 1)",
    "fid_random": "FID (truth 0)",
}
COLOURS = (OTHER, "#8FA9C2", "#303337", ACCENT)
MARKERS = "osD^"


def draw(found: dict[str, dict[str, Any]], path: Path) -> None:
    """A panel for each figure."""
    figure, panels = plt.subplots(1, len(FIGURES), figsize=(16, 4.2), constrained_layout=True)
    for panel, (figure_name, title) in zip(panels, FIGURES.items(), strict=True):
        for marker, (scene, methods) in zip(MARKERS, found.items(), strict=False):
            for colour, (method, label) in zip(COLOURS, METHODS.items(), strict=True):
                if facts := methods.get(method):
                    panel.plot(facts["busy_seconds"], facts[figure_name], marker, color=colour, ms=9, label=label)
            panel.plot([], [], marker, color=QUIET, label=scene)
        panel.set(xscale="log", xlabel="processor seconds over cores, whole run", title=title)
        panel.set_xticks((10, 30, 100), ("10", "30", "100"))
        panel.minorticks_off()
        panel.grid(alpha=0.25, which="both")
    handles, labels = panels[0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside right center", fontsize=9)
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Runs the scenes asked for and writes the results; returns 1 if a part failed."""
    found, folder, failed = compare(
        "label_makers",
        __doc__,
        arguments,
        scenes="bread",
        detail="draft",
        methods=tuple(METHODS),
        quick_methods=("ours",),  # the plane-by-plane methods take minutes
        cuts=12,
        shown=3,
    )
    if folder:
        draw(found, folder / "label_makers.png")
    return failed


if __name__ == "__main__":
    sys.exit(main())
