"""The interior of a body from pictures of its cut faces.

DESIGN section 5.1 starts from a layout and lets patches of all families vote on it. Here the layout itself keeps apart
what lives differently along an axis (`decompose`), and is so near to what the pictures show that votes only blur it:
on the orange at 144 voxels two rounds of votes took the patch distance from 1.1 to 2.0 times that of another true
orange, and the sharpness from 0.84 to 0.64, at seven times the cost. So there are none.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.scene.grid import Body
from training.families import Family
from training.priors.exemplar.carve import Carving, carving
from training.priors.exemplar.core import take_core
from training.priors.exemplar.decompose import Layers, decompose
from training.priors.exemplar.frames import Frame, Space, View, make_sheet, make_space
from training.priors.exemplar.layout import SIDEWAYS, along, between, carried, heights, lined, revolved
from training.priors.exemplar.light import gain_between
from training.priors.exemplar.morph import slices
from training.priors.exemplar.patches import FIXED, POLAR, RADIAL
from training.priors.exemplar.pictures import Picture, read_picture, resolved
from training.priors.exemplar.scatter import strew
from training.priors.exemplar.sharpen import sharpen
from training.priors.prior import Progress, Volume

__all__ = ["solve"]

log = logging.getLogger(__name__)

FINER = 2.0
"""Cells to what a picture resolves. One would blur it, as it stands askew on the grid: an orange from pictures of 70
pixels is at 0.46 of the true sharpness on 192 cells, 0.45 on 144, 0.40 on 112 and 0.29 on 80; by patches 144 are
best. The 144 make 0.4 times the atoms."""


def solve(
    body: Body, up: NDArray[np.float64], families: Sequence[Family], voxels: int, seed: int, progress: Progress
) -> Volume:
    """The interior on a grid of `voxels` cells along the body's longest side, or fewer. Bit-equal for a seed.

    Fewer where the pictures do not show as much (FINER). Raises InputError where no family has an exemplar, or a
    picture cannot be used.
    """
    families = [f.plain(body, up) for f in families if f.exemplars]
    if not families:
        raise InputError("no exemplar pictures: give at least one family a photograph of a cut face")
    rng = np.random.default_rng(seed)
    progress(0.0)
    pictures = _one_light([[read_picture(p, f.kind) for p in f.exemplars] for f in families])
    space = make_space(body, up, voxels)
    needed = _needed(space, families, pictures, voxels)
    if needed < voxels:
        space = make_space(body, up, needed)
    progress(0.1)
    views = [_view(space, family, own) for family, own in zip(families, pictures, strict=True)]
    if len(views) == 1 and views[0].kind != RADIAL and (stack := slices(views[0].sheets)) is not None:
        log.info("the pictures are slices of one thing, in order along %s", np.round(views[0].basis[2], 2).tolist())
        rgb = space.scatter(between(space, along(space, views[0].basis, False), stack))
        sharpen(space, rgb, views)
        return _volume(space, rgb, progress)
    layers = [[decompose(sheet, view.kind) for sheet in view.sheets] for view in views]
    progress(0.2)
    colours, carve = _carry(space, views, layers, rng, lambda part: progress(0.2 + 0.5 * part))
    rgb = space.scatter(colours)
    count = strew(rgb, space, views, layers, carve, rng, lambda part: progress(0.7 + 0.1 * part))
    space.fill(rgb)
    gain = sharpen(space, rgb, views)
    log.info("%d details strewn, edges sharpened by %.2f", count, gain)
    return _volume(space, rgb, progress)


def _one_light(families: list[list[Picture]]) -> list[list[Picture]]:
    """The pictures of all families in the light of the first family's first one.

    Within that family nothing is changed: slices of one thing differ for other reasons than light.
    """
    first = families[0][0]
    return families[:1] + [
        [replace(p, rgb=np.minimum(p.rgb * gain_between(p.rgb, p.mask, first.rgb, first.mask), 1)) for p in family]
        for family in families[1:]
    ]


def _volume(space: Space, rgb: NDArray[np.float32], progress: Progress) -> Volume:
    """The answer: the grid with the air around filled from the nearest voxel inside."""
    progress(0.95)
    nearest = ndimage.distance_transform_edt(space.number < 0, return_distances=False, return_indices=True)
    volume = Volume(space.body, rgb[tuple(nearest)])
    progress(1.0)
    return volume


def _needed(space: Space, families: list[Family], pictures: list[list[Picture]], voxels: int) -> int:
    """Cells along the longest side, FINER times what the most detailed picture resolves; at most `voxels`."""
    cells = min(
        np.sqrt(_framed(space, family)[2] / p.mask.sum()) / resolved(p)
        for family, own in zip(families, pictures, strict=True)
        for p in own
    )
    return min(voxels, int(np.ceil(voxels * FINER / cells)))


def _view(space: Space, family: Family, pictures: list[Picture]) -> View:
    """The frame of a family and its pictures at the scale of the voxels."""
    kind, basis, area = _framed(space, family)
    return View(kind, basis, [make_sheet(p, space, kind, area) for p in pictures])


def _framed(space: Space, family: Family) -> tuple[Frame, NDArray[np.float64], float]:
    """How a family looks at the body, and the area that its pictures show, in square cells."""
    if family.kind == "radial":
        middle = (space.planar[:, 1] >= -0.5) & (space.planar[:, 1] < 0.5)
        return RADIAL, space.basis, float(middle.sum())
    basis = space.basis
    if family.kind != "horizontal":
        normal = family.normal(space.body, space.up)
        high = space.up - normal * (normal @ space.up)
        high = high / np.linalg.norm(high) if np.linalg.norm(high) > 1e-3 else space.basis[1]
        basis = np.stack([np.cross(high, normal), high, normal])
    kind = POLAR if family.kind == "horizontal" and space.is_round else FIXED
    return kind, basis, space.widest_slice((space.cells - space.centre) @ basis[2])


def _carry(
    space: Space, views: list[View], layers: list[list[Layers]], rng: np.random.Generator, progress: Progress
) -> tuple[NDArray[np.float32], Carving | None]:
    """(N, 3). One family's pictures carried through the body, corrected by what radial ones know of height.

    And what those know of the height of its structures, if anything.
    """
    kinds = [v.kind for v in views]
    carrier = next((kinds.index(kind) for kind in (POLAR, FIXED) if kind in kinds), None)
    radial = kinds.index(RADIAL) if RADIAL in kinds else None
    if carrier is None:
        log.info("radial pictures alone: turned about the axis")
        return revolved(space, layers[0][0], rng), None
    view = views[carrier]
    axis = along(space, view.basis, view.kind == POLAR)
    rate = _drift(layers[carrier], layers[radial] if radial is not None else [])
    log.info(
        "carried along the %s axis, texture drifting %.2f cells a cell", "up" if view.kind == POLAR else "fixed", rate
    )
    core, carve = None, None
    if radial is not None:
        if view.kind == POLAR:
            others = [take_core(parts, layers[radial])[1] for parts in layers[carrier][1:]]
            core, first, layers[radial] = take_core(layers[carrier][0], layers[radial])
            layers[carrier] = [first, *others]
        carve = carving(layers[carrier][0], layers[radial], rng)
    colours = carried(space, axis, layers[carrier], rate, carve, core, rng, progress)
    if radial is not None:
        heights(space, axis, colours, layers[carrier][0], layers[radial], carve)
    if core is not None:
        # Last, or it would be taken for what radial pictures without it do not show.
        lined(space, axis, colours, layers[carrier][0], core)
    return np.clip(colours, 0, 1), carve


def _drift(carrier: list[Layers], radial: list[Layers]) -> float:
    """Cells that the texture moves sideways per cell along the axis, so that it is as steep there as it should be.

    That is what the radial pictures show along the axis; without them, what the carrier shows on the average.
    """
    spread, a, b = np.mean([p.spread for p in carrier], axis=0)
    wanted = np.sqrt((a * a + b * b) / 2) / spread
    if radial:
        of, _, steep = np.mean([p.spread for p in radial], axis=0)
        wanted = steep / of
    return float(np.clip(wanted / (np.sqrt((SIDEWAYS * a) ** 2 + b * b) / spread), 0.1, 1.5))
