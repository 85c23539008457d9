"""The whole main job against the truth: 20 random oblique cuts of each sample solid, beside two simple fills.

    python -m benchmarks.oblique_cuts [--detail standard] [--scene watermelon]... [--out docs/charts]

Writes oblique_cuts.json and a sheet of the first six cuts (truth, ours, nearest surface colour) for each scene.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from engine import sh
from engine.atoms import Atoms
from engine.camera import Camera, on_plane, section
from engine.kernel_field import KernelField
from engine.plane import Plane
from engine.trained import load_trained
from sample_scenes.solids import SOLIDS
from sample_scenes.solids.solid import Solid
from training.contact_sheet import to_image
from training.events import Reporter
from training.families import COUNTS, Family, Kind
from training.metrics import face_psnr, face_ssim, patch_distance, sharpness
from training.request import Request
from training.run import run
from training.settings import DetailName

CUTS = 20
SIZE = 288
SHOWN = 6
SCENES = Path(__file__).parents[1] / "sample_scenes"


def random_planes(bounds: np.ndarray, rng: np.random.Generator) -> list[Plane]:
    """Planes of random direction, up to half way from the centre to the skin."""
    planes = []
    for _ in range(CUTS):
        normal = rng.standard_normal(3)
        reach = float(np.abs(bounds).max(0) @ np.abs(normal / np.linalg.norm(normal))) / np.sqrt(3)
        planes.append(Plane.through(normal / np.linalg.norm(normal) * reach * rng.uniform(-0.5, 0.5), normal))
    return planes


def request_for(name: str, detail: DetailName) -> Request:
    """The scene's first picture of each family, the paper's number of planes."""
    folder = SCENES / name
    kinds: list[Kind] = [kind for kind in COUNTS if (folder / f"{kind}_1.png").exists()]
    families = tuple(
        Family(kind, COUNTS[kind], (folder / f"{kind}_1.png",), axis=(1.0, 0.0, 0.0) if kind == "parallel" else None)
        for kind in kinds
    )
    return Request(folder / f"{name}.ply", families, detail, (0.0, 0.0, 1.0))


def nearest_surface(atoms: Atoms) -> Atoms:
    """The PhysGaussian rule: every interior atom takes the colour of the nearest surface atom."""
    _, index = cKDTree(atoms.surface.means).query(atoms.interior.means)
    rgb = np.clip(sh.sh_to_rgb(atoms.surface.sh[index, 0]), 0, 1).astype(np.float32)
    return replace(atoms, interior=replace(atoms.interior, rgb=rgb))


def evaluate(name: str, detail: DetailName, out: Path) -> dict[str, object]:
    """Figures of one scene; its sheet is written to `out`."""
    solid, other = SOLIDS[name](0), SOLIDS[name](1)
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        path = run(request_for(name, detail), Path(folder), Reporter(), False, lambda: False)
        seconds = time.perf_counter() - begun
        report = json.loads((Path(folder) / "report.json").read_text())
        atoms, _ = load_trained(path)
    fields = {"ours": KernelField(atoms), "nearest surface": KernelField(nearest_surface(atoms))}
    planes = random_planes(np.asarray(solid.bounds), np.random.default_rng(7))
    methods = ("ours", "nearest surface", "mean colour", "another of its kind")
    figures: dict[str, list[list[float]]] = {method: [] for method in methods}
    rows: list[list[np.ndarray]] = [[], [], []]
    for plane in planes:
        camera = section(plane, solid.up, solid.bounds, SIZE, float(np.abs(solid.bounds).max()))
        truth, inside = slice_of(solid, plane, camera)
        second, inside_second = slice_of(other, plane, camera)
        points = on_plane(camera, plane).reshape(-1, 3)
        pictures = {key: field.at(points)[0].reshape(truth.shape) for key, field in fields.items()}
        pictures["mean colour"] = np.broadcast_to(truth[inside].mean(0), truth.shape).astype(np.float32)
        pictures["another of its kind"] = second
        both = inside & inside_second
        for method in methods:
            picture = pictures[method]
            mask = both if method == "another of its kind" else inside
            figures[method].append(
                [
                    face_psnr(picture, truth, mask),
                    face_ssim(picture, truth, mask),
                    patch_distance(picture, mask, truth, inside),
                    sharpness(picture, mask) / sharpness(truth, inside),
                ]
            )
        for row, picture in zip(rows, (truth, pictures["ours"], pictures["nearest surface"]), strict=True):
            row.append(np.where(inside[..., None], picture, 1))
    sheet = np.concatenate([np.concatenate(row[:SHOWN], axis=1) for row in rows], axis=0)
    out.mkdir(parents=True, exist_ok=True)
    to_image(sheet).save(out / f"oblique_cuts_{name}.png", optimize=True)
    named = ("psnr_db", "ssim", "patch_distance", "sharpness")
    return {
        "seconds": round(seconds, 1),
        "stages": report["seconds"],
        "atoms": len(atoms),
        "surface_psnr_db": report["surface_psnr_db"],
        "methods": {m: dict(zip(named, np.mean(f, axis=0).round(4).tolist(), strict=True)) for m, f in figures.items()},
    }


def slice_of(solid: Solid, plane: Plane, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) and (H, W) of the true cut."""
    rgb, inside = solid.slice(plane, camera)
    return np.asarray(rgb, np.float32), np.asarray(inside, bool)


def main() -> None:
    """Runs the scenes asked for and writes what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", action="append", choices=["watermelon", "orange", "bread"])
    parser.add_argument("--detail", default="standard", choices=["draft", "standard", "high"])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs/charts")
    arguments = parser.parse_args()
    result = {}
    for name in arguments.scene or ["watermelon", "orange", "bread"]:
        result[name] = evaluate(name, arguments.detail, arguments.out)
        print(name, json.dumps(result[name], indent=1))
    path = arguments.out / "oblique_cuts.json"
    path.write_text(json.dumps({"detail": arguments.detail, "cuts": CUTS, "scenes": result}, indent=1) + "\n")


if __name__ == "__main__":
    main()
