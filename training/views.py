"""Training views: cut faces seen straight on, and the capture from all around (paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.fit.view_weights import ViewWeights
from engine.render.cpu.kernel_field import KernelField
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, cameras_around, equator, plane_points, section
from engine.scene.gaussians import Gaussians
from engine.scene.grid import Body
from engine.scene.plane import Plane
from engine.threads import side_by_side
from training.families import Family
from training.priors.prior import Condition

__all__ = [
    "BACKGROUND",
    "ENTRIES",
    "Extent",
    "Section",
    "Slice",
    "make_condition",
    "sections",
    "slices",
    "surface_cameras",
]

BACKGROUND = (1.0, 1.0, 1.0)
"""White, the usual background of exemplar pictures."""

# Weights kept per pixel. A surface pixel blends some tens of soft atoms; with a skin's variation of colour, the sixteen
# largest weights reproduce it at about 50 dB. A cut face blends 17 on average, more where fine atoms meet coarse ones
# and the skin: sixteen reproduce the trained watermelon and orange at 53 and 60 dB.
ENTRIES = 16

TOGETHER = 8
"""Sections weighed between two progress reports: enough to occupy the cores."""


@dataclass(frozen=True)
class Slice:
    """A cut face of the body, independent of the atoms that fill it."""

    family: Family
    plane: Plane
    camera: Camera
    points: NDArray[np.float32]
    """(H, W, 3). World points of the pixels."""
    inside: NDArray[np.bool_]
    """(H, W). The silhouette."""
    body: Body
    extent: Extent

    @property
    def condition(self) -> Condition:
        """What a prior that draws plane by plane is told before training."""
        return make_condition(self.family, self.body, self.extent, self.camera, self.points)


@dataclass(frozen=True)
class Section(Slice):
    """A cut face with the weights of the atoms in its pixels."""

    weights: ViewWeights


def slices(
    body: Body,
    up: NDArray[np.float64],  # [3]
    families: Sequence[Family],
    size: int,
) -> list[Slice]:
    """Every plane of every family as a view of size x size pixels, without planes that miss the body."""
    bounds, radius, extent = body.bounds(), body.radius, Extent.of(body, up)

    def slice_of(asked: tuple[Family, Plane]) -> Slice | None:
        family, plane = asked
        camera = section(plane, up, bounds, size, radius)
        points = plane_points(camera, plane)
        inside = body.at(points) > 0
        return Slice(family, plane, camera, points, inside, body, extent) if inside.any() else None

    all_asked = [(family, plane) for family in families for plane in family.planes(body, up)]
    return [made for made in side_by_side(slice_of, all_asked) if made is not None]


def sections(atoms: Atoms, cuts: Sequence[Slice], progress: Callable[[float], None]) -> list[Section]:
    """The slices with the weights of these atoms in their pixels."""
    field = KernelField(atoms)

    def weighed(cut: Slice) -> Section:
        weights = ViewWeights.section(atoms, cut.plane, cut.camera, field).truncated(ENTRIES)
        return Section(cut.family, cut.plane, cut.camera, cut.points, cut.inside, cut.body, cut.extent, weights)

    result: list[Section] = []
    for start in range(0, len(cuts), TOGETHER):
        result += side_by_side(weighed, cuts[start : start + TOGETHER])
        progress(len(result) / len(cuts))
    return result


@dataclass(frozen=True)
class Extent:
    """Extent of a body along and around its axis, in world units: normalises a condition's coordinates."""

    up: NDArray[np.float64]
    centre: NDArray[np.float64]
    reach: float
    """Largest distance from the axis."""
    bottom: float
    """Lowest point along the axis, relative to the centre; `top` is the highest."""
    top: float
    inradius: float

    @staticmethod
    def of(body: Body, up: NDArray[np.float64]) -> Extent:
        """The extent of the cells inside a body."""
        centre = body.bounds().mean(0)
        points = body.points - centre
        along = points @ up
        reach = np.linalg.norm(np.cross(points, up), axis=-1).max()
        return Extent(up, centre, float(reach), float(along.min()), float(along.max()), body.inradius)


def make_condition(
    family: Family,
    body: Body,
    extent: Extent,
    camera: Camera,
    points: NDArray[np.float32],  # [H, W, 3]
) -> Condition:
    """The condition of a cut face before training; its render is even grey."""
    e1, e2 = equator(extent.up)
    offset = points - extent.centre
    x, y, z = offset @ e1, offset @ e2, offset @ extent.up
    bottom, top = extent.bottom, extent.top
    depth = body.at(points)
    inside = depth > 0
    distance = points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    return Condition(
        family=family,
        prompt=family.prompt,
        inside=inside,
        under_skin=np.clip(depth / extent.inradius, 0, 1).astype(np.float32),
        radius=(np.hypot(x, y) / extent.reach).astype(np.float32),
        angle=np.arctan2(y, x).astype(np.float32),
        height=(2 * (z - bottom) / max(top - bottom, 1e-12) - 1).astype(np.float32),
        depth=np.where(inside, distance, np.inf).astype(np.float32),
        render=np.full(points.shape, 0.5, np.float32),
    )


def surface_cameras(
    gaussians: Gaussians, up: NDArray[np.float64], count: int, size: int, turn: float = 0.0
) -> list[Camera]:
    """Cameras all around the visible part of a capture."""
    low, high = gaussians.visible_bounds()
    return cameras_around((low + high) / 2, float(np.linalg.norm(high - low)) / 2, up, count, size, turn)
