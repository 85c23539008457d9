"""The interior of a body from pictures of its cut faces: solid patch optimisation (DESIGN section 5.1)."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.body import Body
from engine.errors import InputError
from training.exemplar.decompose import Layers, decompose
from training.exemplar.frames import Frame, Space, View, make_sheet, make_space, voxel_gate
from training.exemplar.layout import SIDEWAYS, along, carried, height_correction, revolved
from training.exemplar.library import Atlas, Library, make_atlas, make_library
from training.exemplar.patches import FIXED, POLAR, RADIAL, gather_votes, match
from training.exemplar.pictures import read_picture
from training.exemplar.scatter import strew
from training.families import Family
from training.prior import Progress, Volume

__all__ = ["solve"]

log = logging.getLogger(__name__)

LAMBDA = 20.0
"""Price of using an exemplar pixel once more than its share, squared colour units (DESIGN 5.1, step 4)."""

MU = 0.15
"""Price of a gate cell's distance, squared."""

TAU = 1.0
"""Squared patch distance over which a family loses its voice (DESIGN 5.1, step 6)."""

WIDTHS = np.array([0.15, 0.08, 0.05], np.float32)
"""Mean shift's widths, colour distance (DESIGN 5.1, step 5)."""

ITERATIONS = 0

THIN = 4
"""One in this many voxels of a plane is matched; the others live on its votes. Planes are never skipped."""

CHUNKS = 48
"""Parts of an iteration between which the prices of exemplar pixels are brought up to date."""


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
    atlas = make_atlas([v.sheets for v in views])
    progress(0.05)
    rgb = _layout(space, views, rng)
    progress(0.15)
    state = _Matching(space, views, atlas)
    for iteration in range(ITERATIONS):
        last = iteration == ITERATIONS - 1
        span = 0.8 / ITERATIONS
        at = 0.15 + span * iteration
        state.match(rgb, iteration, rng, lambda part, at=at: progress(at + 0.7 * span * part))
        state.vote(rgb, 0.7 if last else 1.2, lambda part, at=at: progress(at + span * (0.7 + 0.3 * part)))
    progress(1.0)
    return Volume(space.body, _everywhere(space, rgb))


