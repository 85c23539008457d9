"""Random oblique cuts of each sample scene beside the truth: the part of `fruitninja-evaluate` that is kept as charts.

    python -m benchmarks.oblique_cuts [--detail standard] [--scenes watermelon,orange] [--quick] [-o docs/charts]

Writes oblique_cuts.json and, for each scene, six cuts as a sheet: truth, ours, nearest surface colour (the PhysGaussian
rule), and ours given the true slices as labels. Started again after an interruption it goes on; delete
out/oblique_cuts to measure anew. `another` is another true solid of the kind on the same cuts.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from safetensors.numpy import load_file

from benchmarks.support.options import ROOT, out_folder, parser_of, write_json
from engine.io.files import atomic
from engine.io.picture_file import read_pixels
from training.evaluate.grid import cells, run_locally
from training.evaluate.metrics import face_psnr
from training.settings import DetailName

METHODS = ("ours", "physgaussian", "oracle")
CUTS = 24
QUICK, QUICK_CUTS = ("physgaussian", "ours"), 4
"""Methods and cuts of a quick run."""


def another(truth: Path, scene: str) -> dict[str, float] | None:
    """What a second true solid of the kind would reach; None where there is no second one."""
    second = truth / f"{scene}_another.safetensors"
    if not second.is_file():
        return None
    theirs, true = load_file(second), load_file(truth / f"{scene}.safetensors")
    both = theirs["inside"] & true["inside"][: len(theirs["inside"])]
    rows = zip(theirs["pictures"], true["pictures"], both, strict=False)
    return {"psnr_db": round(float(np.mean([face_psnr(a, b, inside) for a, b, inside in rows])), 3)}


def main(arguments: list[str] | None = None) -> int:
    """Runs the scenes asked for and writes what was measured; 1 where a part failed."""
    parser = parser_of(__doc__, "one scene in draft, few cuts")
    parser.add_argument(
        "--scenes",
        default="watermelon_others,orange_others,apple_others,pomegranate_others,watermelon,orange,bread,thigh",
    )
    parser.add_argument("--detail", default="standard", choices=["draft", "standard", "high"])
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    if options.quick:
        with tempfile.TemporaryDirectory() as work:  # what an earlier run left would be no measurement
            return run(["bread"], "draft", QUICK, QUICK_CUTS, Path(work), folder)
    work = ROOT / "out/oblique_cuts" / options.detail
    return run(options.scenes.split(","), options.detail, METHODS, CUTS, work, folder)


def run(
    scenes: list[str], detail: DetailName, methods: Sequence[str], cuts: int, work: Path, folder: Path | None
) -> int:
    """Measures what is not yet in `work`, and writes it to the folder if there is one; 1 where a part failed."""
    grid = cells(scenes, methods, [0], detail, cuts, None, work)
    failed = run_locally(grid, lambda cell, what: print(f"{cell.name}: {what}", file=sys.stderr, flush=True))
    found: dict[str, dict[str, Any]] = {
        scene: {cell.method: cell.load_facts() for cell in grid if cell.scene == scene} for scene in scenes
    }
    for scene in scenes:
        found[scene]["another"] = another(work / "truth", scene)
    print(json.dumps(found, indent=1))
    if not folder:
        return 1 if failed else 0
    for scene in scenes:
        strips = [work / "results" / scene / f"{name}.png" for name in ("truth", *(f"{m}-0" for m in methods))]
        if all(path.is_file() for path in strips):
            sheet = np.concatenate([read_pixels(path) for path in strips])
            with atomic(folder / f"oblique_cuts_{scene}.png") as temporary:
                Image.fromarray(sheet).save(temporary, format="PNG", optimize=True)
    write_json(folder / "oblique_cuts.json", {"detail": detail, "cuts": cuts, "scenes": found})
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
