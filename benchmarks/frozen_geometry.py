"""Frozen geometry against the full opaque renderer: seconds per iteration, and the error that truncation costs.

    python -m benchmarks.frozen_geometry [--quick] [-o docs/charts]

One iteration is a picture and its gradient. Half of the atoms lie on a sphere, half in it, sigma = diameter / 150
for all, so that views of few atoms have the same footprints as views of many. Three kinds of view: the outside, the
outside with a cut, and a section. Writes frozen_geometry.json and .png. Seconds are those of the fastest of several
runs; `busy` is processor time over cores, which a loaded machine disturbs less.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.support.charts import ACCENT, OTHER, QUIET, front, plt, save_chart
from benchmarks.support.options import out_folder, parser_of
from benchmarks.support.timing import timed
from engine.fit.differentiable import AtomTensors, opaque_image
from engine.fit.view_weights import ViewWeights
from engine.io.files import write_json
from engine.processes import peak_memory
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera, orbit, section
from engine.scene.plane import Plane
from engine.threads import cores
from training.views import ENTRIES

KEPT = (4, 8, 16, 32, 64)
CUT = Plane.of((0.3, 0.2, 1.0), -0.05)
UP = (0.0, 0.0, 1.0)


def inside_colours(points: np.ndarray) -> np.ndarray:
    """(N, 3). A citrus-like solid at points (N, 3): rind, pith, segments, membranes as thin as an atom, soft grain."""
    x, y, z = points.T
    radius, turn = np.linalg.norm(points, axis=1) / 0.5, np.arctan2(y, x)
    grain = sum(
        np.sin(f * (x * a + y * b + z * c) + f)
        for f, a, b, c in ((40, 1, 0.3, 0.2), (55, -0.4, 1, 0.3), (70, 0.2, -0.5, 1))
    )
    flesh = np.array([0.95, 0.55, 0.12]) + 0.05 * grain[:, None] * np.array([0.6, 1.0, 0.5])
    membrane = np.abs(np.sin(5 * turn)) * np.hypot(x, y) < 0.02
    rgb = np.where(membrane[:, None], [0.98, 0.85, 0.55], flesh)
    rgb = np.where((radius > 0.88)[:, None], [0.97, 0.93, 0.8], rgb)
    rgb = np.where((radius > 0.95)[:, None], np.array([0.93, 0.45, 0.05]) + 0.04 * grain[:, None], rgb)
    return np.clip(rgb, 0, 1).astype(np.float32)


def ball(count: int) -> Atoms:
    """Half of `count` atoms on a sphere of diameter 1 and half in it, isotropic, sigma 1/150."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    radius = np.where(np.arange(count) < count // 2, 1.0, 0.97 * rng.random(count) ** (1 / 3))
    points = (0.5 * radius[:, None] * way).astype(np.float32)
    # Neighbours in space lie near each other in memory, as after loading.
    for part in (slice(0, count // 2), slice(count // 2, count)):
        cell = ((points[part] + 0.5) * 16).astype(int).clip(0, 15)
        points[part] = points[part][np.lexsort(cell.T)]
    rgb = inside_colours(points)
    n = count // 2
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    sigma = np.float32(1 / 150)
    skin = SurfaceAtoms(points[:n], np.full((n, 3), sigma), quats, sh.rgb_to_sh(rgb[:n, None]).astype(np.float32))
    return Atoms(skin, InteriorAtoms(points[n:], np.full(count - n, sigma), rgb[n:]), float(2 * sigma))


def seconds(run: Callable[[], object], times: int) -> tuple[float, float]:
    """Least wall seconds, and least processor seconds over cores, of several runs after a warm-up."""
    run()
    wall, busy = np.min([timed(run) for _ in range(times)], axis=0)
    return float(wall), float(busy) / cores()


def measure(atoms: Atoms, camera: Camera, kind: str, times: int) -> dict[str, object]:
    """Seconds and errors of one kind of view."""
    planes = [] if kind == "outside" else [CUT]
    field = KernelField(atoms)

    def build() -> ViewWeights:
        if kind == "section":
            return ViewWeights.section(atoms, CUT, camera, field)
        return ViewWeights.surface(atoms, camera, planes, field)

    tensors = AtomTensors.of(atoms)
    geometry = [
        tensors.means,
        tensors.scales,
        tensors.quats,
        tensors.sh,
        tensors.interior_means,
        tensors.sigmas,
        tensors.rgb,
    ]
    for tensor in geometry:
        tensor.requires_grad_()

    def full() -> None:
        for tensor in geometry:
            tensor.grad = None
        opaque_image(tensors, camera, planes)[0].square().sum().backward()

    exact = build()
    colours = exact.colours(atoms)
    truth = exact.apply(colours)
    grey = np.full((len(exact.alpha), 3), 0.5, np.float32)
    known = colours[exact.used]

    def step(view: ViewWeights) -> Callable[[], object]:
        return lambda: (view.apply_used(known), view.apply_transposed_used(grey))

    row: dict[str, object] = {"kind": kind, "atoms": len(atoms), "pixels": camera.width, "entries": len(exact.weights)}
    row["megabytes"] = round((exact.weights.nbytes + exact.atoms.nbytes + exact.offsets.nbytes) / 2**20, 1)
    row["covered"] = float(exact.pixels.mean())
    row["full"], row["full busy"] = seconds(full, max(1, times // 3))
    row["render"], row["render busy"] = seconds(lambda: render(atoms, camera, planes, field=field), max(1, times // 3))
    row["build"], row["build busy"] = seconds(build, max(1, times // 3))
    row["exact"], row["exact busy"] = seconds(step(exact), times)
    if kind != "section":
        drawn = render(atoms, camera, planes, (0, 0, 0), field=field).rgb
        row["exact error"] = float(np.abs(drawn - truth).max())
    shown = exact.pixels
    for keep in KEPT:
        short = exact.truncated(keep)
        wall, busy = seconds(step(short), times)
        wrong = (short.apply(colours) - truth).reshape(-1, 3)[shown]
        row[f"keep {keep}"] = {
            "seconds": wall,
            "busy": busy,
            "error dB": round(float(10 * np.log10(np.square(wrong, dtype=np.float64).mean() + 1e-20)), 1),
        }
    row["peak megabytes"] = peak_memory() // 2**20
    return row


def chart(rows: list[dict], path: Path) -> None:
    """Accuracy of the picture against the time of an iteration; the truncation that training uses is marked."""
    kinds = ("outside", "cut", "section")
    most = max((row["atoms"], row["pixels"]) for row in rows)
    figure, panels = plt.subplots(1, len(kinds), figsize=(13, 4.4), sharey=True, constrained_layout=True)
    shown = [next(r for r in rows if r["kind"] == kind and (r["atoms"], r["pixels"]) == most) for kind in kinds]
    # An untruncated view has no error: it stands above the rest, on a line labelled so.
    top = 10 * np.ceil(max(-row[f"keep {k}"]["error dB"] for row in shown for k in KEPT) / 10) + 10
    for kind, row, panel in zip(kinds, shown, panels, strict=True):
        names = [*(f"{k}" for k in KEPT), "all", "full renderer"]
        times = [1e3 * t for t in (*(row[f"keep {k}"]["busy"] for k in KEPT), row["exact busy"], row["full busy"])]
        decibels = [-row[f"keep {k}"]["error dB"] for k in KEPT] + [top, top]
        line = front(times, decibels)
        panel.step([times[i] for i in line], [decibels[i] for i in line], where="post", color=QUIET, zorder=1)
        for name, time_taken, decibel in zip(names, times, decibels, strict=True):
            used = name == str(ENTRIES)
            panel.plot(
                time_taken, decibel, "D" if used else "o", color=ACCENT if used else OTHER, ms=9 - 3 * (not used)
            )
            last = name == names[-1]
            panel.annotate(
                f"{name}, as training" if used else name, (time_taken, decibel), (-6, 8) if used else (6, -11),
                textcoords="offset points", fontsize=8, fontweight="bold" if used else "normal",
                ha="right" if used or last else "left",
            )  # fmt: skip
        panel.set(title=kind, xlabel="picture and gradient, ms (busy)", xscale="log")
        panel.margins(0.22, 0.08)
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("PSNR against the full renderer, dB")
    ticks = range(30, int(top), 10)
    panels[0].set_yticks([*ticks, top], [*(str(tick) for tick in ticks), "exact"])
    figure.suptitle(
        f"Frozen geometry, {most[0]:,} atoms, {most[1]} x {most[1]} pixels, {cores()} cores: "
        "the K largest entries of a pixel, all of them, and the full renderer"
    )
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> None:
    """Measures, prints a row for each view, and writes numbers and chart."""
    options = parser_of(__doc__, "the smallest scene only").parse_args(arguments)
    folder, quick = out_folder(options), options.quick
    torch.set_num_threads(cores())
    rows = []
    for count, size in ((20_000, 256), (100_000, 256), (100_000, 512), (500_000, 512)):
        if quick and count > 20_000:
            continue
        atoms = ball(count)
        around = orbit((0, 0, 0), UP, 30, 35, 1.75, size, size)
        for kind in ("outside", "cut", "section"):
            camera = section(CUT, UP, atoms.bounds, size) if kind == "section" else around
            rows.append(measure(atoms, camera, kind, 3 if quick else 7))
            print(json.dumps(rows[-1]), flush=True)
    if folder:
        write_json(folder / "frozen_geometry.json", rows)
        chart(rows, folder / "frozen_geometry.png")


if __name__ == "__main__":
    main()