def _everywhere(space: Space, rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """(X, Y, Z, 3). The colours with all the air filled from the nearest voxel inside."""
    from scipy import ndimage

    nearest = ndimage.distance_transform_edt(space.number < 0, return_distances=False, return_indices=True)
    return np.clip(rgb[nearest[0], nearest[1], nearest[2]], 0, 1)


def _view(space: Space, family: Family) -> View:
    """The frame of a family and its pictures at the scale of the voxels."""
    kind: Frame = POLAR if family.kind == "horizontal" else RADIAL if family.kind == "radial" else FIXED
    pictures = [read_picture(p, family.kind) for p in family.exemplars]
    area = _face_area(space, family, kind)
    basis = space.basis
    if kind == FIXED:
        normal = family.normal(space.body, space.up)
        high = space.up - normal * (normal @ space.up)
        high = high / np.linalg.norm(high) if np.linalg.norm(high) > 1e-3 else space.basis[1]
        basis = np.stack([np.cross(high, normal), high, normal])
    return View(kind, basis, [make_sheet(p, space, kind, area) for p in pictures])


def _face_area(space: Space, family: Family, kind: Frame) -> float:
    """Square cells of the widest face of a family."""
    if kind == POLAR:
        return np.pi * space.slice_radius() ** 2
    if kind == RADIAL:
        near = (space.planar[:, 1] >= -0.5) & (space.planar[:, 1] < 0.5)
        return float(near.sum())
    return space.widest_slice((space.cells - space.centre) @ family.normal(space.body, space.up))


def _layout(space: Space, views: list[View], rng: np.random.Generator) -> NDArray[np.float32]:
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
            colours += height_correction(space, views[radial].sheets, layers[carrier][0].rind)
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


def _find(
    rgb: NDArray[np.float32],
    space: Space,
    view: View,
    atlas: Atlas,
    library: Library,
    rows: NDArray[np.intp],
    gate: NDArray[np.float32],
    price: NDArray[np.float32] | None,
    family: int = 0,
    lists: NDArray[np.int32] | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """(M,) the cheapest pixel of the family for each row of `space.cells`, and (M,) its squared patch distance."""
    start, stop = atlas.spans[family]
    best = np.empty(len(rows), np.int32)
    distance = np.empty(len(rows), np.float32)
    match(
        rgb,
        space.cells[rows],
        library.lists if lists is None else lists,
        gate,
        view.kind,
        view.basis.astype(np.float32),
        space.centre,
        library.mean,
        library.axes,
        library.starts,
        library.blocks,
        library.low,
        library.high,
        library.members,
        atlas.gate[start:stop],
        np.zeros(stop - start, np.float32) if price is None else price,
        MU,
        best,
        distance,
        library.features,
    )
    return best, distance


class _Matching:
    """Who was matched with what: the state of an optimisation."""

    def __init__(self, space: Space, views: list[View], atlas: Atlas) -> None:
        self.space, self.views, self.atlas = space, views, atlas
        count = len(space.cells)
        self.matches = np.full((len(views), count), -1, np.int32)
        self.weights = np.zeros((len(views), count), np.float32)
        self.gates = [voxel_gate(space, v.kind) for v in views]
        self.libraries = [make_library(atlas, f, g) for f, g in enumerate(self.gates)]
        self.uprights = [_uprightness(space, v) for v in views]
        self.used = [np.ones(b - a) for a, b in atlas.spans]

    def match(self, rgb: NDArray[np.float32], iteration: int, rng: np.random.Generator, progress: Progress) -> None:
        """Finds an exemplar patch for one in `THIN` voxels of every plane of every family."""
        cells = self.space.cells.astype(np.int64)
        lattice = (cells[:, 0] + 2 * cells[:, 1] + 3 * cells[:, 2] + iteration) % THIN == 0
        self.matches[:] = -1
        for f, (view, library) in enumerate(zip(self.views, self.libraries, strict=True)):
            rows = np.flatnonzero(lattice & (self.uprights[f] > 0.02))
            rows = rng.permutation(rows)
            start, stop = self.atlas.spans[f]
            expected = _expected(self.atlas.gate[start:stop], self.gates[f][rows])
            used, before = np.zeros(stop - start), self.used[f]
            for n, part in enumerate(np.array_split(rows, CHUNKS)):
                done = n / CHUNKS
                share = (used + (1 - done) * before * expected) / expected
                price = (LAMBDA * np.maximum(share - 0.5, 0)).astype(np.float32)
                best, distance = _find(
                    rgb, self.space, view, self.atlas, library, part, self.gates[f][part], price, f, library.lists[part]
                )
                used += np.bincount(best, minlength=stop - start)
                self.matches[f, part] = best + start
                self.weights[f, part] = self.uprights[f][part] * np.exp(-distance / TAU) + 1e-8
                progress((f + (n + 1) / CHUNKS) / len(self.views))
            self.used[f] = used / expected

    def vote(self, rgb: NDArray[np.float32], sigma: float, progress: Progress) -> None:
        """Every voxel takes the mode of the votes around it, in place."""
        reach = 2
        grid = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
        squares = (grid**2).sum(1)
        near = squares <= (6 if sigma > 1 else 4)
        offsets, falloff = grid[near].astype(np.int16), np.exp(-squares[near] / (2 * sigma**2)).astype(np.float32)
        count = len(self.space.cells)
        for n in range(8):
            gather_votes(
                rgb,
                self.space.cells,
                self.space.number,
                offsets,
                falloff,
                self.matches,
                self.weights,
                np.array([v.kind for v in self.views], np.int64),
                np.stack([v.basis for v in self.views]).astype(np.float32),
                self.space.centre,
                self.atlas.colours,
                self.atlas.images,
                self.atlas.image,
                self.atlas.xy,
                self.atlas.ab,
                WIDTHS,
                count * n // 8,
                count * (n + 1) // 8,
            )
            progress((n + 1) / 8)
        self.space.fill(rgb)


def _expected(pixels: NDArray[np.float32], queries: NDArray[np.float32]) -> NDArray[np.float64]:
    """(P,). How often each exemplar pixel should be used: queries over pixels around it in gate space."""
    top = np.maximum(pixels.max(0), queries.max(0))
    shape = tuple((np.floor(top).astype(int) + 2).tolist())

    def histogram(gate: NDArray[np.float32]) -> NDArray[np.float64]:
        flat = np.ravel_multi_index(tuple(np.floor(gate).astype(int).T), shape)
        return np.bincount(flat, minlength=int(np.prod(shape))).reshape(shape).astype(float)

    from scipy import ndimage

    have, want = histogram(pixels), histogram(queries)
    ratio = ndimage.uniform_filter(want, 3, mode="constant") / np.maximum(
        ndimage.uniform_filter(have, 3, mode="constant"), 1e-9
    )
    at = np.floor(pixels).astype(int)
    return np.maximum(ratio[at[:, 0], at[:, 1], at[:, 2]], 1e-3)


def _uprightness(space: Space, view: View) -> NDArray[np.float32]:
    """(N,). Near the skin: how upright it stands on the family's planes; deeper 1 (DESIGN 5.1, step 6)."""
    if view.kind == POLAR:
        along = space.normal[:, 2]
    elif view.kind == RADIAL:
        r = np.maximum(space.radius, 1e-3)
        along = (-space.planar[:, 1] * space.normal[:, 0] + space.planar[:, 0] * space.normal[:, 1]) / r
    else:
        along = space.normal @ (space.basis @ view.basis[2])
    near = np.exp(-space.depth / 0.15)
    return (1 - near * np.clip(along, -1, 1) ** 2).astype(np.float32)
