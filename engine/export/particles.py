"""Particles for simulation: places, volumes, masses, kinds and colours."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.errors import InputError
from engine.export.voxels import Voxels
from engine.io.files import atomic
from engine.io.writers.usd import write_stage
from engine.light import as_linear
from engine.scene.inside import KIND_NAMES
from engine.scene.moved import upright

__all__ = ["PARTICLES", "Particles", "particles_of", "save_particles"]

PARTICLES = (".npz", ".usda", ".usdc")
"""Suffixes of the formats."""

DENSITY = 1000.0
"""kg/m^3. That of water; food, green wood and flesh are within a tenth of it. Whoever knows better multiplies."""

LEAST = 0.05
"""Least filled share of a cell with a particle: what is left out is 0.1 % of a ball twenty particles across."""


@dataclass(frozen=True)
class Particles:
    """Particles, one for each cell of a grid that the body fills at least in part."""

    points: NDArray[np.float64]
    """(N, 3). World units, the middle of the filled part of the cell."""
    volumes: NDArray[np.float64]
    """(N,). World units cubed; they add up to that of the body."""
    kind: NDArray[np.uint8]
    """(N,). `Kind`."""
    rgb: NDArray[np.uint8]
    """(N, 3)."""
    spacing: float
    """World units between neighbours."""


def particles_of(voxels: Voxels) -> Particles:
    """The particles of voxels.

    A cell that the skin or a cut crosses has a particle with the volume of its filled part, moved inwards to the middle
    of that part: by half of what is missing, across the border.
    """
    cell, share = voxels.grid.cell, voxels.share
    cells = np.argwhere(share >= LEAST)
    at = tuple(cells.T)
    full = share[at].astype(np.float64)
    slope = np.stack([np.gradient(share, axis=axis)[at] for axis in range(3)], axis=1).astype(np.float64)
    length = np.linalg.norm(slope, axis=1, keepdims=True)
    inwards = np.divide(slope, length, out=np.zeros_like(slope), where=length > 0)
    points = voxels.grid.origin + (cells + 0.5 + inwards * (1 - full[:, None]) / 2) * cell
    volumes = full * (share.sum(dtype=np.float64) / full.sum()) * cell**3
    # The centre of such a cell may lie outside; its kind is then that of its nearest neighbour inside.
    kind = voxels.kind[at]
    outside = np.flatnonzero(kind == 0)
    moved = np.clip(np.round(cells[outside] + inwards[outside]).astype(int), 0, np.array(share.shape) - 1)
    kind[outside] = np.maximum(voxels.kind[tuple(moved.T)], 1)
    return Particles(points, volumes, kind, voxels.rgb[at], cell)


def save_particles(path: Path, particles: Particles, up: Sequence[float], metres: float) -> None:
    """Writes particles by the path's suffix, in metres and kilograms with y up; `up` (3,) is the object's up axis and
    `metres` the length of a world unit. Raises InputError for any other suffix and if writing fails."""
    suffix = path.suffix.lower()
    if suffix not in PARTICLES:
        raise InputError(f"{path}: particles are written as {', '.join(PARTICLES)}; give a name that ends so")
    arrays: dict[str, NDArray[Any]] = {
        "positions": (particles.points @ (metres * upright(up)).T).astype(np.float32),
        "volumes": (particles.volumes * metres**3).astype(np.float32),
        "masses": (particles.volumes * metres**3 * DENSITY).astype(np.float32),
        "labels": particles.kind,
        "colors": particles.rgb,
    }
    if suffix != ".npz":
        _save_usd(path, arrays, particles.spacing * metres)
        return
    out = io.BytesIO()
    arrays |= {"spacing": np.array(particles.spacing * metres), "label_names": np.array(KIND_NAMES)}
    np.savez_compressed(out, allow_pickle=False, **arrays)
    with atomic(path) as temporary:
        temporary.write_bytes(out.getvalue())


def _save_usd(path: Path, arrays: dict[str, NDArray[Any]], spacing: float) -> None:
    try:
        from pxr import Sdf, Usd, UsdGeom, Vt
    except ImportError as error:
        raise InputError(f"{path}: USD needs usd-core; install it with: pip install 'fruitninja[usd]'") from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    cloud = UsdGeom.Points.Define(stage, "/Particles")
    stage.SetDefaultPrim(cloud.GetPrim())
    cloud.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(arrays["positions"]))
    cloud.CreateWidthsAttr(Vt.FloatArray([spacing]))
    cloud.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    cloud.CreateExtentAttr(UsdGeom.Points.ComputeExtent(cloud.GetPointsAttr().Get(), cloud.GetWidthsAttr().Get()))
    colour = cloud.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
    colour.Set(Vt.Vec3fArray.FromNumpy(as_linear(arrays["colors"] / 255).astype(np.float32)))
    primvars = UsdGeom.PrimvarsAPI(cloud)
    floats, ints = Sdf.ValueTypeNames.FloatArray, Sdf.ValueTypeNames.IntArray
    for name in ("volumes", "masses"):
        primvars.CreatePrimvar(name, floats, UsdGeom.Tokens.vertex).Set(Vt.FloatArray.FromNumpy(arrays[name]))
    labels = Vt.IntArray.FromNumpy(arrays["labels"].astype(np.int32))
    primvars.CreatePrimvar("labels", ints, UsdGeom.Tokens.vertex).Set(labels)
    names = ", ".join(f"{n} {k}" for n, k in enumerate(KIND_NAMES))
    stage.GetRootLayer().documentation = f"FruitNinja; labels: {names}"
    write_stage(path, stage)
