"""How closely the solid resembles the capture that it was made from, in held-out views.

    python -m benchmarks.fidelity [--quick] [-o docs/charts] [--detail draft,standard,high] [--tolerance 0.05,0.1,0.2]
        [CAPTURE ...]

The capture, without the haze and floaters that are meant to go, is drawn as 3DGS; the solid as opaque atoms, after
everything that training does to its skin. Means over twelve views of the PSNR over the union of both silhouettes, of
the PSNR over what both show as opaque, and of the IoU of the silhouettes; over four views with four times the pixels,
the PSNR and the length of the solid's outline over the capture's; and how much of the front is filled by the inside
right below it, so that cuts have no gaps at their rim. Writes fidelity.json, the chart fidelity.png and, for each
capture, fidelity_<capture>.png (the capture, the solid below it, and the solid cut in half with a plain inside).
Measures the samples if no capture is given.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray
from skimage.measure import perimeter

from benchmarks.support.charts import plt, save_chart
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.errors import InputError
from engine.io.files import write_json
from engine.io.picture_file import save_png
from engine.render.classic import rasterizer as classic
from engine.render.cpu import opaque
from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, cameras_around
from engine.scene.constants import SOLID_DENSITY
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.image import psnr
from engine.scene.plane import Plane
from engine.solid.fill import fill
from engine.solid.skin_cover import inward_normals, sample_skin
from engine.solid.visible_skin import front_heights
from training.events import Reporter
from training.families import Family
from training.pipeline import prepare
from training.request import Geometry, Request
from training.settings import DETAILS, Detail, DetailName
from training.skin import match_skin
from training.views import BACKGROUND

SAMPLES = ("watermelon", "orange", "bread")

VIEWS, SIZE = 12, 512

CLOSER, CLOSER_VIEWS = 4, 4
"""Times the pixels, as near as a user looks, where a soft rim that was copied as hairs shows; and how many views."""

TURN = 17.0
"""Degrees by which these cameras are turned from the fitted ones, so that no view is shared."""

LEAN = 0.4
"""Tangent of the angle by which a cut face is turned from the camera."""

BELOW = 0.75
"""Pitches. Depth below the front at which a solid must be filled: interior atoms lie deeper than half of one."""

SHOWN_EVERY = 3
"""One view in this many is shown in the picture."""


@dataclass(frozen=True)
class Tolerant(Request):
    """A request that may replace the tolerance of its level of detail."""

    tolerance: float | None = None

    @property
    def fineness(self) -> Detail:
        fineness = super().fineness
        return fineness if self.tolerance is None else replace(fineness, tolerance=self.tolerance)


def make_solid(path: Path, detail: DetailName, tolerance: float | None) -> tuple[Atoms, Geometry]:
    """The solid with its skin fitted as training does, and what it was made from. Raises InputError."""
    request = Tolerant(
        path, (Family("horizontal", 4),), detail=detail, tolerance=tolerance
    )  # the inside is not looked at
    geometry, _ = prepare(request, Reporter(), lambda: None)
    atoms = geometry.filled(fill(geometry.body, geometry.pitch, request.seed))
    atoms = match_skin(atoms, geometry.gaussians, geometry.enclosed, geometry.up, request.fineness, request.seed)
    return atoms, geometry


def filled_share(atoms: Atoms, body: Body) -> float:
    """Share of the front of a body's skin below which, by BELOW, interior atoms fill it. Range [0, 1]."""
    points = sample_skin(body, atoms.pitch)
    outwards = -inward_normals(body, points)
    heights = front_heights(atoms.surface, points, outwards, atoms.pitch)
    seen = np.isfinite(heights)
    below = points[seen] + outwards[seen] * (heights[seen] - BELOW * atoms.pitch)[:, None]
    return float((KernelField(atoms.without_skin()).at(below)[1] >= SOLID_DENSITY).mean())


