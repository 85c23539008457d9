"""Splat files in and out: what each format costs, and how far other programs' readers and writers differ from ours.

    python -m benchmarks.readers.formats [--quick] [-o docs/charts]

Out: we write a solid of a million atoms, and others read it. In: others write twenty thousand, since some take
minutes for a million, and we read them. Others are gaussforge, pygltflib and usd-core (the extras dev and usd), and
splat-transform where it is on the PATH (npm install -g @playcanvas/splat-transform). Errors are the largest over every
tenth atom: of positions in widths of the solid, of sizes as a fraction, of colours from 0 to 1, of rotations in
degrees, and of spherical harmonics. Seconds are of processor time. Writes formats.json.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.support.options import out_folder, parser_of
from engine.io.files import write_json
from engine.io.load import load
from engine.io.splats.ply import write_ply
from engine.io.writers.provenance import Provenance
from engine.io.writers.solid_gaussians import ATOM_OPACITY
from engine.io.writers.splats import write_splats
from engine.scene.gaussians import Gaussians
from engine.scene.morton import morton_order
from engine.scene.moved import moved, upright
from engine.scene.sh import C0, rgb_to_sh

ATOMS, QUICK_ATOMS = 1_000_000, 20_000

SKIN = 0.1
"""Fraction of the atoms in the skin of a solid of a million."""

COMPARED = 100_000
"""Number of atoms whose errors are measured: every tenth of a million."""

UP = (0.0, -1.0, 0.0)

FLIPS = {"as written": (1, 1, 1), "y and z": (1, -1, -1), "x and y": (-1, -1, 1)}
"""Half turns by which programs bring a file into their own axes."""


def solid(atoms: int) -> Gaussians:
    """A solid like a trained one: flat atoms with SH on a sphere, finer and coarser round ones in it."""
    rng = np.random.default_rng(0)
    skin = int(SKIN * atoms)
    means = rng.normal(size=(atoms, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True) * 2
    means[skin:] *= rng.random((atoms - skin, 1)) ** (1 / 3)
    pitch = atoms ** (-1 / 3)
    scales = np.repeat(pitch / 2 * rng.choice([1.0, 2.0], (atoms, 1), p=[0.7, 0.3]), 3, axis=1)
    scales[:skin] = pitch * np.exp(rng.uniform(-2.5, 0, (skin, 3)))
    quats = np.tile([1.0, 0, 0, 0], (atoms, 1))
    quats[:skin] = rng.normal(size=(skin, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = np.zeros((atoms, 9, 3))
    sh[:, 0] = rgb_to_sh(0.5 + 0.45 * np.sin(9 * means + rng.normal(size=(atoms, 3)) / 9))
    sh[:skin, 1:] = rng.normal(size=(skin, 8, 3)) / 12
    order = np.concatenate([morton_order(means[:skin]), skin + morton_order(means[skin:])])
    arrays = (means, scales, quats, np.full(atoms, ATOM_OPACITY), sh)
    return Gaussians(*(np.ascontiguousarray(array[order], np.float32) for array in arrays))


def errors(true: Gaussians, found: Gaussians) -> dict[str, Any]:
    """The largest errors, after the half turn that brings the positions nearest, and how many atoms were read."""
    count, same = len(found), np.arange(0, len(true), max(1, len(true) // COMPARED))
    in_order, true = count == len(true), true[same]
    tree = cKDTree(found.means)
    turned = {name: moved(true, np.diag(np.array(signs, np.float64))) for name, signs in FLIPS.items()}
    axes = min(FLIPS, key=lambda name: float(tree.query(turned[name].means[::100])[0].mean()))
    true = turned[axes]
    near, rows = tree.query(true.means)
    if in_order:  # where positions are coarser than the spacing of atoms, the nearest may be a neighbour
        apart = np.linalg.norm(found.means[same] - true.means, axis=1)
        near, rows = (apart, same) if apart.mean() < 2 * near.mean() + 1e-9 else (near, rows)
    found = found[rows]
    turn = np.abs((found.quats.astype(np.float64) * true.quats).sum(1)).clip(0, 1)
    firm = true.scales.max(1) > 1.02 * true.scales.min(1)  # a sphere has no rotation
    bands = min(found.sh.shape[1], true.sh.shape[1])
    # Flipped axes of an ellipsoid are the same ellipsoid: rotations are compared up to half turns about the axes.
    for half in (np.array([0, 1, 0, 0]), np.array([0, 0, 1, 0]), np.array([0, 0, 0, 1])):
        turn = np.maximum(turn, np.abs((found.quats * _after(true.quats, half)).sum(1)).clip(0, 1))
    return {
        "atoms": count,
        "axes": axes,
        "place": float(near.max()),
        "size": float(np.abs(found.scales / true.scales - 1).max()),
        "colour": float(np.abs(found.sh[:, 0] - true.sh[:, 0]).max() * C0),
        "turn_degrees": float(np.degrees(2 * np.arccos(turn[firm])).max(initial=0)),
        "sh": float(np.abs(found.sh[:, 1:bands] - true.sh[:, 1:bands]).max(initial=0)),
        "degree": round(bands**0.5) - 1,
        "opacity": float(found.opacities.min()),
    }


def _after(quats: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) times one quaternion."""
    w, x, y, z = quats.T
    a, b, c, d = half
    return np.stack([w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
                     w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a], 1)  # fmt: skip


