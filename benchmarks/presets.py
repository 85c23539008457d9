"""Accuracy of the inside against training time and number of atoms: the presets, and the parameters behind them.

    python -m benchmarks.presets [--quick] [-o docs/charts]

Each parameter is varied alone, from draft or from standard; accuracy is the mean over the three sample scenes and
random held-out cuts of each: PSNR, which rewards blur where texture cannot be known, patch distance over that of
another true one of the kind, and sharpness, which do not. One scene misleads. Writes interior_presets.json and .png,
with the Pareto fronts (nothing is both cheaper and better) drawn and the presets marked. The chart has processor time
over cores, two thirds of the seconds on two cores, because a loaded machine disturbs it less.
"""

from __future__ import annotations

import itertools
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.charts import ACCENT, OTHER, QUIET, front, plt, save_chart
from benchmarks.support.options import out_folder, parser_of
from engine.io.files import write_json
from engine.threads import cores
from training.evaluate.cuts import load_truth, make_cuts
from training.evaluate.measure import accuracy, other_solid_distance, render_cuts
from training.evaluate.methods.all_methods import METHODS
from training.evaluate.scenes import load_scene
from training.settings import DETAILS, Detail

SCENES = ("orange", "bread", "watermelon")
CUTS = 20

COSTS = {"busy": "processor seconds over cores", "atoms": "atoms"}
FIGURES = {
    "psnr_db": ("PSNR dB", lambda value: value),
    "patch_ratio": ("patch distance over another true one's", lambda value: -value),
    # Too sharp is as wrong as too blurred.
    "sharpness": ("sharpness (truth 1)", lambda value: -abs(1 - value)),
}
"""Titles, and the score of a value: larger is better."""


def settings() -> dict[str, Detail]:
    """The detail of each run."""
    runs: dict[str, Detail] = dict(DETAILS.items())
    draft, standard = DETAILS["draft"], DETAILS["standard"]
    turned = {
        "voxels": [draft.voxels * 5 // 7, draft.voxels * 3 // 2],
        "fine": [draft.fine * 2 // 3, draft.fine * 3 // 2],
    }
    for knob, values in turned.items():
        runs |= {f"{knob} {value}": replace(draft, **{knob: value}) for value in values}
    for knob, value in {"voxels": 128, "fine": 144}.items():
        runs[f"standard, {knob} {value}"] = replace(standard, **{knob: value})
    return runs


def measure(scene: str, numbers: Detail, folder: Path) -> dict[str, Any]:
    """Runs one setting on one scene and returns its figures."""
    scene_data = load_scene(scene, folder)
    cuts = make_cuts(scene_data.solid, scene_data.families, CUTS)
    truth = load_truth(scene_data.solid, cuts, folder / f"{scene}.safetensors")
    another = other_solid_distance(scene_data, cuts, truth, folder / f"{scene}_another")
    with tempfile.TemporaryDirectory(dir=folder) as out:
        begun, busy = time.perf_counter(), time.process_time()
        result = METHODS["ours"].run(scene_data, scene_data.request(numbers, 0), Path(out))
        seconds, busy = time.perf_counter() - begun, (time.process_time() - busy) / cores()
        figures = accuracy(render_cuts(result, cuts, truth), cuts, truth, another)
    return {
        "seconds": round(seconds, 1),
        "busy": round(busy, 1),
        "atoms": len(result.atoms),
        **figures,
    }


def mean(numbers: Detail, runs: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The means of one setting over the scenes, and the figures of each scene."""
    keys = ("seconds", *COSTS, *FIGURES, "ssim")
    means = {key: round(float(np.mean([run[key] for run in runs.values()])), 4) for key in keys}
    return {"numbers": asdict(numbers), **means, "scenes": runs}


def pareto_front(runs: dict[str, dict[str, Any]], across: str, up: str) -> list[int]:
    """Indices of the runs on the Pareto front of a figure against a cost."""
    return front([run[across] for run in runs.values()], [FIGURES[up][1](run[up]) for run in runs.values()])


def label(panel: Any, names: Sequence[str], x: Sequence[float], y: Sequence[float]) -> None:
    """Writes names beside their points; names close to a preset's share its label."""
    at = panel.transAxes.inverted().transform(panel.transData.transform(np.column_stack([x, y])))
    left = sorted(range(len(names)), key=lambda i: names[i] not in DETAILS)
    while left:
        first = left[0]
        group = (
            [i for i in left if (np.abs(at[i] - at[first]) < (0.12, 0.06)).all()]
            if names[first] in DETAILS
            else [first]
        )
        left = [i for i in left if i not in group]
        corner = max(group, key=lambda i: at[i, 0])
        inside = [names[i] for i in group]
        lines = [inside[0], *(" · ".join(inside[k : k + 2]) for k in range(1, len(inside), 2))]
        panel.annotate(
            "\n".join(lines),
            (x[corner], y[corner]),
            (7, 0),
            textcoords="offset points",
            fontsize=7,
            fontweight="bold" if inside[0] in DETAILS else "normal",
            va="center",
        )


def draw(runs: dict[str, dict[str, Any]], path: Path) -> None:
    """A panel for each figure and cost."""
    figure, panels = plt.subplots(len(FIGURES), len(COSTS), figsize=(12.5, 13.5))
    for panel, (up, across) in zip(panels.flat, itertools.product(FIGURES, COSTS), strict=True):
        x, y = [run[across] for run in runs.values()], [run[up] for run in runs.values()]
        line = pareto_front(runs, across, up)
        panel.plot([x[i] for i in line], [y[i] for i in line], "-", color=QUIET, zorder=1)
        for name, a, b in zip(runs, x, y, strict=True):
            preset = name in DETAILS
            panel.plot(a, b, "D" if preset else "o", color=ACCENT if preset else OTHER, markersize=9 if preset else 6)
        panel.set_xscale("log")
        panel.set_xlabel(COSTS[across])
        panel.set_ylabel(FIGURES[up][0])
        panel.margins(0.12)
        panel.grid(alpha=0.25, which="both")
        if across == "busy":
            panel.set_xticks((15, 30, 60, 120), ("15", "30", "60", "120"))
            panel.minorticks_off()
        label(panel, list(runs), x, y)
    figure.suptitle(
        f"Interiors of {', '.join(SCENES)}: means over {CUTS} random cuts of each; "
        "knobs are turned alone, from draft if not said"
    )
    figure.tight_layout()
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """Runs every setting, or draft alone."""
    options = parser_of(__doc__, "draft alone, on one scene, kernels compiled on the way").parse_args(arguments)
    out, quick = out_folder(options), options.quick
    chosen = settings()
    if quick:
        chosen = {"draft": chosen["draft"]}
    with tempfile.TemporaryDirectory() as folder:
        if not quick:
            measure(SCENES[0], chosen["draft"], Path(folder))  # the first run of a process loads kernels
        result: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in chosen}
        for scene, (name, numbers) in itertools.product(SCENES[: 1 if quick else None], chosen.items()):
            result[name][scene] = measure(scene, numbers, Path(folder))
            print(scene, name, json.dumps(result[name][scene]), flush=True)
    if not out:
        return
    runs = {name: mean(chosen[name], of) for name, of in result.items()}
    fronts = {
        f"{up} against {across}": [list(runs)[i] for i in pareto_front(runs, across, up)]
        for up, across in itertools.product(FIGURES, COSTS)
    }
    record = {"scenes": SCENES, "cuts": CUTS, "cores": cores(), "fronts": fronts, "runs": runs}
    write_json(out / "interior_presets.json", record)
    draw(runs, out / "interior_presets.png")


if __name__ == "__main__":
    main()
