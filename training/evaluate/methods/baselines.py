"""Methods that share only the shell, the fill and the cuts with ours: two simpler ones, and the oracle as a bound."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from engine.io.trained import Meta, save_trained
from engine.scene import sh
from engine.scene.atoms import Atoms, SurfaceAtoms
from engine.scene.camera import plane_points
from engine.scene.grid import Body
from engine.scene.plane import Plane
from engine.solid.fill import fill
from sample_scenes.solids import Solid
from training.evaluate.cuts import Cut
from training.evaluate.methods.ablations import make_denoiser
from training.evaluate.methods.method import MethodResult, cut_renderer, run_pipeline
from training.evaluate.scenes import CustomRequest, EvaluationScene
from training.events import Reporter
from training.families import Family
from training.labels import blank_label
from training.pipeline import Pipeline, prepare
from training.priors.prior import Progress, Volume
from training.priors.sds import distill
from training.request import Geometry
from training.results import surface_psnr
from training.skin import match_skin
from training.views import Extent, make_condition

__all__ = ["inpainting", "oracle", "physgaussian"]

Float = NDArray[np.float32]


def prepare_unpainted(request: CustomRequest, out: Path) -> tuple[Geometry, Atoms, dict[str, Any]]:
    """The filled solid with a fitted skin but an untrained interior."""
    geometry, _ = prepare(request, Reporter(), lambda: None)
    atoms = geometry.filled(fill(geometry.body, geometry.pitch, request.seed))
    atoms = match_skin(atoms, geometry.gaussians, geometry.enclosed, geometry.up, request.fineness, request.seed)
    return geometry, atoms, {"surface_psnr_db": surface_psnr(geometry, atoms), "iterations": 0, "refinement_rounds": 0}


def nearest_surface(geometry: Geometry, surface: SurfaceAtoms, request: CustomRequest) -> Atoms:
    """The PhysGaussian rule: every interior atom takes the colour of the nearest surface atom; the fill is ours."""
    rgb = np.clip(sh.sh_to_rgb(surface.sh[:, 0]), 0, 1).astype(np.float32)
    tree = cKDTree(surface.means)
    finest = geometry.pitch * request.numbers.cells / request.numbers.fine
    interior = fill(geometry.body, finest, request.seed, lambda points: rgb[tree.query(points)[1]])
    return Atoms(surface, interior, geometry.pitch)


def save_atoms(geometry: Geometry, atoms: Atoms, request: CustomRequest, out: Path) -> Path:
    """Writes the atoms in the format of a training result, so that file sizes compare."""
    path = out / f"{request.scene.stem}.ply"
    x, y, z = (float(v) for v in geometry.up)
    save_trained(path, atoms, Meta((x, y, z), (), request.seed, "", request.scene.name))
    return path


def physgaussian(scene: EvaluationScene, request: CustomRequest, out: Path) -> MethodResult:
    """Every interior atom takes the nearest surface colour."""
    geometry, bare, facts = prepare_unpainted(request, out)
    atoms = nearest_surface(geometry, bare.surface, request)
    return MethodResult(atoms, save_atoms(geometry, atoms, request, out), facts, cut_renderer(atoms))


def inpainting(scene: EvaluationScene, request: CustomRequest, out: Path) -> MethodResult:
    """The prior draws every cut independently when it is shown."""
    geometry, atoms, facts = prepare_unpainted(request, out)
    prior = make_denoiser(request)
    size, extent = request.fineness.label, Extent.of(geometry.body, geometry.up)

    def show(number: int, cut: Cut) -> Float:
        family = nearest_family(cut.plane, request.families, geometry)
        small = cut.camera.resized(size, size)
        condition = make_condition(family, geometry.body, extent, small, plane_points(small, cut.plane))
        label = distill(blank_label(condition), prior, condition, np.random.default_rng([request.seed, number]))
        zoom = cut.camera.width / size
        return np.clip(ndimage.zoom(label, (zoom, zoom, 1), order=1, mode="nearest", grid_mode=True), 0, 1)

    return MethodResult(atoms, save_atoms(geometry, atoms, request, out), facts, show)


def nearest_family(plane: Plane, families: Sequence[Family], geometry: Geometry) -> Family:
    """The family whose planes are closest to parallel to a plane."""
    normal = np.asarray(plane.normal)

    def likeness(family: Family) -> float:
        if family.kind == "radial":
            return float(np.linalg.norm(np.cross(normal, geometry.up)))
        return abs(float(normal @ family.normal(geometry.body, geometry.up)))

    return max(families, key=likeness)


@dataclass(frozen=True)
class TrueVolume(Volume):
    """A volume that samples the true solid instead of its grid."""

    solid: Solid

    def at(self, points: NDArray[np.floating]) -> Float:
        """(..., 3). True colours at world points (..., 3)."""
        return self.solid.colour(points)

    at_cubic = at


@dataclass(frozen=True)
class Oracle:
    """A prior that returns the true volume."""

    solid: Solid

    def solve(
        self,
        body: Body,
        up: NDArray[np.float64],
        families: Sequence[Family],
        voxels: int,
        seed: int,
        progress: Progress,
    ) -> Volume:
        """The truth."""
        fine = body.resampled(float(np.ptp(body.bounds(), axis=0).max()) / voxels)
        return TrueVolume(fine, self.solid.colour(fine.grid.centres()), self.solid)


def oracle(scene: EvaluationScene, request: CustomRequest, out: Path) -> MethodResult:
    """True slices as labels."""

    class OraclePipeline(Pipeline):
        def make_prior(self) -> Oracle:
            return Oracle(scene.solid)

    return run_pipeline(request, out, OraclePipeline)
