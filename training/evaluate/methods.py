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

from engine import classic, sh
from engine.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.body import Body
from engine.camera import Camera, on_plane
from engine.fill import fill
from engine.kernel_field import KernelField
from engine.opaque import render
from engine.plane import Plane
from engine.surface_fit import surface_views
from engine.trained import Meta, load_trained, save_trained
from engine.view_weights import ViewWeights
from sample_scenes.solids import Solid
from training.checkpoint import Checkpoint
from training.evaluate.cuts import Cut
from training.evaluate.scenes import Subject, Tuned
from training.events import Reporter
from training.families import Family
from training.labels import make_prior
from training.outcome import surface_psnr
from training.prior import Condition, Denoises, Progress, Volume
from training.request import Geometry, Request
from training.run import Parts, prepare, refitted, run
from training.sds import distill
from training.trainer import Trainer
from training.views import BACKGROUND, ENTRIES, Extent, conditioned, surface_cameras

__all__ = ["METHODS", "Made", "Method", "unsmoothed"]

Float = NDArray[np.float32]

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


def trained(subject: Subject, request: Tuned, out: Path, parts: Parts) -> Made:
    """A run of the main job with some of its parts swapped."""
    path = run(request, out, Reporter(), True, lambda: False, parts)
    atoms, _ = load_trained(path)
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
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
    return trained(subject, request, out, Parts())


def without_refinement(subject: Subject, request: Tuned, out: Path) -> Made:
    """Labels stay what they were."""
    return trained(subject, request, out, Parts(refines=False))


def evenly(
    body: Body, pitch: float, seed: int, surface: SurfaceAtoms, colours: Callable[[NDArray[np.floating]], Float]
) -> InteriorAtoms:
    """One atom for every cell of the finest lattice, whatever the colours."""
    interior = fill(body, pitch, seed, surface)
    return replace(interior, rgb=colours(interior.means).astype(np.float32))


def uniform(subject: Subject, request: Tuned, out: Path) -> Made:
    """Atoms as fine everywhere as ours are where the colours vary."""
    return trained(subject, request, out, Parts(fill=evenly))


def unsmoothed(means: Float, initial: Float, current: Float, trained: NDArray[np.bool_]) -> Float:
    """What no view shows keeps the colours that it started with."""
    return current


def without_smoothing(subject: Subject, request: Tuned, out: Path) -> Made:
    """No voxel smoothing."""
    return trained(subject, request, out, Parts(smoothing=unsmoothed))


class PlaneByPlane:
    """The same prior where it may look at one plane at a time only."""

    def __init__(self, prior: Denoises) -> None:
        self.prior = prior

    def denoise(self, noisy: Float, sigma: float, condition: Condition, rng: np.random.Generator) -> Float:
        """As the prior."""
        return self.prior.denoise(noisy, sigma, condition, rng)


def plane_by_plane(request: Request) -> PlaneByPlane:
    """The request's own prior, plane by plane."""
    prior = make_prior(request)
    assert isinstance(prior, Denoises), prior
    return PlaneByPlane(prior)


def independent(subject: Subject, request: Tuned, out: Path) -> Made:
    """A label for each plane by itself, once."""
    return trained(subject, request, out, Parts(plane_by_plane, refines=False))


def independent_by_noise(subject: Subject, request: Tuned, out: Path) -> Made:
    """A label for each plane by itself, down the gradient of the paper's eq. 5."""
    return trained(subject, request, out, Parts(plane_by_plane, refines=False, form="noise"))


def looped(subject: Subject, request: Tuned, out: Path) -> Made:
    """A label for each plane by itself, refined from what the atoms show: the paper's own loop."""
    return trained(subject, request, out, Parts(plane_by_plane))


def looped_without_smoothing(subject: Subject, request: Tuned, out: Path) -> Made:
    """The paper's loop without voxel smoothing."""
    return trained(subject, request, out, Parts(plane_by_plane, smoothing=unsmoothed))


@dataclass(frozen=True)
class TrueVolume(Volume):
    """A volume that knows more than its grid."""

    solid: Solid

    def at(self, points: NDArray[np.floating]) -> Float:
        """(..., 3). True colours at world points (..., 3)."""
        return self.solid.colour(points)

    crisp = at


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
    return trained(subject, request, out, Parts(lambda _: Oracle(subject.solid)))