def measure(
    path: Path, detail: DetailName, tolerance: float | None, views: int
) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """The figures of one capture, and the picture (H, W, 3) of some views. Raises InputError."""
    begun = time.perf_counter()
    atoms, geometry = make_solid(path, detail, tolerance)
    capture, up = geometry.gaussians, geometry.up
    seconds = time.perf_counter() - begun
    low, high = capture.visible_bounds()
    radius = float(np.linalg.norm(high - low)) / 2
    rows, columns = [], []
    for k, camera in enumerate(cameras_around((low + high) / 2, radius, up, views, SIZE, turn=TURN)):
        there = classic.render(capture, camera, BACKGROUND)
        here = opaque.render(atoms, camera, background=BACKGROUND)
        one, other = np.clip(there.rgb, 0, 1), np.clip(here.rgb, 0, 1)
        union, both = (there.alpha > 0.5) | (here.alpha > 0.5), (there.alpha > 0.5) & (here.alpha > 0.5)
        solid = (there.alpha > 0.95) & (here.alpha > 0.5)
        rows.append((psnr(one[union], other[union]), psnr(one[solid], other[solid]), both.sum() / max(union.sum(), 1)))
        if k % SHOWN_EVERY == 1:
            half = opaque.render(atoms, camera, [halving(camera, (low + high) / 2)], BACKGROUND)
            columns.append(np.concatenate([one, other, np.clip(half.rgb, 0, 1)]))
    union_db, opaque_db, iou = (float(value) for value in np.mean(rows, axis=0))
    closer = cameras_around((low + high) / 2, radius, up, min(views, CLOSER_VIEWS), CLOSER * SIZE, turn=TURN)
    closer_db, outline = np.mean([close_up(atoms, capture, camera) for camera in closer], axis=0).tolist()
    figures = {
        "gaussians": len(capture),
        "surface_atoms": len(atoms.surface),
        "union_db": round(union_db, 2),
        "opaque_db": round(opaque_db, 2),
        "silhouette_iou": round(iou, 4),
        "closer_db": round(closer_db, 2),
        "outline": round(outline, 3),
        "filled": round(filled_share(atoms, geometry.body), 4),
        "seconds": round(seconds, 1),
    }
    return figures, np.concatenate(columns, axis=1)


def close_up(atoms: Atoms, capture: Gaussians, camera: Camera) -> tuple[float, float]:
    """PSNR over both silhouettes in one view, and the length of the solid's outline over that of the capture's: above 1
    it is frayed."""
    there, here = classic.render(capture, camera, BACKGROUND), opaque.render(atoms, camera, background=BACKGROUND)
    one, other = there.alpha > 0.5, here.alpha > 0.5
    union = one | other
    db = psnr(np.clip(there.rgb, 0, 1)[union], np.clip(here.rgb, 0, 1)[union])
    return db, float(perimeter(other) / perimeter(one))


def halving(camera: Camera, centre: NDArray[np.float64]) -> Plane:
    """A plane through the centre (3,) that removes the half towards the camera and leans to its side."""
    return Plane.through(centre, LEAN * camera.viewmat[0, :3] - camera.forward)


def draw_chart(found: dict[str, dict[str, Any]], path: Path) -> None:
    """A line for each capture through its levels of detail."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True)
    for axis, key, name in zip(axes, ("surface_atoms", "seconds"), ("atoms of the skin", "seconds"), strict=True):
        for capture, rows in found.items():
            points = list(rows.values())
            axis.plot([p[key] for p in points], [p["union_db"] for p in points], "o-", label=capture.split(".")[0])
        axis.set(xlabel=name, xscale="log")
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("PSNR at unseen views, dB")
    axes[1].legend(fontsize=7)
    figure.tight_layout()
    save_chart(figure, path)


def tolerances(text: str) -> list[float]:
    """Numbers separated by commas. Raises ValueError."""
    return [float(part) for part in text.split(",")]


def main(arguments: list[str] | None = None) -> int:
    """Measures every capture; returns 1 if one was refused."""
    parser = parser_of(__doc__, "the first capture in draft, two views")
    parser.add_argument("captures", type=Path, nargs="*", metavar="CAPTURE")
    parser.add_argument("--detail", default="standard", help="one or several, with commas: " + ",".join(DETAILS))
    parser.add_argument(
        "--tolerance", type=tolerances, default=[None], help="one or several, with commas, in place of the detail's"
    )
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    paths = options.captures or [ROOT / f"sample_scenes/{name}/{name}.ply" for name in SAMPLES]
    unknown = set(options.detail.split(",")) - DETAILS.keys()
    if unknown:
        parser.error(f"--detail {','.join(sorted(unknown))}: unknown; choose {', '.join(DETAILS)}")
    details = [detail for detail in DETAILS if detail in options.detail.split(",")]
    views = VIEWS
    if options.quick:
        paths, details, views = paths[:1], ["draft"], 2
    found: dict[str, dict[str, Any]] = {path.name: {} for path in paths}
    refused = False
    for path, detail, tolerance in product(paths, details, options.tolerance):
        name = detail if tolerance is None else f"{detail} at {tolerance}"
        try:
            found[path.name][name], picture = measure(path, detail, tolerance, views)
        except InputError as error:
            print(error, file=sys.stderr)
            refused = True
            continue
        print(path.name, name, found[path.name][name], flush=True)
        if folder:
            save_png(folder / f"fidelity_{path.stem}.png", picture, optimize=True)
    if folder:
        write_json(folder / "fidelity.json", {"views": views, "captures": found})
        draw_chart(found, folder / "fidelity.png")
    return 1 if refused else 0


if __name__ == "__main__":
    sys.exit(main())
