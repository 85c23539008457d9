"""Small solids of atoms for tests, scenes of several bodies, and an inside of waves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from engine.io.load import load
from engine.scene import sh
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body, Grid
from engine.scene.inside import InsideRecord, Kind
from engine.scene.rotations import facing
from engine.solid.fill import fill
from tests.paths import SAMPLES

NO_SURFACE = SurfaceAtoms(*(np.zeros((0, *shape), np.float32) for shape in ((3,), (3,), (4,), (1, 3))))


def unturned(count: int) -> NDArray[np.float32]:
    """(count, 4). Identity quaternions."""
    return np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))


def round_gaussians(
    means: NDArray[np.floating], scale: float = 0.02, opacity: float = 1.0, bands: int = 1
) -> Gaussians:
    """Grey balls of one size at means (N, 3), with `bands` SH coefficients."""
    n = len(means)
    scales, opacities = np.full((n, 3), scale, np.float32), np.full(n, opacity, np.float32)
    return Gaussians(means.astype(np.float32), scales, unturned(n), opacities, np.zeros((n, bands, 3), np.float32))


def joined(*parts: Gaussians) -> Gaussians:
    """All parts in one scene."""
    names = ("means", "scales", "quats", "opacities", "sh")
    return Gaussians(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def flat_gaussians(points: NDArray[np.float64], normals: NDArray[np.float64], size: float) -> Gaussians:
    """Flat Gaussians: sigma is `size` along the skin and a fifth of it across."""
    n = len(points)
    return Gaussians(
        points.astype(np.float32),
        np.tile(np.array([size, size, size / 5], np.float32), (n, 1)),
        facing(normals).astype(np.float32),
        np.full(n, 0.99, np.float32),
        np.zeros((n, 1, 3), np.float32),
    )


def sphere(
    n: int = 12000, radius: float = 1.0, hole: float = 0.0, towards: tuple[float, float, float] = (0, 0, -1)
) -> Gaussians:
    """A sphere's skin without the cap of half angle `hole` degrees."""
    z = np.linspace(-1, 1, n)
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    normals = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    normals = normals[normals @ (np.array(towards) / np.linalg.norm(towards)) <= np.cos(np.radians(hole)) + 1e-9]
    return flat_gaussians(radius * normals, normals, radius * (4 * np.pi / n) ** 0.5)


Rows = NDArray[np.bool_] | NDArray[np.integer] | slice


def rows_of(atoms: Atoms, surface: Rows = slice(None), interior: Rows = slice(None)) -> Atoms:
    """The atoms in these rows."""
    s, i = atoms.surface, atoms.interior
    return Atoms(
        SurfaceAtoms(s.means[surface], s.scales[surface], s.quats[surface], s.sh[surface]),
        InteriorAtoms(i.means[interior], i.sigmas[interior], i.rgb[interior]),
        atoms.pitch,
    )


def ball(pitch: float, seed: int = 0, degree: int = 1, radius: float = 0.5) -> Atoms:
    """A skin of flat striped discs on a sphere, around a jittered lattice with a rind, red flesh and dark seeds."""
    rng = np.random.default_rng(seed)
    count = int(4 * np.pi * radius**2 / (0.6 * pitch) ** 2)
    rank = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * rank / count), np.pi * (1 + 5**0.5) * rank
    normal = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)
    quats = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], 0 * turn], 1)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    stripe = np.sin(10 * np.arctan2(normal[:, 1], normal[:, 0]) + 2 * np.sin(5 * normal[:, 2])) > 0
    coefficients = 0.1 * rng.normal(size=(count, (degree + 1) ** 2, 3))
    coefficients[:, 0] = sh.rgb_to_sh(np.where(stripe[:, None], [0.2, 0.6, 0.2], [0.05, 0.3, 0.1]))
    scales = np.tile(np.array([0.6, 0.6, 0.12]) * pitch, (count, 1))
    skin = SurfaceAtoms(*(a.astype(np.float32) for a in (radius * normal, scales, quats, coefficients)))

    side = np.arange(-int(radius / pitch) - 1, int(radius / pitch) + 2) * pitch
    points = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    points = points + rng.uniform(-0.25, 0.25, points.shape) * pitch
    points = points[np.linalg.norm(points, axis=1) < radius - 0.25 * pitch]
    depth = 1 - np.linalg.norm(points, axis=1, keepdims=True) / radius
    rgb = np.where(depth > 0.14, [0.85, 0.15, 0.2], np.where(depth > 0.08, [0.9, 0.95, 0.75], [0.6, 0.85, 0.4]))
    seeds = rng.normal(size=(60, 3))
    seeds *= rng.uniform(0.4, 0.76, (60, 1)) * radius / np.linalg.norm(seeds, axis=1, keepdims=True)
    for seed_point in seeds:
        rgb[np.linalg.norm(points - seed_point, axis=1) < 0.04 * radius] = [0.08, 0.05, 0.03]
    means, sigmas, rgb = (a.astype(np.float32) for a in (points, np.full(len(points), pitch / 2), rgb))
    return Atoms(skin, InteriorAtoms(means, sigmas, rgb), pitch)


