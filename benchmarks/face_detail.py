"""Cut faces at rest, read from the inside, beside the same faces drawn from atoms, at 1, 3 and 8 times the size.

    python -m benchmarks.face_detail [--quick] [-o docs/charts] [--detail standard] [--scenes orange_others,...]

Scenes with pictures of other individuals, whose insides are quilted, and with two cuts of the same object, whose
layers are continued. Measures, in the plane of the horizontal picture: sharpness (RMS Laplacian) over that of the
picture drawn as large, and SSIM with it at 768 pixels. Then the seconds to read a face that fills half of a 1280x720
window; the bytes of both files; and the difference from one frame to the next while a plane moves by a tenth of a
cell: a face that is read at its places and prefiltered does not flicker. Writes face_detail.json, the chart
face_detail.png and an oblique cut of each scene as face_detail_<scene>.png (atoms above, the inside below). Trained
objects are kept in out/face_detail; delete it to measure anew.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.support.charts import plt, save_chart
from benchmarks.support.options import ROOT, out_folder, parser_of
from engine.io.files import write_json
from engine.io.picture_file import save_png
from engine.io.trained import inside_path, load_trained
from engine.render.cpu import opaque
from engine.render.cpu.kernel_field import KernelField
from engine.render.face_detail import Detailed, detailed
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, plane_points, section
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.evaluate.metrics import face_ssim, sharpness
from training.evaluate.scenes import load_scene
from training.events import Reporter
from training.pipeline import run
from training.priors.exemplar.layering.inside import LayeredInside
from training.priors.exemplar.pictures import read_picture
from training.priors.exemplar.quilting.chunks import Ball
from training.priors.exemplar.quilting.disc import Disc
from training.priors.exemplar.quilting.inside import QuiltInside
from training.priors.inside_file import read_inside
from training.request import Request
from training.settings import DetailName

ZOOMS = (1.0, 3.0, 8.0)
SIZE, FINE_SIZE = 512, 768
CORE = 0.75
"""Radius in the ball within which a face is measured: outside it the rind would dominate the sharpness."""

Known = LayeredInside | QuiltInside

SCENES = "watermelon_others,orange_others,apple_others,pomegranate_others,watermelon,orange"

BESIDE = 0.2
"""Distance from the axis to the centre of the closer views, over the radius of the ball around the object."""

OBLIQUE = (0.5, -0.3, 1.0)
HALF_A_WINDOW = 1280 * 720 // 2
FRAMES = 60


def trained(name: str, detail: DetailName, folder: Path) -> tuple[Path, tuple[float, float, float], Disc]:
    """The trained object of a scene (trained if it is not there yet), its up axis and its horizontal picture."""
    scene = load_scene(name, folder)
    out = folder / "trained" / detail / name
    path = out / f"{scene.scene.stem}.ply"
    if not path.is_file():
        families = tuple(replace(family, count=min(family.count, 8)) for family in scene.families)
        request = Request(scene.scene, families, detail, scene.solid.up)
        path = run(request, out, Reporter(), False, lambda: False)
    (pictures,) = (family.exemplars for family in scene.families if family.kind == "horizontal")
    return path, scene.solid.up, Disc.of(read_picture(pictures[0], "horizontal"))


def views(atoms: Atoms, plane: Plane, up: NDArray[np.float64], size: int, zooms: tuple[float, ...]) -> list[Camera]:
    """Cameras straight onto a plane; the closer ones look beside the axis, at flesh and seeds."""
    bounds = atoms.bounds
    radius = float(np.linalg.norm(bounds[1] - bounds[0])) / 2
    aside = BESIDE * radius / np.sqrt(2)
    cameras = [section(plane, up, bounds, size, radius / zoom) for zoom in zooms]
    return [
        camera if zoom == 1 else replace(camera, cx=camera.cx - aside * camera.fx, cy=camera.cy - aside * camera.fy)
        for camera, zoom in zip(cameras, zooms, strict=True)
    ]


def faces(
    atoms: Atoms, inside: Inside, field: KernelField, plane: Plane, camera: Camera
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The face drawn from atoms and the face read from the inside, both (H, W, 3)."""
    plain = opaque.render(atoms, camera, [plane], field=field)
    read = detailed(plain, camera, [Piece((plane,))], [Detailed(inside, atoms.pitch)], light=False)
    return np.clip(plain.rgb, 0, 1), np.clip(read.rgb, 0, 1)


