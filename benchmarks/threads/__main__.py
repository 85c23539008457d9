"""Seconds of each stage of `fruitninja-train`, and of a frame, against the number of threads.

    python -m benchmarks.threads [--quick] [--threads 1,2] [--scenes orange_others] [--parts draft,frames,standard]
                                 [--keep] [-o docs/charts]

Trains a capture with two pictures, once for each detail and number of threads, each time in a fresh process with the
seconds by stage from its report.json. Frames are of such an object in draft and 1280 x 720: of the CPU reference,
forward and with gradients of all parameters, of the window's software path, and a face at rest that fills the picture,
read from the inside. A first run, which is not timed, compiles the kernels.

A number of threads is a number of processors that the process may run on, since that is what the program and its
libraries count; whole cores come before the second threads of cores. Only Linux has this. `same_results` says whether
the trained files and all pixels and gradients were equal to the byte for all numbers. Writes threads.json and
threads.png anew after each run, so that little is lost where one is cut short; --keep keeps the rows of other parts.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.support.options import ROOT, out_folder, parser_of
from benchmarks.threads.chart import chart
from engine.io.files import write_json
from engine.io.trained import inside_path
from training.evaluate.scenes import EvaluationScene, load_scene
from training.settings import DETAILS

__all__ = ["main"]

FRAMES = "frames"
"""Name of the part beside the details of training."""

KERNELS = "kernels"
"""Name of the first run, in draft, whose time tells little."""

NUMBERS = "threads.json"

TOPOLOGY = Path("/sys/devices/system/cpu")


@dataclass(frozen=True)
class Runs:
    """What all runs of a scene share."""

    scene: EvaluationScene
    folder: Path
    """Where results go."""
    quick: bool

    def train(self, detail: str, threads: int, name: str = "") -> dict[str, Any]:
        """Trains from nothing into the folder `name`; a row with the seconds of each stage and the whole."""
        name = name or f"{detail}-{threads}"
        out = self.folder / name
        up = ",".join(f"{x:g}" for x in self.scene.solid.up)
        pictures = [f"{family.kind}={path}" for family in self.scene.families for path in family.exemplars]
        options = [text for picture in pictures for text in ("--exemplar", picture)]
        arguments = [str(self.scene.scene), "-o", str(out), "--detail", detail, f"--up={up}", *options]
        _, used = run_limited("training.cli", arguments, threads)
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        seconds = {**report["seconds"], "whole": used["wall"]}
        return self.row(detail, threads, seconds, used["busy"], digest_of(self.result(name)))

    def frames(self, threads: int) -> dict[str, Any]:
        """A row with the seconds of each kind of frame of the first run's object."""
        quick = ["--quick"] if self.quick else []
        said, used = run_limited("benchmarks.threads.frames", [str(self.result(KERNELS)), *quick], threads)
        found = json.loads(said)
        assert found["threads"] == threads, f"{found['threads']} threads instead of {threads}"
        return self.row(FRAMES, threads, found["seconds"], used["busy"], found["digest"])

    def row(self, part: str, threads: int, seconds: dict[str, float], busy: float, digest: str) -> dict[str, Any]:
        return {
            "scene": self.scene.name,
            "part": part,
            "threads": threads,
            "seconds": seconds,
            "processor_seconds": busy,
            "load": round(os.getloadavg()[0], 1),
            "digest": digest,
        }

    def result(self, name: str) -> Path:
        """The file that `train` makes in this folder."""
        return self.folder / name / f"{self.scene.scene.stem}.ply"


def digest_of(trained: Path) -> str:
    """A digest of the trained .ply and of the inside beside it."""
    digest = hashlib.sha256(trained.read_bytes())
    digest.update(inside_path(trained).read_bytes())
    return digest.hexdigest()[:16]


