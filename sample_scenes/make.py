"""Makes the sample scenes: `python -m sample_scenes.make [--out DIR] [--only apple] [--seed 0]`.

For each it writes a 3DGS .ply of its shell, <name>/<name>.ply, and two or three pictures of cut faces per family,
<name>/<family>_1.png and so on. The same seed gives the same bytes on the same machine.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.io.splats.ply import write_ply
from sample_scenes.exemplars import save_photographs
from sample_scenes.shell import LOOKS, shell
from sample_scenes.solids import SOLIDS

__all__ = ["SHIPPED", "main", "make"]

SHIPPED = ("watermelon", "orange", "bread")
"""The scenes that come with the project; the others are made on demand."""

SIZE = 512
"""Pixels along a side of an exemplar."""


def make(name: str, folder: Path, seed: int = 0) -> list[Path]:
    """Writes one scene of `SOLIDS` into folder/name and returns its files. Raises InputError if it cannot write."""
    solid = SOLIDS[name](seed)
    paths = [folder / name / f"{name}.ply"]
    rng = np.random.default_rng([seed, 100])
    comments = (f"sample scene {name}, seed {seed}", "Vertical Axis: z")
    write_ply(paths[0], shell(solid, LOOKS[name], rng), comments)
    for kind in solid.families:
        paths += save_photographs(solid, kind, folder / name, SIZE)
    return paths


def main(arguments: list[str] | None = None) -> int:
    """Runs the command. Returns 0 on success, 2 after one line about what cannot be done."""
    parser = argparse.ArgumentParser(prog="python -m sample_scenes.make", description="Make the sample scenes.")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder (default: beside this file)")
    parser.add_argument(
        "--only",
        action="append",
        choices=sorted(SOLIDS),
        help="one scene; may be given again (default: the three that ship)",
    )
    parser.add_argument("--seed", type=int, default=0, help="another seed makes another fruit of the kind (default 0)")
    options = parser.parse_args(arguments)
    try:
        for name in options.only or SHIPPED:
            files = make(name, options.out, options.seed)
            size = sum(path.stat().st_size for path in files) / 1e6
            print(f"{files[0].parent}: {len(files)} files, {size:.1f} MB")
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