def photograph(
    inside: Known, picture: Disc, points: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The horizontal picture (H, W, 3) at places (H, W, 3) in its plane, and the pixels to measure (H, W)."""
    cells = (points.reshape(-1, 3).astype(np.float64) - inside.origin) / inside.cell
    if isinstance(inside, QuiltInside):
        ball = Ball.of(inside.ball.to_ball((cells @ inside.basis.T).astype(np.float32)))
        level, length = ball.level, ball.length
    else:
        places = inside.shape.places(cells)
        level = places.share[:, None] * np.stack([np.cos(places.angle), np.sin(places.angle)], -1)
        length = np.maximum(places.share, np.abs(places.height))
    return picture.read(*level.T).reshape(points.shape), (length < CORE).reshape(points.shape[:2])


def measure(name: str, detail: DetailName, folder: Path) -> tuple[dict[str, Any], NDArray[np.float32]]:
    """The figures of a scene, and its oblique cut (H, W, 3) at all zooms."""
    path, axis, picture = trained(name, detail, folder)
    atoms, _ = load_trained(path)
    inside = read_inside(path)
    assert isinstance(inside, Known), f"{name} has no pictures"
    field, up = KernelField(atoms), np.asarray(axis, np.float64)
    own = Plane.through(inside.origin, up)
    sharp: dict[str, list[float]] = {"atoms": [], "inside": []}
    for camera in views(atoms, own, up, SIZE, ZOOMS):
        truth, core = photograph(inside, picture, plane_points(camera, own))
        for key, face in zip(sharp, faces(atoms, inside, field, own, camera), strict=True):
            sharp[key].append(round(sharpness(face, core) / sharpness(truth, core), 3))
    (camera,) = views(atoms, own, up, FINE_SIZE, (1.0,))
    truth, core = photograph(inside, picture, plane_points(camera, own))
    alike = [round(face_ssim(face, truth, core), 3) for face in faces(atoms, inside, field, own, camera)]

    oblique = Plane.through(inside.origin, OBLIQUE)
    cameras = views(atoms, oblique, up, SIZE, ZOOMS)
    sheet = [
        np.concatenate(row, 1) for row in zip(*(faces(atoms, inside, field, oblique, c) for c in cameras), strict=True)
    ]
    points = plane_points(cameras[0], oblique).reshape(-1, 3)
    footprint = float(np.linalg.norm(points[1] - points[0]))
    many = np.resize(points, (HALF_A_WINDOW, 3))
    inside.at(many, footprint)
    begin = time.perf_counter()
    inside.at(many, footprint)
    seconds = time.perf_counter() - begin
    deep = points[photograph(inside, picture, points[None])[1][0]]
    step = 0.1 * inside.cell * np.asarray(oblique.normal)
    change: dict[str, list[float]] = {"atoms": [], "inside": []}
    last: dict[str, NDArray[np.float32]] = {}
    for frame in range(FRAMES):
        moved = deep + frame * step
        found = {
            "atoms": field.at(moved, np.full(len(moved), footprint, np.float32))[0],
            "inside": inside.at(moved, footprint),
        }
        for key, rgb in found.items():
            if last:
                change[key].append(float(np.abs(rgb - last[key]).mean()))
        last = found
    figures = {
        "sharpness_over_the_picture": dict(zip(map(str, ZOOMS), zip(*sharp.values(), strict=True), strict=True)),
        "ssim_at_768": dict(zip(sharp, alike, strict=True)),
        "seconds_for_half_a_window": round(seconds, 3),
        "bytes": {"ply": path.stat().st_size, "inside": inside_path(path).stat().st_size},
        "mean_change_per_tenth_of_a_cell": {key: round(float(np.mean(values)), 5) for key, values in change.items()},
        "largest_over_mean_change": {
            key: round(float(np.max(values) / np.mean(values)), 2) for key, values in change.items()
        },
    }
    return figures, np.concatenate(sheet)


def draw_chart(found: dict[str, dict[str, Any]], path: Path) -> None:
    """Sharpness against zoom."""
    figure, axis = plt.subplots(figsize=(6, 3.6))
    for name, figures in found.items():
        values = np.array(list(figures["sharpness_over_the_picture"].values()))
        (line,) = axis.plot(ZOOMS, values[:, 1], "o-", label=name.replace("_", ", "))
        axis.plot(ZOOMS, values[:, 0], "o:", color=line.get_color())
    axis.axhline(1, color="grey", lw=0.8)
    axis.set(xlabel="times the size", ylabel="sharpness over the picture's", xscale="log", ylim=(0, None))
    axis.set_xticks(ZOOMS, [f"{zoom:g}" for zoom in ZOOMS])
    axis.minorticks_off()
    axis.set_title("read from the inside (solid) and of atoms (dotted)", fontsize=9)
    axis.legend(fontsize=8)
    figure.tight_layout()
    save_chart(figure, path)


def main(arguments: list[str] | None = None) -> int:
    """Measures every scene."""
    parser = parser_of(__doc__, "one scene in draft")
    parser.add_argument("--scenes", default=SCENES)
    parser.add_argument("--detail", default="standard", choices=["draft", "standard", "high"])
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    names, detail = options.scenes.split(","), options.detail
    with tempfile.TemporaryDirectory() as scratch:
        work = ROOT / "out/face_detail"
        if options.quick:
            names, detail, work = ["orange_others"], "draft", Path(scratch)
        found = {}
        for name in names:
            found[name], sheet = measure(name, detail, work)
            print(name, found[name], flush=True)
            if folder:
                save_png(folder / f"face_detail_{name}.png", sheet, optimize=True)
    if folder:
        write_json(folder / "face_detail.json", {"detail": detail, "scenes": found})
        draw_chart(found, folder / "face_detail.png")
    return 0


if __name__ == "__main__":
    sys.exit(main())
