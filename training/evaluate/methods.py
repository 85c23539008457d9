"""Ours, simpler methods, and ours without each of its parts: put together from the library's own functions.

All of them have one shell, one fill and one set of cuts. Three are compared with ours because the paper does so or
because they bound it from above; the others leave a part out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

from engine.fit.sh_fit import SurfaceView, surface_views
from engine.fit.view_weights import ViewWeights
from engine.io.files import read_file
from engine.io.trained import Meta, load_trained, save_trained
from engine.render.classic import rasterizer as classic
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera, on_plane
from engine.scene.grid import Body
from engine.scene.plane import Plane
from engine.solid.fill import Colours, fill
from sample_scenes.solids import Solid
from training.batch.task import RESULT_LIMIT
from training.checkpoint import Checkpoint
from training.evaluate.cuts import Cut
from training.evaluate.patch_denoiser import PatchDenoiser
from training.evaluate.scenes import Subject, Tuned
from training.events import Reporter
from training.families import Family
from training.labels import blank_label, make_prior
from training.optimise.trainer import Trainer
from training.pipeline import Pipeline, prepare, refit_surface
from training.priors.prior import Denoiser, Progress, Volume
from training.priors.sds import distill
from training.request import Geometry, Request
from training.results import surface_psnr
from training.views import BACKGROUND, ENTRIES, Extent, Section, Slice, make_condition, surface_cameras

__all__ = ["METHODS", "Made", "Method", "UnsmoothedTrainer"]

Float = NDArray[np.float32]

NOISE_STEP = 0.5
"""Step of the noise-prediction form in units of sigma^2: a full one lands on the denoised picture."""

WIDER = 4
"""Times the scale cap, where there is none to speak of: then the least atom is larger than a seed."""


@dataclass(frozen=True)
class Made:
    """What a method left."""

    atoms: Atoms
    path: Path
    facts: dict[str, Any]
    """Plain figures of its run."""
    show: Callable[[int, Cut], Float]
    """(H, W, 3). A cut face, over white; the number seeds whatever is random in it."""


@dataclass(frozen=True)
class Method:
    """One row of the tables."""

    title: str
    what: str
    """One sentence for the reader."""
    make: Callable[[Subject, Tuned, Path], Made]
    rival: bool = True
    """Whether it may be best; not the bounds."""


def trained(request: Tuned, out: Path, pipeline: type[Pipeline] = Pipeline) -> Made:
    """A run of the main job, some of its steps swapped."""
    path = pipeline(request, out, Reporter(), lambda: False).run(resume=True)
    atoms, _ = load_trained(path)
    report = json.loads(read_file(out / "report.json", RESULT_LIMIT))
    facts = {key: report[key] for key in ("surface_psnr_db", "iterations", "refinement_rounds", "ended")}
    turns = report["losses"]["section"][-3:]
    facts["section_loss"] = float(np.mean(turns)) if turns else None
    return Made(atoms, path, facts, faces(atoms))


def faces(atoms: Atoms) -> Callable[[int, Cut], Float]:
    """Cut faces as the product shows them."""
    field = KernelField(atoms)

    def show(_: int, cut: Cut) -> Float:
        return np.clip(render(atoms, cut.camera, [cut.plane], BACKGROUND, field=field).rgb, 0, 1)

    return show


def ours(subject: Subject, request: Tuned, out: Path) -> Made:
    """The main job."""
    return trained(request, out)


class WithoutRefinement(Pipeline):
    """Labels stay what they were."""

    refines = False


class Uniform(Pipeline):
    """Atoms as fine everywhere as ours are where the colours vary."""

    def fill_interior(self, geometry: Geometry, pitch: float, colours: Colours) -> InteriorAtoms:
        """One atom for every cell of the finest lattice, whatever the colours."""
        interior = fill(geometry.body, pitch, self.request.seed, geometry.skin)
        return replace(interior, rgb=colours(interior.means).astype(np.float32))


class UnsmoothedTrainer(Trainer):
    """What no view shows keeps the colours that it started with."""

    def smooth(self) -> None:
        """Nothing."""


class WithoutSmoothing(Pipeline):
    """No voxel smoothing."""

    def smooth_interior(self, interior: InteriorAtoms, rgb: Float, covered: NDArray[np.bool_]) -> Float:
        """Nothing."""
        return rgb

    def make_trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """One that does not smooth."""
        return UnsmoothedTrainer(atoms, faces, surfaces, self.request.seed)


class PlaneByPlane:
    """The same prior where it may look at one plane at a time only."""

    def __init__(self, prior: Denoiser) -> None:
        self.denoise = prior.denoise


def denoiser(request: Request) -> Denoiser:
    """The request's own prior, or the patches of its pictures, as one that draws plane by plane."""
    prior = PatchDenoiser() if request.prior == "exemplar" else make_prior(request)
    assert isinstance(prior, Denoiser), prior
    return prior