def run_limited(module: str, arguments: Sequence[str], threads: int) -> tuple[str, dict[str, float]]:
    """Runs a module in a new process on so many processors: what it prints, and its wall and processor seconds."""
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with limited_to(threads):
        child = subprocess.Popen(
            [sys.executable, "-m", module, *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
    said, _ = child.communicate()
    wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    if child.returncode:
        raise SystemExit(f"{module} ended with {child.returncode}")
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return said, {"wall": round(wall, 2), "busy": round(busy, 1)}


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Processes that start in this block may use so many processors."""
    all_processors = os.sched_getaffinity(0)
    os.sched_setaffinity(0, processors()[:threads])
    try:
        if len(os.sched_getaffinity(0)) != threads:
            raise SystemExit(f"this system does not limit a process to {threads} of its processors")
        yield
    finally:
        os.sched_setaffinity(0, all_processors)


def processors() -> list[int]:
    """The processors that this process may use: the first threads of all cores before the second ones."""

    def place(number: int) -> int:
        try:
            text = (TOPOLOGY / f"cpu{number}/topology/thread_siblings_list").read_text(encoding="ascii")
        except OSError:
            return 0
        siblings: list[int] = []
        for part in text.strip().split(","):
            first, _, last = part.partition("-")
            siblings += range(int(first), int(last or first) + 1)
        return siblings.index(number)

    return sorted(os.sched_getaffinity(0), key=lambda number: (place(number), number))


def same(rows: Sequence[dict[str, Any]]) -> bool:
    """Whether no digest of a part depends on the number of threads."""
    found: dict[tuple[str, str], set[str]] = {}
    for row in rows:
        found.setdefault((row["scene"], row["part"]), set()).add(row["digest"])
    return all(len(digests) == 1 for digests in found.values())


def powers_of_two(most: int) -> list[int]:
    """1, 2, 4, ... and the number itself."""
    return sorted({2**k for k in range(most.bit_length())} | {most})


def main(arguments: list[str] | None = None) -> None:
    """Measures, prints a row for each run, and writes numbers and chart."""
    parser = parser_of(__doc__, "draft and frames, one and all threads, one frame of each kind")
    parser.add_argument("--threads", help="numbers of threads, with commas (default: powers of two, and all)")
    parser.add_argument("--scenes", default="orange_others", help="names, with commas")
    parser.add_argument("--parts", default="draft,frames,standard", help=f"details to train in, and {FRAMES}")
    parser.add_argument("--keep", action="store_true", help="keep rows of other parts from the folder's threads.json")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    if not hasattr(os, "sched_setaffinity"):
        parser.error("this system cannot limit a process to some of its processors")
    most = len(os.sched_getaffinity(0))
    asked = options.threads.split(",") if options.threads else powers_of_two(most)
    counts = [n for n in map(int, asked) if n <= most]
    parts = [part for part in options.parts.split(",") if part]
    if not set(parts) <= {*DETAILS, FRAMES}:
        parser.error(f"--parts: choose of {', '.join([*DETAILS, FRAMES])}")
    if options.quick:
        counts, parts = sorted({1, most}), ["draft", FRAMES]
    rows: list[dict[str, Any]] = []
    if folder and options.keep and (folder / NUMBERS).is_file():
        before = json.loads((folder / NUMBERS).read_text(encoding="utf-8"))["rows"]
        rows = [row for row in before if row["part"] not in parts]

    with tempfile.TemporaryDirectory() as scratch:
        pictures = Path(scratch) if options.quick else ROOT / "out/threads"  # they take half a minute to draw
        for name in options.scenes.split(","):
            runs = Runs(load_scene(name, pictures), Path(scratch) / "results" / name, options.quick)
            seconds = runs.train("draft", most, KERNELS)["seconds"]["whole"]
            print(f"{name}: a first run took {seconds} s", flush=True)
            for part in parts:
                for threads in counts:
                    rows.append(runs.frames(threads) if part == FRAMES else runs.train(part, threads))
                    print(json.dumps(rows[-1]), flush=True)
                    if folder:
                        write_json(folder / NUMBERS, {"cores": most, "same_results": same(rows), "rows": rows})
                        chart(rows, most, folder / "threads.png")
    print("results are the same for all numbers of threads:", same(rows))


if __name__ == "__main__":
    main()
