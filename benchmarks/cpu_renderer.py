"""The classic renderer against plain torch: seconds a frame, forward and forward+backward, and error against float64.

    python -m benchmarks.cpu_renderer [--quick] [--cores N] [-o docs/charts]

Half of the Gaussians lie on a unit sphere, half in it, opaque, sigma = diameter / 150, in an order in which neighbours
in space are neighbours in memory. The renderers take turns, so that other load on the machine falls on both; the
fastest of several runs counts. `busy` is processor time, which a loaded machine disturbs less. Writes
cpu_renderer.json and .png.
"""

from __future__ import annotations

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.support import torch_baseline
from benchmarks.support.charts import ACCENT, plt, save_chart
from benchmarks.support.options import ROOT, out_folder, parser_of
from benchmarks.support.timing import timed
from engine.io.files import write_json
from engine.processes import peak_memory
from engine.render.classic.differentiable import rasterize
from engine.scene.camera import Camera, orbit
from engine.threads import cores, use_cores

COUNTS = (20_000, 100_000, 500_000)
SIZES = (256, 512)
REST = 0.05
"""Seconds between turns: OpenMP's threads keep spinning for a while after torch's work."""
REPEATS = 20
"""Runs of the faster renderer in each turn; together they still take less time than one run of the other."""
CELLS = 64
"""Cells along an edge of the grid that orders memory: one holds a few Gaussians of the largest scene."""