class Looped(Pipeline):
    """A label for each plane by itself, refined from what the atoms show: the paper's own loop."""

    def make_prior(self) -> Denoiser:
        """The request's own, plane by plane."""
        return denoiser(self.request)


class LoopedWithoutSmoothing(Looped, WithoutSmoothing):
    """The paper's loop without voxel smoothing."""


class Independent(Looped):
    """A label for each plane by itself, once."""

    refines = False


class IndependentByNoise(Independent):
    """A label for each plane by itself, down the gradient of the paper's eq. 5."""

    def draw_label(self, prior: Denoiser, cut: Slice, rng: np.random.Generator) -> Float:
        """In steps of half the length."""
        return distill(blank_label(cut.condition), prior, cut.condition, rng, step=NOISE_STEP)


@dataclass(frozen=True)
class TrueVolume(Volume):
    """A volume that knows more than its grid."""

    solid: Solid

    def at(self, points: NDArray[np.floating]) -> Float:
        """(..., 3). True colours at world points (..., 3)."""
        return self.solid.colour(points)

    at_cubic = at


@dataclass(frozen=True)
class Oracle:
    """A prior that knows the truth."""

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
        grid = body.resampled(float(np.ptp(body.bounds(), axis=0).max()) / voxels)
        return TrueVolume(grid, self.solid.colour(grid.centres()), self.solid)


def oracle(subject: Subject, request: Tuned, out: Path) -> Made:
    """True slices as labels."""

    class Told(Pipeline):
        def make_prior(self) -> Oracle:
            return Oracle(subject.solid)

    return trained(request, out, Told)


