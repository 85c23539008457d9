"""Scenes with a known inside: a captured shell, pictures of a few cut faces, and the truth at every cut.

The first scenes are what users have: the capture of one fruit, a horizontal picture of a second and a radial one of a
third, which somebody else took in other light (`orange_others` and so on). Then come the sample solids with pictures of
their own, and a natural one: `thigh`, true-colour slices of a human thigh (Visible Human Male), if the file with them
is at hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.io.picture_file import save_png
from engine.io.splats.ply import write_ply
from engine.scene.grid import Body, Grid
from engine.scene.plane import Plane
from engine.solid.distance_transform import nearest
from sample_scenes.exemplars import photograph, planes, snapshot
from sample_scenes.make import SHIPPED, make
from sample_scenes.shell import Look, shell
from sample_scenes.solids import SOLIDS, Solid
from training.families import COUNTS, Family
from training.priors.prior import Volume
from training.request import Request
from training.settings import DETAILS, Detail

__all__ = ["OTHERS", "SCENES", "CustomRequest", "EvaluationScene", "load_scene", "thigh"]

THIGH = "thigh"

OTHERS = "_others"
"""Suffix of a scene whose pictures show other individuals than its capture, each taken by somebody else."""

ROUND = ("watermelon", "orange", "apple", "pomegranate")
SCENES = (*(name + OTHERS for name in ROUND), *SOLIDS, THIGH)

SHIPPED_AT = Path(__file__).parents[2] / "sample_scenes"
THIGH_AT = Path(__file__).parents[3] / "shared/data/volumes/vhm_thigh_rgba.npz"

THIGH_LOOK = Look(20000, 0, 0.0)
THIGH_SLICES = (-0.6, 0.0, 0.6)
"""Heights of the exemplars as shares of the half height."""

PICTURE = 512
"""Pixels along a side of an exemplar."""


@dataclass(frozen=True)
class CustomRequest(Request):
    """A request with a custom level of detail."""

    numbers: Detail = DETAILS["draft"]

    @property
    def fineness(self) -> Detail:
        """The custom level of detail."""
        return self.numbers


@dataclass(frozen=True)
class EvaluationScene:
    """A scene that methods are evaluated on."""

    name: str
    solid: Solid
    """The truth."""
    another: Solid | None
    """Another solid of the same kind; its distance to the truth is that of a different but correct inside."""
    scene: Path
    families: tuple[Family, ...]

    def request(self, numbers: Detail, seed: int) -> CustomRequest:
        """The request for a run on this scene."""
        return CustomRequest(self.scene, self.families, up=self.solid.up, seed=seed, numbers=numbers)


def load_scene(name: str, folder: Path) -> EvaluationScene:
    """The scene of this name; its files are made in folder/name unless they come with the project.

    Raises InputError if there is no such scene or its data is missing.
    """
    if name == THIGH:
        return _thigh_subject(folder)
    if name.removesuffix(OTHERS) in ROUND and name.endswith(OTHERS):
        return _others(name, folder)
    if name not in SOLIDS:
        raise InputError(f"--scenes {name}: no such scene; choose {', '.join(SCENES)}")
    solid = SOLIDS[name](0)
    home = SHIPPED_AT if name in SHIPPED and (SHIPPED_AT / name / f"{name}.ply").is_file() else folder
    pictures = {kind: home / name / f"{kind}_1.png" for kind in COUNTS if kind in solid.families}
    scene = home / name / f"{name}.ply"
    if not all(path.is_file() for path in (scene, *pictures.values())):
        make(name, folder)
    families = tuple(
        Family(kind, COUNTS[kind], (path,), axis=_axis(solid) if kind == "parallel" else None)
        for kind, path in pictures.items()
    )
    return EvaluationScene(name, solid, SOLIDS[name](1), scene, families)


def _others(name: str, folder: Path) -> EvaluationScene:
    """The shell of one fruit with pictures of two others; seeds 0 and 1 are the truth and another one."""
    own = load_scene(name.removesuffix(OTHERS), folder)
    pictures = {kind: folder / name / f"{kind}.png" for kind in COUNTS if kind in own.solid.families}
    for (kind, path), seed, take in zip(pictures.items(), (2, 3), (photograph, snapshot), strict=True):
        if not path.is_file():
            other = SOLIDS[own.name](seed)
            save_png(path, take(other, planes(other, kind)[0], PICTURE), optimize=True)
    families = tuple(Family(kind, COUNTS[kind], (path,)) for kind, path in pictures.items())
    return replace(own, name=name, families=families)


def _axis(solid: Solid) -> tuple[float, float, float]:
    """The longer of the two horizontal axes, along which parallel exemplars are cut."""
    low, high = solid.bounds
    return (1.0, 0.0, 0.0) if high[0] - low[0] >= high[1] - low[1] else (0.0, 1.0, 0.0)


def _thigh_subject(folder: Path) -> EvaluationScene:
    solid = thigh(THIGH_AT)
    scene = folder / THIGH / f"{THIGH}.ply"
    pictures = tuple(folder / THIGH / f"horizontal_{number}.png" for number in range(1, len(THIGH_SLICES) + 1))
    low, high = solid.bounds
    for place, path in zip(THIGH_SLICES, pictures, strict=True):
        if not path.is_file():
            plane = Plane.through((low + high) / 2 + place * (high - low) / 2 * [0, 0, 1], (0.0, 0.0, 1.0))
            save_png(path, photograph(solid, plane, PICTURE), optimize=True)
    if not scene.is_file():
        write_ply(scene, shell(solid, THIGH_LOOK, np.random.default_rng(100)), comments=("thigh, up +z",))
    return EvaluationScene(THIGH, solid, None, scene, (Family("horizontal", COUNTS["horizontal"], pictures),))


def thigh(path: Path) -> Solid:
    """The thigh as a solid, its longest side 2 units. Raises InputError if the file is missing."""
    if not path.is_file():
        raise InputError(f"{path}: not there; leave the scene '{THIGH}' out, or put the file there")
    with np.load(path, allow_pickle=False) as data:
        rgb, spacing = data["rgb"], data["spacing_mm"].astype(np.float64)
        shape = tuple(int(n) for n in data["mask_shape"])
        mask = np.unpackbits(data["mask"])[: int(np.prod(shape))].reshape(shape).astype(bool)
    # From z, y, x (y downwards, slices from the hip to the knee) to world axes with the hip up, on cubes.
    rgb, mask = (np.moveaxis(a[::-1, ::-1], (0, 1, 2), (2, 1, 0)) for a in (rgb, mask))
    spacing = spacing[::-1]
    cell = float(spacing.min())
    box = [slice(max(at.min() - 1, 0), at.max() + 2) for at in np.nonzero(mask)]
    rgb, mask = rgb[tuple(box)], mask[tuple(box)]
    colour = np.stack([_cubes((rgb[..., c] / 255).astype(np.float32), spacing / cell) for c in range(3)], axis=-1)
    inside = _cubes(mask.astype(np.float32), spacing / cell) > 0.5
    margin = 8
    inside = np.pad(inside, margin)
    colour = np.pad(colour, [(margin, margin)] * 3 + [(0, 0)], mode="edge")
    # The outermost ring of the photographs is half the blue they were taken on.
    index = nearest(ndimage.binary_erosion(inside, iterations=2))[1]
    colour = colour.reshape(-1, 3)[index]
    sides = [np.flatnonzero(inside.any(axis=other)) for other in ((1, 2), (0, 2), (0, 1))]
    size = 2.0 / max(np.ptp(side) + 1 for side in sides)
    centre = np.array([(side.min() + side.max() + 1) / 2 for side in sides])
    deep = nearest(~inside)[0] - nearest(inside)[0]
    depth = ndimage.gaussian_filter(deep, 1.0) * np.float32(size)
    body = Body(Grid(-centre * size, size, depth.shape), depth)
    volume = Volume(body, np.ascontiguousarray(colour))

    def skin_depth(points: NDArray[np.float64]) -> NDArray[np.float32]:
        # Beyond the grid the depth keeps falling, so that the search for the skin converges.
        return body.at(points) - np.maximum(np.abs(points).max(-1) - 1.1, 0).astype(np.float32)

    return Solid.of(THIGH, ("horizontal",), skin_depth, volume.at)


def _cubes(values: NDArray[np.float32], zoom: NDArray[np.float64]) -> NDArray[np.float32]:
    """A volume resampled to cubic cells."""
    return ndimage.zoom(values, zoom, order=1, output=np.float32)