def without_clipping(subject: Subject, request: Tuned, out: Path) -> Made:
    """Everything alike on atoms with a cap so wide that nothing of the capture reaches it."""
    numbers = request.numbers
    wide = replace(numbers, cells=max(8, numbers.cells // WIDER), fine=max(8, numbers.fine // WIDER))
    return trained(subject, replace(request, numbers=wide), out, Parts())


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


def without_opacification(subject: Subject, request: Tuned, out: Path) -> Made:
    """Atoms that let light through, in training and in the pictures."""
    made = trained(subject, request, out, Parts(trainer=Translucent))
    field = KernelField(made.atoms)
    sh_, rgb = (torch.from_numpy(a) for a in (made.atoms.surface.sh, made.atoms.interior.rgb))

    def show(_: int, cut: Cut) -> Float:
        known = ViewWeights.section(made.atoms, cut.plane, cut.camera, field)
        view = composited(made.atoms, known, cut.plane, cut.camera)
        with torch.no_grad():
            return np.clip(view.picture(sh_, rgb).numpy(), 0, 1)

    return replace(made, show=show)


def hollow(request: Tuned, out: Path) -> tuple[Geometry, dict[str, Any]]:
    """The filled solid with its skin fitted, before anybody paints the inside."""
    reporter, fineness = Reporter(), request.fineness
    geometry, _ = prepare(request, reporter, lambda: None)
    cameras = surface_cameras(geometry.body, geometry.up, fineness.surface_views, fineness.surface)
    views = surface_views(geometry.atoms, geometry.gaussians, cameras, ENTRIES)
    atoms, _ = refitted(geometry.atoms, views, Checkpoint(out / "checkpoint", request.fingerprint()), lambda _: None)
    geometry = replace(geometry, atoms=atoms)
    facts = {"surface_psnr_db": surface_psnr(geometry, atoms)[1], "iterations": 0, "refinement_rounds": 0}
    return geometry, facts


def nearest_surface(geometry: Geometry, request: Tuned) -> Atoms:
    """The PhysGaussian rule: every interior atom takes the colour of the nearest surface atom; filled as ours is."""
    surface = geometry.atoms.surface
    rgb = np.clip(sh.sh_to_rgb(surface.sh[:, 0]), 0, 1).astype(np.float32)
    tree = cKDTree(surface.means)
    finest = geometry.atoms.pitch * request.numbers.cells / request.numbers.fine
    interior = fill(geometry.body, finest, request.seed, surface, lambda points: rgb[tree.query(points)[1]])
    return replace(geometry.atoms, interior=interior)


def saved(geometry: Geometry, atoms: Atoms, request: Tuned, out: Path) -> Path:
    """Written as the main job writes its result, so that files compare."""
    path = out / f"{request.scene.stem}.ply"
    x, y, z = (float(v) for v in geometry.up)
    save_trained(path, atoms, Meta((x, y, z), (), request.seed, "", request.scene.name))
    return path


def physgaussian(subject: Subject, request: Tuned, out: Path) -> Made:
    """The nearest surface colour."""
    geometry, facts = hollow(request, out)
    atoms = nearest_surface(geometry, request)
    return Made(atoms, saved(geometry, atoms, request, out), facts, faces(atoms))


def inpainting(subject: Subject, request: Tuned, out: Path) -> Made:
    """Every cut drawn when it is made, by the prior, from nothing."""
    geometry, facts = hollow(request, out)
    prior = make_prior(request)
    assert isinstance(prior, Denoises), prior
    size, extent = request.fineness.label, Extent.of(geometry.body, geometry.up)

    def show(number: int, cut: Cut) -> Float:
        family = nearest_family(cut.plane, request.families, geometry)
        small = cut.camera.resized(size, size)
        condition = conditioned(family, geometry.body, extent, small, on_plane(small, cut.plane))
        start = np.where(condition.inside[..., None], condition.render, np.float32(1))
        label = distill(start, prior, condition, np.random.default_rng([request.seed, number]))
        zoom = cut.camera.width / size
        return np.clip(ndimage.zoom(label, (zoom, zoom, 1), order=1, mode="nearest", grid_mode=True), 0, 1)

    return Made(geometry.atoms, saved(geometry, geometry.atoms, request, out), facts, show)


def nearest_family(plane: Plane, families: Sequence[Family], geometry: Geometry) -> Family:
    """The family to whose planes a plane is the most nearly parallel."""
    normal = np.asarray(plane.normal)

    def likeness(family: Family) -> float:
        if family.kind == "radial":
            return float(np.linalg.norm(np.cross(normal, geometry.up)))
        return abs(float(normal @ family.normal(geometry.body, geometry.up)))

    return max(families, key=likeness)


METHODS: dict[str, Method] = {
    "ours": Method("Ours", "The product, as fruitninja-train runs it.", ours),
    "physgaussian": Method("PhysGaussian", "Every interior atom takes the nearest surface colour.", physgaussian),
    "inpainting": Method("2D inpainting", "The prior draws each cut by itself when it is made.", inpainting),
    "independent": Method("Independent labels", "A label per plane, no volume, no loop.", independent),
    "independent_sds": Method("Independent, SDS", "A label per plane by the paper's eq. 5.", independent_by_noise),
    "looped": Method("Labels in a loop", "A label per plane, refined from the render: the paper's loop.", looped),
    "no_clipping": Method("No atomic clipping", f"A scale cap {WIDER} times wider.", without_clipping),
    "no_opacity": Method("No opacification", "Opacities drawn evenly from 0 to 1.", without_opacification),
    "no_smoothing": Method("No smoothing", "Atoms that no view shows keep their start.", without_smoothing),
    "looped_no_smoothing": Method("Loop, no smoothing", "The loop without smoothing.", looped_without_smoothing),
    "no_refinement": Method("No refinement", "Labels stay what they were.", without_refinement),
    "uniform": Method("Uniform fill", "The finest atoms everywhere.", uniform, rival=False),
    "oracle": Method("Oracle labels", "True slices as labels: the 3-D part alone.", oracle, rival=False),
}
