"""The interior of a body from pictures of its cut faces: solid patch optimisation (DESIGN section 5.1)."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.body import Body
from engine.errors import InputError
from training.exemplar.decompose import Layers, decompose
from training.exemplar.frames import Frame, Space, View, make_sheet, make_space
from training.exemplar.layout import SIDEWAYS, along, carried, heights, revolved
from training.exemplar.patches import FIXED, POLAR, RADIAL
from training.exemplar.pictures import read_picture
from training.exemplar.scatter import strew
from training.families import Family
from training.prior import Progress, Volume

__all__ = ["solve"]

log = logging.getLogger(__name__)


def solve(
    body: Body, up: NDArray[np.float64], families: Sequence[Family], voxels: int, seed: int, progress: Progress
) -> Volume:
    """The interior on a grid of `voxels` cells along the body's longest side. Bit-equal for a seed.

    Raises InputError where no family has an exemplar, or a picture cannot be used.
    """
    families = [f for f in families if f.exemplars]
    if not families:
        raise InputError("no exemplar pictures: give at least one family a photograph of a cut face")
    rng = np.random.default_rng(seed)
    progress(0.0)
    space = make_space(body, up, voxels)
    views = [_view(space, family) for family in families]
    progress(0.1)
    rgb = _layout(space, views, rng, progress)
    rgb = sharpened(space, rgb, views)
    progress(1.0)
    return Volume(space.body, _everywhere(space, rgb))


def sharpened(space: Space, rgb: NDArray[np.float32], views: list[View]) -> NDArray[np.float32]:
    """The colours with what interpolation takes from their edges put back, by as much as the pictures say.

    A picture read at whole voxels, and again between them as a cut reads a grid, gives the sharpness to have.
    """
    from scipy import ndimage

    wanted, have = [], []
    for view in views:
        sheet = view.sheets[0]
        core = sheet.xy[(ndimage.map_coordinates(sheet.depth, sheet.xy.T[::-1] * 2, order=0) > 0.15)]
        wanted.append(_edges(lambda x, y, sheet=sheet: sheet.read(x, y), core))
    core = space.cells[space.depth > 0.15]
    core = core[:: max(1, len(core) // 40_000)].astype(np.float32)
    for view in views:
        a, b = view.basis[0], view.basis[2 if view.kind == RADIAL else 1]
        turned = (
            (a + b * 0.3) / np.linalg.norm(a + b * 0.3),
            np.cross(np.cross(a, b), a + b * 0.3) / np.linalg.norm(a + b * 0.3),
        )

        def cut(x: NDArray, y: NDArray, turned=turned) -> NDArray:
            at = core.T + 0.37 + x * turned[0][:, None] + y * turned[1][:, None]
            return np.stack([ndimage.map_coordinates(rgb[..., c], at, order=1, mode="nearest") for c in range(3)], -1)

        have.append(_edges(cut, np.zeros((1, 2))))
    lack = float(np.mean(wanted) / max(np.mean(have), 1e-6))
    log.info("sharpness %.2f of the pictures'", 1 / lack)
    amount = np.clip((lack - 1) * 0.9, 0, 1.2)
    blurred = np.stack([ndimage.gaussian_filter(rgb[..., c], 0.8) for c in range(3)], -1)
    low = np.stack([ndimage.minimum_filter(rgb[..., c], 3) for c in range(3)], -1)
    high = np.stack([ndimage.maximum_filter(rgb[..., c], 3) for c in range(3)], -1)
    return np.clip(rgb + amount * (rgb - blurred), low - 0.03, high + 0.03)


def _edges(read, at: NDArray[np.floating]) -> float:
    """RMS Laplacian, one cell wide, of what `read` gives around places."""
    x, y = at.T
    total = read(x - 1, y) + read(x + 1, y) + read(x, y - 1) + read(x, y + 1) - 4 * read(x, y)
    return float(np.sqrt((total.mean(-1) ** 2).mean()))


def _everywhere(space: Space, rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """(X, Y, Z, 3). The colours with all the air filled from the nearest voxel inside."""
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(space.number < 0, return_distances=False, return_indices=True)
    return np.clip(rgb[nearest[0], nearest[1], nearest[2]], 0, 1)


def _view(space: Space, family: Family) -> View:
    """The frame of a family and its pictures at the scale of the voxels."""
    pictures = [read_picture(p, family.kind) for p in family.exemplars]
    if family.kind == "radial":
        middle = (space.planar[:, 1] >= -0.5) & (space.planar[:, 1] < 0.5)
        return View(RADIAL, space.basis, [make_sheet(p, space, RADIAL, float(middle.sum())) for p in pictures])
    basis = space.basis
    if family.kind != "horizontal":
        normal = family.normal(space.body, space.up)
        high = space.up - normal * (normal @ space.up)
        high = high / np.linalg.norm(high) if np.linalg.norm(high) > 1e-3 else space.basis[1]
        basis = np.stack([np.cross(high, normal), high, normal])
    kind: Frame = POLAR if family.kind == "horizontal" and space.is_round else FIXED
    area = space.widest_slice((space.cells - space.centre) @ basis[2])
    return View(kind, basis, [make_sheet(p, space, kind, area) for p in pictures])


def _layout(space: Space, views: list[View], rng: np.random.Generator, progress: Progress) -> NDArray[np.float32]:
    """(X, Y, Z, 3). The start: one family's pictures carried through the body, corrected and strewn with details."""
    layers = [[decompose(sheet) for sheet in view.sheets] for view in views]
    kinds = [v.kind for v in views]
    carrier = next((n for kind in (FIXED, POLAR) for n, k in enumerate(kinds) if k == kind), None)
    radial = next((n for n, k in enumerate(kinds) if k == RADIAL), None)
    if carrier is None:
        colours = revolved(space, layers[0][0])
    else:
        view = views[carrier]
        axis = along(space, view.basis, view.kind == POLAR)
        rate = _drift(layers[carrier], layers[radial] if radial is not None else None)
        log.info("texture drifts %.2f cells a cell", rate)
        colours = carried(space, axis, layers[carrier], rate, rng)
        if radial is not None:
            heights(space, axis, colours, layers[carrier][0], layers[radial])
    rgb = space.scatter(np.clip(colours, 0, 1))
    count = strew(rgb, space, views, layers, rng)
    log.info("%d details", count)
    space.fill(rgb)
    return rgb


def _drift(carrier: list[Layers], radial: list[Layers] | None) -> float:
    """Cells that the texture moves sideways per cell along the axis, so that its slope there is as steep as it should be.

    That is what the radial pictures show along the axis; without them, what the carrier shows on the average.
    """
    spread, a, b = np.mean([p.spread for p in carrier], axis=0)
    wanted = np.sqrt((a * a + b * b) / 2) / spread
    if radial:
        of, _, steep = np.mean([p.spread for p in radial], axis=0)
        wanted = steep / of
    return float(np.clip(wanted / (np.sqrt((SIDEWAYS * a) ** 2 + b * b) / spread), 0.1, 1.5))