def timed(work: Callable[[], Any]) -> tuple[Any, float]:
    """The result of a call and its seconds of processor time, including programs that it starts."""
    start = sum(os.times()[:4])
    return work(), sum(os.times()[:4]) - start


def by_ours(path: Path) -> Gaussians:
    return load(path).gaussians


def by_gaussforge(path: Path) -> Gaussians:
    import gaussforge

    data = path.read_bytes()
    read = gaussforge.GaussForge().read(data, path.suffix[1:])["data"]
    n, bands = read["numPoints"], (read["meta"]["shDegree"] + 1) ** 2
    parts = {name: values for name, values in read.items() if isinstance(values, bytes)}
    column = {name: np.frombuffer(values, np.float32).reshape(n, -1) for name, values in parts.items()}
    sh = np.concatenate([column["colors"], column["sh"]], axis=1).reshape(n, bands, 3)
    with np.errstate(over="ignore"):
        opacities = 1 / (1 + np.exp(-column["alphas"][:, 0]))
    return Gaussians(
        column["positions"], np.exp(column["scales"]), column["rotations"], opacities.astype(np.float32), sh
    )


def by_pygltflib(path: Path) -> Gaussians:
    import pygltflib

    tree = pygltflib.GLTF2().load(str(path))
    names = vars(tree.meshes[0].primitives[0].attributes)

    def values(name: str) -> np.ndarray:
        view = tree.bufferViews[tree.accessors[names[name]].bufferView]
        blob = tree.binary_blob()
        return np.frombuffer(blob, np.float32, view.byteLength // 4, view.byteOffset).reshape(len(places), -1)

    places = range(tree.accessors[names["POSITION"]].count)
    own = "KHR_gaussian_splatting:"
    sh = np.stack([values(f"{own}SH_DEGREE_{d}_COEF_{k}") for d in range(3) for k in range(2 * d + 1)], axis=1)
    turns = values(f"{own}ROTATION")[:, [3, 0, 1, 2]]
    return Gaussians(values("POSITION"), values(f"{own}SCALE"), turns, values(f"{own}OPACITY")[:, 0], sh)


def by_usd(path: Path) -> Gaussians:
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))  # prims live only as long as their stage
    prim = stage.GetDefaultPrim()
    get = {a.GetName(): a.Get() for a in prim.GetAttributes() if a.HasAuthoredValue()}
    places = np.array(get["positions"])
    turns = np.array([(q.GetReal(), *q.GetImaginary()) for q in get["orientations"]], np.float32)
    sh = np.array(get["radiance:sphericalHarmonicsCoefficients"]).reshape(len(places), -1, 3)
    return Gaussians(places, np.array(get["scales"]), turns, np.array(get["opacities"]), sh)


