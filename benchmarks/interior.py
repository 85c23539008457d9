"""Insides made by the exemplar prior beside the truth, on held-out cuts.

    python -m benchmarks.interior [--quick] [-o docs/charts] [solid ...]

For each solid of known inside: solves from the pictures of its cut faces, then compares seven cuts (oblique,
off-centre, near the pole) with the true ones. The yardstick is another true solid of the kind on the same cuts; the
ceiling is the truth sampled on the same grid. Writes interior_<solid>.png (truth above, ours below) and interior.json.
`busy` is processor time, which a loaded machine disturbs less.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy import ndimage

from benchmarks.support.options import out_folder, parser_of
from engine.io.files import write_json
from engine.io.picture_file import save_png
from engine.scene.camera import plane_points, section
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from sample_scenes.exemplars import save_photographs
from sample_scenes.solids import SOLIDS, Solid
from training.evaluate.metrics import face_psnr, face_ssim, patch_distance, sharpness
from training.families import COUNTS, Family
from training.priors.exemplar import ExemplarPrior
from training.priors.prior import Volume

CUTS = (
    ((0.3, 0.2, 0.93), 0.05),
    ((0.5, -0.4, 0.77), 0.25),
    ((0.7, 0.1, 0.7), -0.2),
    ((0, 0, 1), 0.3),
    ((0.05, 0, 1), 0.72),
    ((0.35, 1, 0), 0.02),
    ((1, 0.3, 0.1), 0.45),
)
"""Normals, and offsets from the centre as fractions of the half size."""

SIZE = 320
"""Pixels of a cut's picture: a voxel of a 192-voxel volume is about a pixel."""

PHOTOGRAPH = 384
"""Pixels of an exemplar."""

BODY_CELLS = 128


def body_of(solid: Solid, cells: int = BODY_CELLS) -> Body:
    """The solid's depth on a grid: its own near the skin, the distance to the skin deeper."""
    low, high = solid.bounds
    cell = float((high - low).max()) / cells
    grid = Grid.around(solid.bounds, cell, 3)
    near = solid.depth(grid.centres())
    inside, outside = (ndimage.distance_transform_edt(m) for m in (near > 0, near <= 0))
    far = (inside - outside - 0.5 * np.sign(inside - outside)) * cell
    return Body(grid, np.where(np.abs(near) < 1.5 * cell, near, far).astype(np.float32))


def cut_planes(solid: Solid) -> list[Plane]:
    """The cuts through a solid."""
    centre, half = solid.bounds.mean(0), (solid.bounds[1] - solid.bounds[0]) / 2
    return [Plane.through(centre + np.array(n) / np.linalg.norm(n) * offset * half, n) for n, offset in CUTS]


def measure(name: str, voxels: int, folder: Path | None) -> dict[str, float]:
    """Solves one solid, writes its sheet if a folder is given, and returns the figures, means over the cuts."""
    solid, other = SOLIDS[name](0), SOLIDS[name](1)
    body = body_of(solid)
    with tempfile.TemporaryDirectory() as pictures:
        families = [
            Family(kind, COUNTS[kind], save_photographs(solid, kind, Path(pictures), PHOTOGRAPH))
            for kind in solid.families
        ]
        start, busy = time.perf_counter(), time.process_time()
        ours = ExemplarPrior().solve(body, np.asarray(solid.up), families, voxels, 0, lambda part: None)
        seconds, busy = time.perf_counter() - start, time.process_time() - busy
    truth = Volume(ours.body, solid.colour(ours.body.grid.centres()))
    rows: list[dict[str, float]] = []
    sheet = []
    for plane, its in zip(cut_planes(solid), cut_planes(other), strict=True):
        camera = section(plane, solid.up, solid.bounds, SIZE)
        true, inside = solid.slice(plane, camera, supersample=2)
        another, another_inside = other.slice(its, SIZE, supersample=2)
        points = plane_points(camera, plane)
        made, sampled = (np.where(inside[..., None], v.at(points), np.float32(1)) for v in (ours, truth))
        rows.append(
            {
                "psnr": face_psnr(made, true, inside),
                "ssim": face_ssim(made, true, inside),
                "patch": patch_distance(made, inside, true, inside),
                "patch_another": patch_distance(another, another_inside, true, inside),
                "patch_voxelised": patch_distance(sampled, inside, true, inside),
                "sharp": sharpness(made, inside) / sharpness(true, inside),
                "sharp_another": sharpness(another, another_inside) / sharpness(true, inside),
                "sharp_voxelised": sharpness(sampled, inside) / sharpness(true, inside),
            }
        )
        sheet.append(np.concatenate([true, made]))
    if folder:
        save_png(folder / f"interior_{name}.png", np.concatenate(sheet, 1), optimize=True)
    means = {key: round(float(np.mean([row[key] for row in rows])), 4) for key in rows[0]}
    return {"voxels": voxels, "seconds": round(seconds, 1), "busy": round(busy, 1), **means}


def main(arguments: list[str] | None = None) -> None:
    """Measures the solids named, or all of them."""
    parser = parser_of(__doc__, "one solid, coarse")
    parser.add_argument("solids", nargs="*", metavar="solid", help=f"of {', '.join(SOLIDS)} (default: all)")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    if unknown := set(options.solids) - set(SOLIDS):
        parser.error(f"no solid {', '.join(sorted(unknown))}")
    names = options.solids or list(SOLIDS)[: 1 if options.quick else None]
    figures = {}
    for name in names:
        figures[name] = measure(name, 64 if options.quick else 192, folder)
        print(name, figures[name], flush=True)
    if folder:
        target = folder / "interior.json"
        known = json.loads(target.read_text()) if target.exists() else {}
        write_json(target, {"cores": os.cpu_count(), **known, **figures})


if __name__ == "__main__":
    main()
