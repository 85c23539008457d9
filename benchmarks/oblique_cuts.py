"""Random oblique cuts of each sample scene beside the truth: the part of `fruitninja-evaluate` that is charted.

    python -m benchmarks.oblique_cuts [--detail standard] [--scenes watermelon,orange] [--quick] [-o docs/charts]

Writes oblique_cuts.json and, for each scene, six cuts as a sheet: truth, ours, nearest surface colour (the PhysGaussian
rule), and ours given the true slices as labels. An interrupted run continues when it is started again; delete
out/oblique_cuts to measure anew. `another` is another true solid of the kind on the same cuts.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

from benchmarks.support.methods import compare
from training.evaluate.metrics import face_psnr


def another(truth: Path, scene: str) -> dict[str, Any]:
    """The score of a second true solid of the kind, as if it were a method; null where there is no second one."""
    second = truth / f"{scene}_another.safetensors"
    if not second.is_file():
        return {"another": None}
    theirs, true = load_file(second), load_file(truth / f"{scene}.safetensors")
    both = theirs["inside"] & true["inside"][: len(theirs["inside"])]
    rows = zip(theirs["pictures"], true["pictures"], both, strict=False)
    return {"another": {"psnr_db": round(float(np.mean([face_psnr(a, b, inside) for a, b, inside in rows])), 3)}}


def main(arguments: list[str] | None = None) -> int:
    """Runs the scenes asked for and writes the results; returns 1 if a part failed."""
    _, _, failed = compare(
        "oblique_cuts",
        __doc__,
        arguments,
        scenes="watermelon_others,orange_others,apple_others,pomegranate_others,watermelon,orange,bread,thigh",
        detail="standard",
        methods=("ours", "physgaussian", "oracle"),
        quick_methods=("physgaussian", "ours"),
        cuts=24,
        shown=6,
        also=another,
    )
    return failed


if __name__ == "__main__":
    sys.exit(main())
