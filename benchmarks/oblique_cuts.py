"""Random oblique cuts of each sample scene beside the truth: the part of `fruitninja-evaluate` that is kept as charts.

    python -m benchmarks.oblique_cuts [--detail standard] [--scenes watermelon,orange] [--out docs/charts]

Writes oblique_cuts.json and, for each scene, six cuts as a sheet: truth, ours, nearest surface colour (the PhysGaussian
rule), and ours given the true slices as labels. Started again after an interruption it goes on; delete
out/oblique_cuts to measure anew. `another` is another true solid of the kind on the same cuts.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from safetensors.numpy import load_file

from engine.io.files import atomic
from engine.io.picture_file import read_pixels
from training.evaluate.grid import cells, run_locally
from training.evaluate.metrics import face_psnr

ROOT = Path(__file__).parents[1]
METHODS = ("ours", "physgaussian", "oracle")
CUTS = 24


def another(truth: Path, scene: str) -> dict[str, float] | None:
    """What a second true solid of the kind would reach; None where there is no second one."""
    second = truth / f"{scene}_another.safetensors"
    if not second.is_file():
        return None
    theirs, true = load_file(second), load_file(truth / f"{scene}.safetensors")
    both = theirs["inside"] & true["inside"][: len(theirs["inside"])]
    rows = zip(theirs["pictures"], true["pictures"], both, strict=False)
    return {"psnr_db": round(float(np.mean([face_psnr(a, b, inside) for a, b, inside in rows])), 3)}


def main() -> int:
    """Runs the scenes asked for and writes what was measured; 1 where a part failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", default="watermelon,orange,bread,thigh")
    parser.add_argument("--detail", default="standard", choices=["draft", "standard", "high"])
    parser.add_argument("--out", type=Path, default=ROOT / "docs/charts")
    options = parser.parse_args()
    scenes = options.scenes.split(",")
    work = ROOT / "out/oblique_cuts" / options.detail
    grid = cells(scenes, METHODS, [0], options.detail, CUTS, None, work)
    failed = run_locally(grid, lambda cell, what: print(f"{cell.name}: {what}", file=sys.stderr, flush=True))
    found = {scene: {cell.method: cell.kept() for cell in grid if cell.scene == scene} for scene in scenes}
    for scene in scenes:
        strips = [work / "results" / scene / f"{name}.png" for name in ("truth", *(f"{m}-0" for m in METHODS))]
        if all(path.is_file() for path in strips):
            sheet = np.concatenate([read_pixels(path) for path in strips])
            with atomic(options.out / f"oblique_cuts_{scene}.png") as temporary:
                Image.fromarray(sheet).save(temporary, format="PNG", optimize=True)
    for scene in scenes:
        found[scene]["another"] = another(work / "truth", scene)
    record = {"detail": options.detail, "cuts": CUTS, "scenes": found}
    with atomic(options.out / "oblique_cuts.json") as temporary:
        temporary.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
