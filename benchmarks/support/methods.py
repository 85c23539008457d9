"""Runs methods of `training.evaluate` on some scenes, and keeps figures and sheets of cuts."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import write_json
from engine.io.picture_file import read_pixels, save_png
from training.evaluate.grid import cells, run_locally
from training.settings import DETAILS, DetailName

__all__ = ["Found", "compare"]

Found = dict[str, dict[str, Any]]
"""Figures by scene and method."""

QUICK_CUTS = 4


def compare(
    name: str,
    text: str | None,
    arguments: Sequence[str] | None,
    *,
    scenes: str,
    detail: DetailName,
    methods: Sequence[str],
    quick_methods: Sequence[str],
    cuts: int,
    shown: int,
    also: Callable[[Path, str], dict[str, Any]] = lambda truth, scene: {},
) -> tuple[Found, Path | None, int]:
    """Runs a benchmark; returns the figures, the folder they were written to, and 1 if a part failed.

    `text`: the benchmark's docstring; `scenes` and `detail`: command-line defaults; `quick_methods`: methods of a
    quick run, which has one scene in draft; `shown`: cuts on a sheet, which has the truth above the methods; `also`:
    further figures of a scene, from the folder of truths. A full run continues from what out/NAME has.
    """
    parser = parser_of(text, f"one scene in draft, few cuts, {' and '.join(quick_methods)} alone")
    parser.add_argument("--scenes", default=scenes)
    parser.add_argument("--detail", default=detail, choices=DETAILS)
    options = parser.parse_args(arguments)
    folder, detail = out_folder(options), options.detail
    chosen = options.scenes.split(",")
    with tempfile.TemporaryDirectory() as scratch:
        work = ROOT / "out" / name / detail
        if options.quick:  # results of an earlier run would not be measured anew
            chosen, detail, methods, cuts, work = ["bread"], "draft", quick_methods, QUICK_CUTS, Path(scratch)
        grid = cells(chosen, methods, [0], detail, cuts, None, work)
        failed = run_locally(grid, lambda cell, what: print(f"{cell.name}: {what}", file=sys.stderr, flush=True))
        found: Found = {
            scene: {cell.method: cell.load_facts() for cell in grid if cell.scene == scene}
            | also(work / "truth", scene)
            for scene in chosen
        }
        print(json.dumps(found, indent=1))
        for scene in chosen if folder else ():
            assert folder is not None
            strips = [work / "results" / scene / f"{strip}.png" for strip in ("truth", *(f"{m}-0" for m in methods))]
            if all(path.is_file() for path in strips):
                rows = [read_pixels(path) for path in strips]
                sheet = np.concatenate([row[:, : shown * row.shape[0]] for row in rows])
                save_png(folder / f"{name}_{scene}.png", sheet, optimize=True)
    if folder:
        write_json(folder / f"{name}.json", {"detail": detail, "cuts": cuts, "scenes": found})
    return found, folder, 1 if failed else 0