def by_splat_transform(path: Path) -> Gaussians:
    out = path.with_name("others.ply")
    subprocess.run(["splat-transform", "-w", str(path), str(out)], check=True, capture_output=True)
    return load(out).gaussians


OUT: dict[str, tuple[tuple[str, Callable[[Path], Gaussians]], ...]] = {
    ".ply": (("gaussforge", by_gaussforge), ("splat-transform", by_splat_transform)),
    ".spz": (("gaussforge", by_gaussforge), ("splat-transform", by_splat_transform)),
    ".sog": (("gaussforge", by_gaussforge), ("splat-transform", by_splat_transform)),
    ".glb": (("pygltflib", by_pygltflib),),
    ".usdc": (("usd-core", by_usd),),
}
"""Readers by other people for each format we write."""

IN = {
    "gaussforge": ("splat", "ksplat", "spz", "sog", "compressed.ply"),
    "splat-transform": ("spz", "sog", "compressed.ply", "glb"),
}
"""Writers by other people, and the formats of theirs that we read."""


def written_by(who: str, form: str, ply: Path) -> Path:
    """Converts the .ply to another format with another program and returns the path."""
    out = ply.with_name(f"{who}.{form}")
    if who == "splat-transform":
        subprocess.run([who, "-w", str(ply), str(out)], check=True, capture_output=True)
        return out
    import gaussforge

    out.write_bytes(gaussforge.GaussForge().convert(ply.read_bytes(), "ply", form)["data"])
    return out


def measure(atoms: int) -> list[dict[str, Any]]:
    """A row for each format and reader."""
    true = solid(atoms)
    rows = []

    def add_row(row: dict[str, Any]) -> None:
        rows.append(row)
        words = (f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items())
        print("  ".join(words), flush=True)

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for suffix, readers in OUT.items():
            path = folder / f"a{suffix}"
            _, seconds = timed(partial(write_splats, path, true, Provenance(UP)))
            meant = moved(true, upright(UP)) if suffix in (".glb", ".usdc") else true
            row = {"format": suffix, "direction": "out", "bytes": path.stat().st_size, "seconds": seconds}
            if suffix != ".usdc":
                found, took = timed(partial(by_ours, path))
                add_row(row | {"reader": "ours", "read_seconds": took} | errors(meant, found))
            for who, read in readers:
                add_row(row | {"reader": who} | attempt(partial(read, path), meant))
        ply, few = folder / "a.ply", solid(QUICK_ATOMS)
        write_ply(ply, few)
        for who, forms in IN.items():
            for form in forms:
                row = {"format": f".{form}", "direction": "in", "writer": who}
                try:
                    path = written_by(who, form, ply)
                except (OSError, ImportError, KeyError, subprocess.SubprocessError) as error:
                    add_row(row | {"missing": type(error).__name__})
                    continue
                add_row(row | {"bytes": path.stat().st_size} | attempt(partial(by_ours, path), few))
    return rows


def attempt(read: Callable[[], Gaussians], meant: Gaussians) -> dict[str, Any]:
    """The seconds and errors of a reader, or why it is missing."""
    try:
        found, took = timed(read)
    except (OSError, ImportError, KeyError, subprocess.SubprocessError) as error:
        return {"missing": type(error).__name__}
    quats = found.quats / np.linalg.norm(found.quats, axis=1, keepdims=True)
    return {"read_seconds": took} | errors(meant, replace(found, quats=quats))


def main(arguments: list[str] | None = None) -> None:
    """Measures all formats and writes the figures."""
    parser = parser_of(__doc__ or "", "measure twenty thousand atoms")
    options = parser.parse_args(arguments)
    folder = out_folder(options)
    if shutil.which("splat-transform") is None:
        print("splat-transform is not on the PATH; its rows will be missing")
    atoms = QUICK_ATOMS if options.quick else ATOMS
    rows = measure(atoms)
    if folder is not None:
        write_json(folder / "formats.json", {"atoms_out": atoms, "atoms_in": QUICK_ATOMS, "rows": rows})


if __name__ == "__main__":
    main()