def scene(count: int, kind: torch.dtype = torch.float32) -> list[Tensor]:
    """Parameters of `count` Gaussians: means, scales, quats, opacities, rgb."""
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = np.where(np.arange(count) < count // 2, 1.0, rng.random(count) ** (1 / 3))
    means = direction * radius[:, None]
    cell = ((means + 1) / 2 * CELLS).astype(np.int64).clip(0, CELLS - 1)
    code = np.zeros(count, np.int64)
    for bit in range(CELLS.bit_length() - 1):
        for axis in range(3):
            code |= (cell[:, axis] >> bit & 1) << (3 * bit + axis)
    means = means[np.argsort(code, kind="stable")]
    quats = rng.normal(size=(count, 4))
    arrays = (means, np.full((count, 3), 2 / 150), quats, np.ones(count), rng.uniform(0, 1, (count, 3)))
    return [torch.tensor(array.astype(np.float32), dtype=kind) for array in arrays]


def view(size: int) -> Camera:
    """A camera in whose picture the sphere takes up most of the frame."""
    return orbit([0, 0, 0], [0, 0, 1], 30, 20, 3.6, size, size)


def outer(size: int, kind: torch.dtype = torch.float32) -> Tensor:
    """A fixed dL/d(rgb) (H, W, 3)."""
    return torch.rand(size, size, 3, generator=torch.Generator().manual_seed(1)).to(kind)


def ours(parameters: list[Tensor], camera: Camera, gradient: Tensor | None) -> Tensor:
    with torch.set_grad_enabled(gradient is not None):
        means, scales, quats, opacities, rgb = parameters
        picture, _, _ = rasterize(means, scales, quats, opacities, rgb, camera)
        if gradient is not None:
            torch.autograd.backward(picture, gradient)
    return picture.detach()


def theirs(parameters: list[Tensor], camera: Camera, gradient: Tensor | None) -> Tensor:
    means, scales, quats, opacities, rgb = parameters
    if gradient is None:
        return torch_baseline.forward(means, scales, quats, opacities, rgb, camera)
    return torch_baseline.forward_backward(means, scales, quats, opacities, rgb, camera, gradient)


Renderer = Callable[[list[Tensor], Camera, Tensor | None], Tensor]
RENDERERS: dict[str, Renderer] = {"classic": ours, "torch": theirs}


def measure(count: int, size: int, rounds: int) -> dict[str, object]:
    """Times and errors of one scene at one size."""
    camera, gradient, parameters = view(size), outer(size), scene(count)
    row: dict[str, object] = {"gaussians": count, "size": size}
    exact = [parameter.requires_grad_() for parameter in scene(count, torch.float64)]
    true = ours(exact, camera, outer(size, torch.float64))
    for name, run in RENDERERS.items():
        leaves = [parameter.detach().requires_grad_() for parameter in parameters]
        picture = run(leaves, camera, gradient)
        row[f"{name} rms error"] = float((picture - true).pow(2).mean().sqrt())
        row[f"{name} largest error"] = float((picture - true).abs().max())
        for label, leaf, truth in zip(("means", "scales", "opacities", "rgb"), pick(leaves), pick(exact), strict=True):
            assert leaf.grad is not None and truth.grad is not None
            row[f"{name} error of the gradient of {label}"] = float((leaf.grad - truth.grad).norm() / truth.grad.norm())
    best: dict[str, tuple[float, float]] = {}
    for _ in range(rounds):
        for name, run in RENDERERS.items():
            for mode, g in (("forward", None), ("forward+backward", gradient)):
                time.sleep(REST)
                for _ in range(REPEATS if name == "classic" else 1):
                    leaves = [parameter.detach().requires_grad_(g is not None) for parameter in parameters]
                    wall, busy = timed(partial(run, leaves, camera, g))
                    least = best.get(f"{name} {mode}", (np.inf, np.inf))
                    best[f"{name} {mode}"] = min(least[0], wall), min(least[1], busy)
    for name, (wall, busy) in best.items():
        row[f"{name} seconds"], row[f"{name} busy"] = wall, busy
    for mode in ("forward", "forward+backward"):
        for label, which in (("seconds", 0), ("busy", 1)):
            row[f"{mode} times faster, {label}"] = best[f"torch {mode}"][which] / best[f"classic {mode}"][which]
    return row


def pick(parameters: list[Tensor]) -> list[Tensor]:
    """All but the quaternions: turning a sphere changes nothing, so their gradient is 0."""
    return [parameters[0], parameters[1], parameters[3], parameters[4]]


def memory_of(count: int, size: int) -> float:
    """Peak MB of a process that does nothing but one forward+backward, libraries included."""
    command = [sys.executable, "-m", "benchmarks.cpu_renderer", "--memory", str(count), str(size)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    return float(done.stdout)


def chart(rows: list[dict[str, object]], path: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), constrained_layout=True)
    colours = {"classic": ACCENT, "torch": "#5B6270"}
    names = {"classic": "this renderer", "torch": "plain torch"}
    markers, sizes = {20_000: "o", 100_000: "s", 500_000: "D"}, {256: 36, 512: 90}
    for row in rows:
        pair = [
            [float(str(row[f"{name} {key}"])) for name in names] for key in ("forward+backward seconds", "rms error")
        ]
        left.plot(*pair, "-", color="#D5D8DC", linewidth=0.8, zorder=0)
    for name, colour in colours.items():
        for row in rows:
            count, size = int(str(row["gaussians"])), int(str(row["size"]))
            x, y = float(str(row[f"{name} forward+backward seconds"])), float(str(row[f"{name} rms error"]))
            left.scatter(x, y, s=sizes[size], c=colour, marker=markers[count], edgecolors="white", linewidths=0.6)
        for size, style in ((256, "--"), (512, "-")):
            line = [row for row in rows if row["size"] == size]
            x_line = [int(str(row["gaussians"])) for row in line]
            y_line = [float(str(row[f"{name} forward+backward seconds"])) for row in line]
            right.plot(x_line, y_line, style, marker="o", color=colour, label=f"{names[name]}, {size}²")
    for count, marker in markers.items():
        left.scatter([], [], marker=marker, c="#999999", label=f"{count // 1000} k Gaussians")
    left.scatter([], [], s=36, c="#999999", label="small: 256², large: 512²")
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.grid(True, which="major", color="#E4E4E4")
        axes.spines[["top", "right"]].set_visible(False)
    left.set_xlabel("seconds, forward+backward")
    left.set_ylabel("RMS error against float64, colours in 0..1")
    left.legend(frameon=False, fontsize=8)
    left.set_title("Error and time; lines join the two on one scene", loc="left", fontsize=11)
    right.set_xticks(COUNTS, [f"{count // 1000} k" for count in COUNTS])
    right.minorticks_off()
    right.set_xlabel("Gaussians")
    right.set_ylabel("seconds, forward+backward")
    right.legend(frameon=False, fontsize=8)
    right.set_title("Growth", loc="left", fontsize=11)
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """Measures all scenes and draws them."""
    parser = parser_of(__doc__, "the smallest scene only")
    parser.add_argument("--cores", type=int, default=cores(), help="threads of both renderers")
    parser.add_argument("--memory", type=int, nargs=2, metavar=("COUNT", "SIZE"), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    use_cores(options.cores)
    if options.memory:
        count, size = options.memory
        ours([parameter.requires_grad_() for parameter in scene(count)], view(size), outer(size))
        print(peak_memory() / 2**20)
        return
    folder = out_folder(options)
    # First, because a child's peak starts from its parent's.
    memory = None if options.quick else memory_of(COUNTS[-1], SIZES[-1])
    rows = []
    for count in COUNTS[:1] if options.quick else COUNTS:
        for size in SIZES[:1] if options.quick else SIZES:
            rows.append(measure(count, size, 3 if count <= 20_000 and not options.quick else 1))
            print(json.dumps(rows[-1], indent=1), flush=True)
    if not folder:
        return
    report = {
        "machine": f"{platform.machine()}, {options.cores} cores",
        "peak memory at 500000 Gaussians and 512 pixels, MB": memory,
        "rows": rows,
    }
    write_json(folder / "cpu_renderer.json", report)
    chart(rows, folder / "cpu_renderer.png")


if __name__ == "__main__":
    main()
