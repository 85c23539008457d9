"""The cuts that all methods are measured on; none of them is trained."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file

from engine.io.files import atomic
from engine.scene.camera import Camera, equator, plane_points, section, spread_directions
from engine.scene.plane import Plane
from sample_scenes.solids import Solid
from training.families import Family

__all__ = ["Cut", "Truth", "intersection_points", "load_truth", "make_cuts"]

Float = NDArray[np.float32]

SIZE = 224
"""Pixels along a side of a cut's picture: the input size of the feature network."""

REACH = 0.5
"""Largest distance of random planes from the centre, as a share of the way to the skin."""

CANONICAL = 3
"""Random cuts per canonical one, which lies along a trained family at a new position."""

CONSISTENCY_CUTS = 12
"""Random cuts that are compared pairwise along their intersections: 66 pairs."""

LINE_POINTS = 48
"""Points along the intersection of two cuts."""


@dataclass(frozen=True)
class Cut:
    """A plane and the camera that looks at it straight on."""

    plane: Plane
    camera: Camera
    canonical: str = ""
    """Kind of the family that it lies along; empty for a random one."""

    @property
    def points(self) -> Float:
        """(H, W, 3). World points of the pixels."""
        return plane_points(self.camera, self.plane)

    def pixel_position(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M, 2). Column and row, in array indices, of world points (M, 3)."""
        seen = points @ self.camera.viewmat[:3, :3].T + self.camera.viewmat[:3, 3]
        pixel_position = seen[:, :2] * [self.camera.fx, self.camera.fy] + [self.camera.cx, self.camera.cy]
        return np.asarray(pixel_position - 0.5)


def make_cuts(solid: Solid, families: tuple[Family, ...], count: int) -> list[Cut]:
    """`count` random planes through a solid, then canonical ones, which alternate between the families."""
    rng = np.random.default_rng(7)
    bounds, up = solid.bounds, np.asarray(solid.up)
    centre, half = bounds.mean(0), np.ptp(bounds, axis=0) / 2
    planes: list[tuple[Plane, str]] = []
    for _ in range(count):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        # Between the half sizes of a ball and of a box in this direction.
        reach = float(half @ np.abs(normal)) / np.sqrt(3)
        planes.append((Plane.through(centre + normal * reach * rng.uniform(-REACH, REACH), normal), ""))
    e1, e2 = equator(up)
    for index in range(-(-count // CANONICAL)):
        family = families[index % len(families)]
        normal, place = up, rng.uniform(-0.7, 0.7)
        if family.kind == "radial":
            angle, place = rng.uniform(0, np.pi), 0.0
            normal = np.cos(angle) * e1 + np.sin(angle) * e2
        elif family.kind == "parallel" and family.axis is not None:
            normal = np.asarray(family.axis)
        planes.append((Plane.through(centre + place * half * normal, normal), family.kind))
    radius = float(np.linalg.norm(solid.skin_points(spread_directions(2048)) - centre, axis=1).max())
    return [Cut(plane, section(plane, up, bounds, SIZE, radius), kind) for plane, kind in planes]


@dataclass(frozen=True)
class Truth:
    """The true pictures of the cuts."""

    pictures: Float
    """(C, H, W, 3). Over white."""
    inside: NDArray[np.bool_]
    """(C, H, W). The silhouettes."""


def load_truth(solid: Solid, cuts: list[Cut], path: Path) -> Truth:
    """The true pictures, cached in a file for all methods of a scene. The file counts if it shows what the solid now
    shows in the first cut and the last."""

    def shown(cut: Cut) -> tuple[Float, NDArray[np.bool_]]:
        return solid.slice(cut.plane, cut.camera, supersample=2)

    if path.is_file():
        kept = load_file(path)
        pictures, inside = kept["pictures"], kept["inside"]
        if len(pictures) == len(cuts) and all(np.array_equal(pictures[n], shown(cuts[n])[0]) for n in (0, -1)):
            return Truth(pictures, inside)
    slices = [shown(cut) for cut in cuts]
    truth = Truth(np.stack([rgb for rgb, _ in slices]), np.stack([inside for _, inside in slices]))
    with atomic(path) as temporary:
        save_file({"pictures": truth.pictures, "inside": truth.inside}, temporary)
    return truth


def intersection_points(solid: Solid, cuts: list[Cut]) -> list[tuple[int, int, NDArray[np.float64]]]:
    """Pairs of random cuts and the points (M, 3) inside the solid on their intersection."""
    random = [index for index, cut in enumerate(cuts) if not cut.canonical][:CONSISTENCY_CUTS]
    low, high = solid.bounds
    reach = float(np.linalg.norm(high - low)) / 2
    clear = 0.04 * float((high - low).max())  # clear of the skin by more than a pixel of either picture
    result = []
    for a, b in itertools.combinations(random, 2):
        na, nb = (np.asarray(cuts[i].plane.normal) for i in (a, b))
        along = np.cross(na, nb)
        if np.linalg.norm(along) < 0.1:
            continue
        along /= np.linalg.norm(along)
        start = np.linalg.solve(np.stack([na, nb, along]), [-cuts[a].plane.offset, -cuts[b].plane.offset, 0.0])
        line = start + np.linspace(-reach, reach, 4 * LINE_POINTS)[:, None] * along
        line = line[solid.depth(line) > clear]
        if len(line):
            result.append((a, b, line))
    return result