def filled_ball(pitch: float, radius: float = 0.5) -> Atoms:
    """A `ball` filled as training fills a body, all grey inside."""
    grid = Grid.around(np.array([[-radius] * 3, [radius] * 3]), pitch / 2, 4)
    depth = radius - np.linalg.norm(grid.centres(), axis=-1)
    atoms = ball(pitch, radius=radius)
    return replace(atoms, interior=fill(Body(grid, depth.astype(np.float32)), pitch))


def with_leaf(
    atoms: Atoms, centre: tuple[float, float, float] = (0.8, 0.46, 0.65), radius: float = 0.2, spacing: float = 0.6
) -> Atoms:
    """The atoms and, in front, a flat red leaf that faces the origin, of discs `spacing` pitches apart."""
    normal = np.array(centre) / np.linalg.norm(centre)
    across = np.cross(normal, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    steps = np.arange(-int(radius / (spacing * atoms.pitch)), int(radius / (spacing * atoms.pitch)) + 1)
    a, b = (spacing * atoms.pitch * grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps))
    means = (centre + a * across + b * np.cross(normal, across))[np.hypot(a, b)[:, 0] <= radius]
    skin = atoms.surface
    coefficients = np.zeros((len(means), *skin.sh.shape[1:]))
    coefficients[:, 0] = sh.rgb_to_sh(np.array([0.8, 0.1, 0.1]))
    turn = np.array([1 + normal[2], -normal[1], normal[0], 0.0])
    leaf = (
        means,
        np.tile(np.array([0.6, 0.6, 0.12]) * atoms.pitch, (len(means), 1)),
        np.tile(turn / np.linalg.norm(turn), (len(means), 1)),
        coefficients,
    )
    both = zip((skin.means, skin.scales, skin.quats, skin.sh), leaf, strict=True)
    return replace(atoms, surface=SurfaceAtoms(*(np.concatenate(pair).astype(np.float32) for pair in both)))


def scatter(surface: int, interior: int, seed: int = 0, degree: int = 2) -> Atoms:
    """A few soft ellipsoids and spheres of all sizes, scattered in the unit cube around the origin."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(surface, 4))
    skin = SurfaceAtoms(
        *(
            a.astype(np.float32)
            for a in (
                rng.uniform(-0.4, 0.4, (surface, 3)),
                np.exp(rng.uniform(-4.5, -2.0, (surface, 3))),
                quats / np.linalg.norm(quats, axis=1, keepdims=True),
                0.4 * rng.normal(size=(surface, (degree + 1) ** 2, 3)),
            )
        )
    )
    inside = InteriorAtoms(
        rng.uniform(-0.4, 0.4, (interior, 3)).astype(np.float32),
        np.exp(rng.uniform(-3.5, -2.0, interior)).astype(np.float32),
        rng.uniform(0, 1, (interior, 3)).astype(np.float32),
    )
    return Atoms(skin, inside, 0.1)


def beside(*scenes: Gaussians, places: Sequence[Sequence[float]], size: float = 1.0) -> Gaussians:
    """The scenes in one, each scaled to a longest side of `size` around its place (3,); with as many SH coefficients as
    the scene that has the fewest."""
    bands = min(scene.sh.shape[1] for scene in scenes)
    columns = []
    for scene, place in zip(scenes, places, strict=True):
        low, high = scene.visible_bounds()
        factor = np.float32(size / (high - low).max())
        means = ((scene.means - (low + high) / 2) * factor + np.asarray(place)).astype(np.float32)
        columns.append((means, scene.scales * factor, scene.quats, scene.opacities, scene.sh[:, :bands]))
    return Gaussians(*(np.concatenate(column) for column in zip(*columns, strict=True)))


def three_samples() -> tuple[Gaussians, list[int]]:
    """The three samples side by side, and the number of Gaussians in each."""
    scenes = [load(SAMPLES / name / f"{name}.ply").gaussians for name in ("watermelon", "orange", "bread")]
    places = ((0, 0, 0), (1.3, 0, 0), (0.6, 1.3, 0))
    return beside(*scenes, places=places), [len(scene) for scene in scenes]


class Waves:
    """An inside of waves much shorter than a pitch; records the footprints of its queries."""

    def __init__(self) -> None:
        self.footprints: list[float] = []
        self.detail = 0.01

    def kinds(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        return np.where(points[:, 2] > 0, Kind.INSIDE, Kind.RIND).astype(np.uint8)

    def at(self, points: NDArray[np.floating], footprint: float) -> NDArray[np.float32]:
        self.footprints.append(footprint)
        return waves(points)

    def record(self) -> InsideRecord:
        raise NotImplementedError


def waves(points: NDArray[np.floating]) -> NDArray[np.float32]:
    phase = points @ np.array([[90.0, 10, 0], [0, 70, 20], [30, 0, 60]]).T
    return (0.5 + 0.5 * np.sin(phase)).astype(np.float32)
