"""OpenUSD with the schema `ParticleField3DGaussianSplat`, by way of usd-core, which is an optional extra."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from engine.errors import InputError
from engine.io.files import atomic
from engine.io.writers.provenance import Provenance
from engine.scene.gaussians import Gaussians
from engine.scene.moved import moved, upright

__all__ = ["write_stage", "write_usd"]

MISSING = "USD needs usd-core 26.3 or newer; install it with: pip install 'fruitninja[usd]'"
"""Error without usd-core, with the first version that knows the schema."""


def write_usd(path: Path, gaussians: Gaussians, about: Provenance) -> None:
    """Writes a stage with one field of Gaussians, as text (.usda) or binary (.usdc), upright: y is up and a unit is a
    metre, as in glTF.

    Raises InputError without usd-core, and if writing fails.
    """
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt
    except ImportError as error:
        raise InputError(f"{path}: {MISSING}") from error
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        raise InputError(f"{path}: {MISSING}")
    g = moved(gaussians, upright(about.up))
    # An anonymous layer: the temporary file's name leaves no trace in it.
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    field = UsdVol.ParticleField3DGaussianSplat.Define(stage, "/Solid")
    stage.SetDefaultPrim(field.GetPrim())
    stage.GetRootLayer().documentation = "\n".join(["FruitNinja", *about.lines])
    prim = field.GetPrim()
    xyzw = np.ascontiguousarray(g.quats[:, [1, 2, 3, 0]])  # Gf keeps the real part last
    for name, kind, values in (
        ("positions", Sdf.ValueTypeNames.Point3fArray, Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(g.means))),
        ("orientations", Sdf.ValueTypeNames.QuatfArray, Vt.QuatfArray.FromNumpy(xyzw)),
        ("scales", Sdf.ValueTypeNames.Float3Array, Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(g.scales))),
        ("opacities", Sdf.ValueTypeNames.FloatArray, Vt.FloatArray.FromNumpy(g.opacities)),
        ("radiance:sphericalHarmonicsDegree", Sdf.ValueTypeNames.Int, g.sh_degree),
        (
            "radiance:sphericalHarmonicsCoefficients",
            Sdf.ValueTypeNames.Float3Array,
            Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(g.sh.reshape(-1, 3))),
        ),
        ("sortingModeHint", Sdf.ValueTypeNames.Token, "cameraDistance"),
    ):
        attribute = prim.GetAttribute(name) or prim.CreateAttribute(name, kind)
        attribute.Set(values)
    reach = 3 * g.scales.max(1, keepdims=True)  # the schema's support
    corners = (g.means - reach).min(0), (g.means + reach).max(0)
    UsdGeom.Boundable(prim).CreateExtentAttr([Gf.Vec3f(*map(float, corner)) for corner in corners])
    write_stage(path, stage)


def write_stage(path: Path, stage: Any) -> None:
    """Writes a stage of usd-core. Raises InputError if that fails."""
    with atomic(path) as temporary:
        try:
            written = stage.GetRootLayer().Export(str(temporary))
        except RuntimeError as error:
            raise OSError(" ".join(str(error).split())) from error
        if not written:
            raise OSError("usd-core did not write it")
