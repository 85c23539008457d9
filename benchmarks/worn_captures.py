"""How far a capture's body holds as the capture gets worse: fewer Gaussians, misplaced ones, a missing part.

    python -m benchmarks.worn_captures [--quick] [-o docs/charts] [CAPTURE ...]

From each capture a random fraction of the Gaussians is kept; or all are moved at random, by a standard deviation given
in longest sides; or those in a cone from the middle are left out. The body then found is compared with the body of the
whole capture: the volume of their intersection over that of their union (1: the same; 0: refused). Writes
worn_captures.json and the chart worn_captures.png. If no capture is given, measures a sample and those of
../shared/data.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.charts import plt, save_chart
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.errors import InputError
from engine.io.files import write_json
from engine.io.load import load
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.solid.find_body import find_body

SAMPLE = ROOT / "sample_scenes/watermelon/watermelon.ply"
SHARED = ROOT.parent / "shared/data"
CAPTURES = (
    "splats/donut_mipsplatting.ply",
    "splats/meshgs_orange_30k.ply",
    "splats/meshgs_apple_30k.ply",
    "splats/guitar.compressed.ply",
    "splats/plant.splat",
    "splats/tarot_box_capture.ply",
    "formats/biker.compressed.ply",
)

KEPT = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02)
MOVED = (0.0, 0.002, 0.005, 0.01, 0.02, 0.05)
MISSING = (0, 20, 40, 60, 80, 100)
"""Half angles of the cone, degrees."""

SEED = 0


def thinned(whole: Gaussians, part: float) -> Gaussians:
    """A random fraction of a capture's Gaussians."""
    rng = np.random.default_rng(SEED)
    return whole[np.sort(rng.choice(len(whole), max(round(part * len(whole)), 1), replace=False))]


def moved(whole: Gaussians, part: float) -> Gaussians:
    """A capture whose Gaussians are moved at random, with this fraction of its longest side as standard deviation."""
    rng = np.random.default_rng(SEED)
    low, high = whole.visible_bounds()
    away = rng.normal(0, part * float((high - low).max()), whole.means.shape)
    return replace(whole, means=(whole.means + away).astype(np.float32))


def with_hole(whole: Gaussians, angle: float) -> Gaussians:
    """A capture without the Gaussians in a cone from its middle, in a direction along no axis."""
    offset = whole.means - whole.visible_bounds().mean(0)
    towards = np.array([1.0, 0.6, -0.4]) / np.linalg.norm([1.0, 0.6, -0.4])
    return whole[offset @ towards < np.cos(np.radians(angle)) * np.linalg.norm(offset, axis=1) + (angle == 0)]


WAYS: dict[str, tuple[Callable[[Gaussians, float], Gaussians], tuple[float, ...], str]] = {
    "kept": (thinned, KEPT, "part of the Gaussians that is left"),
    "moved": (moved, MOVED, "Gaussians moved by, in longest sides"),
    "missing": (with_hole, MISSING, "half angle of what is missing, degrees"),
}
"""By name: how a capture is worsened, the steps, and the axis label."""


def body_iou(whole: Body, worn: Gaussians) -> float:
    """Volume of the intersection of both bodies over that of their union; 0 where no body is found."""
    try:
        other = find_body(worn).body
    except InputError:
        return 0.0
    here, there = whole.grid.centres()[whole.inside], other.grid.centres()[other.inside]
    both = np.mean(other.at(here) > 0) * whole.volume
    either = whole.volume + other.volume - np.mean(whole.at(there) > 0) * other.volume
    return round(float(both / either), 4)


def measure(path: Path, points: int | None) -> dict[str, Any]:
    """The overlaps of one capture for each way, of the first `points` steps if given. Raises InputError."""
    capture = load(path).gaussians
    whole = find_body(capture).body
    rows: dict[str, Any] = {"gaussians": len(capture)}
    for name, (worsen, steps, _) in WAYS.items():
        rows[name] = [[step, body_iou(whole, worsen(capture, step))] for step in steps[:points]]
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Measures the captures; returns 1 if one of them could not be measured."""
    parser = parser_of(__doc__, "the first two points of each curve of a sample")
    parser.add_argument("captures", nargs="*", type=Path, metavar="CAPTURE")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    others = [] if options.quick else [SHARED / name for name in CAPTURES if (SHARED / name).is_file()]
    captures = options.captures or [*others, SAMPLE]
    found, failed = {}, 0
    for path in captures:
        name = path.name.partition(".")[0]
        try:
            found[name] = measure(path, 2 if options.quick else None)
        except InputError as error:
            print(error, file=sys.stderr)
            failed = 1
            continue
        print(name, found[name], flush=True)
    if folder and found:
        write_json(folder / "worn_captures.json", found)
        draw(found, folder / "worn_captures.png")
    return failed


def draw(found: dict[str, Any], path: Path) -> None:
    """A curve for each capture, a panel for each way to worsen it."""
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, panels = plt.subplots(1, len(WAYS), figsize=(14, 3.6), sharey=True, layout="constrained")
    for panel, (name, (_, _, label)) in zip(panels, WAYS.items(), strict=True):
        for capture, rows in found.items():
            steps, shares = zip(*rows[name], strict=True)
            panel.plot(steps, shares, marker="o", markersize=3, label=capture)
        panel.set_xlabel(label)
        panel.set_ylim(0, 1.02)
    panels[0].set_xscale("log")
    panels[0].invert_xaxis()
    panels[0].set_ylabel("overlap with the whole capture's body")
    panels[0].legend(frameon=False, fontsize=8, loc="lower left")
    save_chart(figure, path)


if __name__ == "__main__":
    sys.exit(main())
