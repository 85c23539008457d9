"""Where labels come from: per-plane SDS, per-plane x0, the paper's loop, and one volume solved for all planes.

    python -m benchmarks.label_makers [--scenes bread,orange] [--detail draft] [--quick] [-o docs/charts]

The same exemplars, fill, training and cuts, which nobody trained; one prior, asked in four ways. Writes
label_makers.json, label_makers.png (figures against processor time, which a loaded machine disturbs less) and, for
each scene, three cuts as a sheet: truth, SDS, x0, loop, volume. Started again after an interruption it goes on; delete
out/label_makers to measure anew.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image

from benchmarks.support.options import ROOT, out_folder, parser_of, write_json
from engine.io.files import atomic
from engine.io.picture_file import read_pixels
from training.evaluate.grid import cells, run_locally
from training.settings import DetailName

mpl.use("Agg")
from matplotlib import pyplot as plt

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
COLOURS = ("#5B7A99", "#8FA9C2", "#303337", "#FF6B4A")
MARKERS = "osD^"
CUTS, SHOWN = 12, 3
QUICK, QUICK_CUTS = ("ours",), 4
"""Methods and cuts of a quick run: those that draw plane by plane take minutes."""


def draw(found: dict[str, dict[str, Any]], path: Path) -> None:
    """A panel for each figure."""
    figure, panels = plt.subplots(1, len(FIGURES), figsize=(16, 4.2), constrained_layout=True)
    for panel, (figure_name, title) in zip(panels, FIGURES.items(), strict=True):
        for marker, (scene, methods) in zip(MARKERS, found.items(), strict=False):
            for colour, (method, label) in zip(COLOURS, METHODS.items(), strict=True):
                if facts := methods.get(method):
                    panel.plot(facts["busy_seconds"], facts[figure_name], marker, color=colour, ms=9, label=label)
            panel.plot([], [], marker, color="#B0B5BA", label=scene)
        panel.set(xscale="log", xlabel="processor seconds over cores, whole run", title=title)
        panel.set_xticks((10, 30, 100), ("10", "30", "100"))
        panel.minorticks_off()
        panel.grid(alpha=0.25, which="both")
    handles, labels = panels[0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside right center", fontsize=9)
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> int:
    """Runs the scenes asked for and writes what was measured; 1 where a part failed."""
    parser = parser_of(__doc__, "one scene in draft, no label drawn plane by plane")
    parser.add_argument("--scenes", default="bread")
    parser.add_argument("--detail", default="draft", choices=["draft", "standard", "high"])
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    if options.quick:
        with tempfile.TemporaryDirectory() as work:  # what an earlier run left would be no measurement
            return run(["bread"], "draft", QUICK, QUICK_CUTS, Path(work), folder)
    work = ROOT / "out/label_makers" / options.detail
    return run(options.scenes.split(","), options.detail, tuple(METHODS), CUTS, work, folder)


def run(
    scenes: list[str], detail: DetailName, methods: Sequence[str], cuts: int, work: Path, folder: Path | None
) -> int:
    """Measures what is not yet in `work`, and writes it to the folder if there is one; 1 where a part failed."""
    grid = cells(scenes, methods, [0], detail, cuts, None, work)
    failed = run_locally(grid, lambda cell, what: print(f"{cell.name}: {what}", file=sys.stderr, flush=True))
    found: dict[str, dict[str, Any]] = {
        scene: {cell.method: cell.load_facts() for cell in grid if cell.scene == scene} for scene in scenes
    }
    print(json.dumps(found, indent=1))
    if not folder:
        return 1 if failed else 0
    for scene in scenes:
        strips = [work / "results" / scene / f"{name}.png" for name in ("truth", *(f"{m}-0" for m in methods))]
        if all(path.is_file() for path in strips):
            rows = [read_pixels(path) for path in strips]
            sheet = np.concatenate([row[:, : SHOWN * row.shape[0]] for row in rows])
            with atomic(folder / f"label_makers_{scene}.png") as temporary:
                Image.fromarray(sheet).save(temporary, format="PNG", optimize=True)
    write_json(folder / "label_makers.json", {"detail": detail, "cuts": cuts, "scenes": found})
    draw(found, folder / "label_makers.png")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