def without_clipping(subject: Subject, request: Tuned, out: Path) -> Made:
    """Everything alike on atoms with a cap so wide that nothing of the capture reaches it."""
    numbers = request.numbers
    wide = replace(numbers, cells=max(8, numbers.cells // WIDER), fine=max(8, numbers.fine // WIDER))
    return trained(replace(request, numbers=wide), out)


@dataclass(frozen=True)
class Composited(ViewWeights):
    """A cut face as 3DGS draws it: atoms behind the plane blended by depth, each with an opacity of its own."""

    rows: NDArray[np.intp]
    arrays: tuple[Tensor, Tensor, Tensor, Tensor]
    """Means, scales, quaternions and opacities of the rows."""
    camera: Camera

    def picture(self, coefficients: Tensor, rgb: Tensor, background: Sequence[float] | Tensor = BACKGROUND) -> Tensor:
        """(H, W, 3), differentiable in both."""
        skin = (0.5 + sh.C0 * coefficients[:, 0]).clamp(min=0)
        colours = torch.cat([skin, rgb])[torch.from_numpy(self.rows)]
        return classic.rasterize(*self.arrays, colours, self.camera, tuple(float(b) for b in background))[0]


SLAB = 8
"""Pitches behind the plane that are blended: what lies deeper lets less than a hundredth through."""


def composited(atoms: Atoms, section: ViewWeights, plane: Plane, camera: Camera) -> Composited:
    """The view of a plane where atoms have opacities drawn evenly from 0 to 1, neither high nor uniform."""
    s, i = atoms.surface, atoms.interior
    means = np.concatenate([s.means, i.means])
    opacities = np.random.default_rng(11).uniform(0, 1, len(means)).astype(np.float32)
    distance = plane.distance(means)
    rows = np.flatnonzero((distance <= 0) & (distance > -SLAB * atoms.pitch))
    scales = np.concatenate([s.scales, np.repeat(i.sigmas[:, None], 3, 1)])
    quats = np.concatenate([s.quats, np.tile(np.array([[1, 0, 0, 0]], np.float32), (len(i), 1))])
    arrays = tuple(torch.from_numpy(np.ascontiguousarray(a[rows])) for a in (means, scales, quats, opacities))
    known = {field.name: getattr(section, field.name) for field in fields(ViewWeights)}
    return Composited(**known, rows=rows, arrays=arrays, camera=camera)  # type: ignore[arg-type]


class Translucent(Trainer):
    """Trains on cut faces that 3DGS blends."""

    def __init__(self, *of: Any) -> None:
        super().__init__(*of)
        self.sections = [
            replace(cut, weights=composited(self.atoms, cut.weights, cut.plane, cut.camera)) for cut in self.sections
        ]


class WithoutOpacification(Pipeline):
    """Atoms that let light through in training."""

    def make_trainer(self, atoms: Atoms, faces: Sequence[Section], surfaces: Sequence[SurfaceView]) -> Trainer:
        """One whose cut faces 3DGS blends."""
        return Translucent(atoms, faces, surfaces, self.request.seed)


def without_opacification(subject: Subject, request: Tuned, out: Path) -> Made:
    """Atoms that let light through, in training and in the pictures."""
    made = trained(request, out, WithoutOpacification)
    field = KernelField(made.atoms)
    sh_, rgb = (torch.from_numpy(a) for a in (made.atoms.surface.sh, made.atoms.interior.rgb))

    def show(_: int, cut: Cut) -> Float:
        known = ViewWeights.section(made.atoms, cut.plane, cut.camera, field)
        view = composited(made.atoms, known, cut.plane, cut.camera)
        with torch.no_grad():
            return np.clip(view.picture(sh_, rgb).numpy(), 0, 1)

    return replace(made, show=show)


def hollow(request: Tuned, out: Path) -> tuple[Geometry, Atoms, dict[str, Any]]:
    """The filled solid with its skin fitted, before anybody paints the inside."""
    fineness = request.fineness
    geometry, _ = prepare(request, Reporter(), lambda: None)
    atoms = geometry.filled(fill(geometry.body, geometry.pitch, request.seed, geometry.skin))
    cameras = surface_cameras(geometry.body, geometry.up, fineness.surface_views, fineness.surface)
    views = surface_views(atoms, geometry.gaussians, cameras, ENTRIES)
    atoms, _ = refit_surface(atoms, views, Checkpoint(out / "checkpoint", request.fingerprint()), lambda _: None)
    return geometry, atoms, {"surface_psnr_db": surface_psnr(geometry, atoms), "iterations": 0, "refinement_rounds": 0}


def nearest_surface(geometry: Geometry, surface: SurfaceAtoms, request: Tuned) -> Atoms:
    """The PhysGaussian rule: every interior atom takes the colour of the nearest surface atom; filled as ours is."""
    rgb = np.clip(sh.sh_to_rgb(surface.sh[:, 0]), 0, 1).astype(np.float32)
    tree = cKDTree(surface.means)
    finest = geometry.pitch * request.numbers.cells / request.numbers.fine
    interior = fill(geometry.body, finest, request.seed, surface, lambda points: rgb[tree.query(points)[1]])
    return Atoms(surface, interior, geometry.pitch)


def saved(geometry: Geometry, atoms: Atoms, request: Tuned, out: Path) -> Path:
    """Written as the main job writes its result, so that files compare."""
    path = out / f"{request.scene.stem}.ply"
    x, y, z = (float(v) for v in geometry.up)
    save_trained(path, atoms, Meta((x, y, z), (), request.seed, "", request.scene.name))
    return path


def physgaussian(subject: Subject, request: Tuned, out: Path) -> Made:
    """The nearest surface colour."""
    geometry, bare, facts = hollow(request, out)
    atoms = nearest_surface(geometry, bare.surface, request)
    return Made(atoms, saved(geometry, atoms, request, out), facts, faces(atoms))


def inpainting(subject: Subject, request: Tuned, out: Path) -> Made:
    """Every cut drawn when it is made, by the prior, from nothing."""
    geometry, atoms, facts = hollow(request, out)
    prior = denoiser(request)
    size, extent = request.fineness.label, Extent.of(geometry.body, geometry.up)

    def show(number: int, cut: Cut) -> Float:
        family = nearest_family(cut.plane, request.families, geometry)
        small = cut.camera.resized(size, size)
        condition = make_condition(family, geometry.body, extent, small, on_plane(small, cut.plane))
        label = distill(blank_label(condition), prior, condition, np.random.default_rng([request.seed, number]))
        zoom = cut.camera.width / size
        return np.clip(ndimage.zoom(label, (zoom, zoom, 1), order=1, mode="nearest", grid_mode=True), 0, 1)

    return Made(atoms, saved(geometry, atoms, request, out), facts, show)


def nearest_family(plane: Plane, families: Sequence[Family], geometry: Geometry) -> Family:
    """The family to whose planes a plane is the most nearly parallel."""
    normal = np.asarray(plane.normal)

    def likeness(family: Family) -> float:
        if family.kind == "radial":
            return float(np.linalg.norm(np.cross(normal, geometry.up)))
        return abs(float(normal @ family.normal(geometry.body, geometry.up)))

    return max(families, key=likeness)


def swapped(pipeline: type[Pipeline]) -> Callable[[Subject, Tuned, Path], Made]:
    """A method that is the main job with some of its steps swapped."""
    return lambda subject, request, out: trained(request, out, pipeline)


METHODS: dict[str, Method] = {
    "ours": Method("Ours", "The product, as fruitninja-train runs it.", ours),
    "physgaussian": Method("PhysGaussian", "Every interior atom takes the nearest surface colour.", physgaussian),
    "inpainting": Method("2D inpainting", "The prior draws each cut by itself when it is made.", inpainting),
    "independent": Method("Independent labels", "A label per plane, no volume, no loop.", swapped(Independent)),
    "independent_sds": Method(
        "Independent, SDS", "A label per plane by the paper's eq. 5.", swapped(IndependentByNoise)
    ),
    "looped": Method(
        "Labels in a loop", "A label per plane, refined from the render: the paper's loop.", swapped(Looped)
    ),
    "no_clipping": Method("No atomic clipping", f"A scale cap {WIDER} times wider.", without_clipping),
    "no_opacity": Method("No opacification", "Opacities drawn evenly from 0 to 1.", without_opacification),
    "no_smoothing": Method("No smoothing", "Atoms that no view shows keep their start.", swapped(WithoutSmoothing)),
    "looped_no_smoothing": Method("Loop, no smoothing", "The loop without smoothing.", swapped(LoopedWithoutSmoothing)),
    "no_refinement": Method("No refinement", "Labels stay what they were.", swapped(WithoutRefinement)),
    "uniform": Method("Uniform fill", "The finest atoms everywhere.", swapped(Uniform), rival=False),
    "oracle": Method("Oracle labels", "True slices as labels: the 3-D part alone.", oracle, rival=False),
}
