"""How long large captures take to open, and how much memory: the window's own loader, from the file to the solid.

    python -m benchmarks.large [--quick] [-o docs/charts]

Each capture is a sample scene whose Gaussians were divided until there are a million, two and five. The clock runs from
the request: to the coarse picture, to the whole capture, to the solid that can be cut, to its fitted skin. Beside it
stand processor seconds, which are the ones to compare on a busy machine, and peak memory: of each process, and of both
with their shared pages counted once. Writes large.json.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from app.jobs.scene_loader import SceneLoader, SceneRequest
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import write_json
from engine.io.load import load
from engine.io.splats.ply import write_ply
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import rotation_matrices

COUNTS = (1_000_000, 2_000_000, 5_000_000)
QUICK = 300_000
SCENE = ROOT / "sample_scenes/watermelon/watermelon.ply"

REST = 0.02
"""Standard deviation of the SH above degree 0, so that the files are as large as those of captures."""

PAUSE = 0.05
"""Seconds between two readings of the processes."""


def divided(gaussians: Gaussians, count: int) -> Gaussians:
    """`count` Gaussians of SH degree 3 that look much like a smaller scene: each is drawn from one of its Gaussians."""
    rng = np.random.default_rng(0)
    rows = np.arange(count) % len(gaussians)
    part = (len(gaussians) / count) ** 0.5  # of a side, so that the total area stays the same
    sh = rng.normal(0, REST, (count, 16, 3)).astype(np.float32)
    sh[:, 0] = gaussians.sh[rows, 0]
    scales = gaussians.scales[rows]
    local = rng.normal(size=(count, 3)) * scales * np.sqrt(1 - part**2)
    means = gaussians.means[rows] + np.einsum("nij,nj->ni", rotation_matrices(gaussians.quats)[rows], local)
    return Gaussians(
        means.astype(np.float32),
        scales * np.float32(part),
        gaussians.quats[rows],
        gaussians.opacities[rows],
        sh,
    )


def measure_opening(path: Path) -> dict[str, Any]:
    """What opening the file costs, in seconds and memory. Raises RuntimeError if it fails."""
    row: dict[str, Any] = {"megabytes": path.stat().st_size >> 20}
    peaks = {"window_mb": 0, "worker_mb": 0, "both_mb": 0}
    begun = time.perf_counter()
    loader = SceneLoader(SceneRequest(path))
    window, worker = psutil.Process(), psutil.Process(loader._process.pid)
    processor = 0.0
    while not loader.ended:
        time.sleep(PAUSE)
        try:
            memory = window.memory_full_info(), worker.memory_full_info()
            processor = sum(worker.cpu_times()[:2])
            found = (memory[0].rss, memory[1].rss, sum(getattr(m, "pss", m.rss) for m in memory))
            peaks = {name: max(peak, size >> 20) for (name, peak), size in zip(peaks.items(), found, strict=True)}
        except psutil.Error:
            pass  # the process has ended
        if loader.poll():
            scene = loader.scene
            shown = scene.coarse is not None, scene.capture is not None, scene.atoms is not None
            name = "skin" if "solid_seconds" in row else ("coarse", "capture", "solid")[max(np.flatnonzero(shown))]
            row[f"{name}_seconds"] = round(time.perf_counter() - begun, 1)
            row[f"{name}_cpu_seconds"] = round(processor, 1)
            row |= {f"{name}_peak_{what}": size for what, size in peaks.items()}
            print({key: value for key, value in row.items() if key.startswith(name)}, flush=True)
    if loader.error or loader.scene.atoms is None:
        raise RuntimeError(loader.error)
    return row | {"atoms": len(loader.scene.atoms), "notes": list(loader.scene.notes)}


def main(arguments: list[str] | None = None) -> None:
    """Makes the captures one after the other and opens them."""
    options = parser_of(__doc__, f"one capture of {QUICK:,} Gaussians").parse_args(arguments)
    folder = out_folder(options)
    rows = []
    scene = load(SCENE).gaussians
    for count in (QUICK,) if options.quick else COUNTS:
        with tempfile.TemporaryDirectory() as scratch:
            path = Path(scratch) / "large.ply"
            write_ply(path, divided(scene, count))
            rows.append({"gaussians": count, **measure_opening(path)})
        print(json.dumps(rows[-1], indent=1), flush=True)
    if folder:
        write_json(folder / "large.json", rows)


if __name__ == "__main__":
    main()
