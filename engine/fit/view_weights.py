"""Frozen geometry: a view as a sparse matrix, picture = W colours.

While only colours are trained, a view needs its geometry only once. `ViewWeights` is exact: it gives what
`opaque.render` gives, up to float32 rounding. `ViewWeights.truncated` keeps the largest entries of each pixel and is an
approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from engine.fit.view_kernels import (
    ROWS,
    apply,
    apply_transposed,
    count_splats,
    fill_faces,
    fill_shares,
    fill_splats,
    mark_columns,
    renumber,
    truncate,
    weigh_faces,
)
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.outside import camera_planes, directions, draw, splats_of, view_colours
from engine.render.cpu.ray_entry import Hits, coverage, enter
from engine.render.projection import camera_record
from engine.scene import sh as harmonics
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import for_each

__all__ = ["ViewWeights"]

Float = NDArray[np.float32]

BANDS = 4
"""Parts of a picture whose gradients are summed separately, then added up. Fixed, so that the number of threads does
not change the bits."""


@dataclass(frozen=True)
class ViewWeights:
    """The matrix W of a view, (P, C), with P = H W pixels and a column per colour. Rows sum to alpha."""

    height: int
    width: int
    columns: int
    """C. The atoms, surface before interior, then once more the S surface atoms for their colours on cut faces."""
    surface_count: int
    """S. Columns 0..S-1 are the surface atoms from outside, C-S..C-1 the same on cut faces."""
    offsets: NDArray[np.int64]
    """(P + 1,). Where the entries of each pixel begin."""
    used: NDArray[np.int32]
    """(V,). Columns with entries, ascending."""
    atoms: NDArray[np.int32]
    """(E,). Indices into `used`."""
    weights: Float
    """(E,). Range [0, 1]."""
    alpha: Float
    """(P,). How much of each pixel is covered. Range [0, 1]."""
    directions: Float
    """(U, 3). Unit directions, eye to atom, of the used columns below S."""

    @staticmethod
    def surface(
        atoms: Atoms, camera: Camera, planes: Sequence[Plane] = (), field: KernelField | None = None
    ) -> ViewWeights:
        """The view that `opaque.render` draws, unlit: the outside and, given planes, the cut faces."""
        piece = Piece(tuple(planes))
        outside = draw(splats_of(atoms), [view_colours(atoms, camera)], camera, [piece], atoms.pitch)
        cover = outside.resolved()[1]
        faces = _faces(atoms, camera, planes, field) if planes else None
        left = np.ones_like(cover)
        if faces is not None:
            left.reshape(-1)[faces.hits.pixels] -= faces.alpha
        shares = np.empty((*cover.shape, 3), np.float32)
        for_each(fill_shares, len(cover), outside.sums, left, shares)
        count = np.zeros(cover.shape, np.int64)
        for_each(count_splats, outside.tasks, outside.tiled, outside.front, shares, count)
        counted = count.reshape(-1)
        if faces is not None:
            counted[faces.hits.pixels] += faces.counts
        offsets = np.concatenate([[0], np.cumsum(counted)])
        entries, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        cursor = offsets[:-1].reshape(cover.shape).copy()
        for_each(fill_splats, outside.tasks, outside.tiled, outside.front, shares, cursor, entries, weights)
        if faces is not None:
            faces.fill(cursor.reshape(-1), entries, weights)
        alpha = (1 - left * (1 - cover)).reshape(-1)
        return _drop_unused_columns(atoms, camera, offsets, entries, weights, alpha)

    @staticmethod
    def section(atoms: Atoms, plane: Plane, camera: Camera, field: KernelField | None = None) -> ViewWeights:
        """Only the cut face on a plane, from either side: the kernel field; pixels outside the solid are empty."""
        towards = float(np.dot(plane.normal, camera.forward))
        faces = _faces(atoms, camera, [plane if towards <= 0 else plane.flipped()], field)
        alpha = np.zeros(camera.height * camera.width, np.float32)
        alpha[faces.hits.pixels] = faces.alpha
        count = np.zeros(len(alpha), np.int64)
        count[faces.hits.pixels] = faces.counts
        offsets = np.concatenate([[0], np.cumsum(count)])
        entries, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        faces.fill(offsets[:-1].copy(), entries, weights)
        return _drop_unused_columns(atoms, camera, offsets, entries, weights, alpha)

    @property
    def pixels(self) -> NDArray[np.bool_]:
        """(P,). Pixels that are not empty."""
        return self.alpha > 0

    def truncated(self, keep: int) -> ViewWeights:
        """The `keep` largest entries of each pixel, scaled to the row's sum: an approximation to train with, not to
        report from."""
        assert keep >= 1, keep
        offsets = np.concatenate([[0], np.cumsum(np.minimum(np.diff(self.offsets), keep))])
        atoms, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        tasks = -(-len(self.alpha) // ROWS)
        for_each(truncate, tasks, self.offsets, self.atoms, self.weights, keep, offsets, atoms, weights)
        return replace(self, offsets=offsets, atoms=atoms, weights=weights)

    def apply(self, colours: NDArray[np.floating]) -> Float:
        """(H, W, 3) = W colours (C, 3): weighted by alpha, over black."""
        assert colours.shape == (self.columns, 3), colours.shape
        return self.apply_used(colours[self.used].astype(np.float32, copy=False)).reshape(self.height, self.width, 3)

    def apply_transposed(self, picture: NDArray[np.floating]) -> Float:
        """(C, 3) = W^T picture (H, W, 3) or (P, 3)."""
        colours = np.zeros((self.columns, 3), np.float32)
        colours[self.used] = self.apply_transposed_used(np.ascontiguousarray(picture.reshape(-1, 3), np.float32))
        return colours

    def picture(
        self,
        coefficients: torch.Tensor,  # [S, K, 3] spherical harmonics of the surface atoms
        rgb: torch.Tensor,  # [I, 3] of the interior atoms
        background: Sequence[float] | torch.Tensor = (1.0, 1.0, 1.0),
    ) -> torch.Tensor:
        """(H, W, 3). The picture of `opaque.render` with these colours, differentiable in both."""
        used, interior = self.used, self.columns - self.surface_count
        outside, face = used[used < self.surface_count], used[used >= interior] - interior
        inside = used[(used >= self.surface_count) & (used < interior)] - self.surface_count
        degree = round(coefficients.shape[1] ** 0.5) - 1
        basis = torch.from_numpy(harmonics.basis(self.directions, degree).astype(np.float32))
        surface = 0.5 + torch.einsum("nk,nkc->nc", basis, _Rows.apply(coefficients, outside))
        on_faces = 0.5 + harmonics.C0 * _Rows.apply(coefficients, face)[:, 0]
        colours = torch.cat([surface.clamp(min=0), _Rows.apply(rgb, inside), on_faces.clamp(min=0)])
        product = _Product.apply(colours, self)
        uncovered = torch.from_numpy(1 - self.alpha)[:, None]
        over = product + uncovered * torch.as_tensor(background, dtype=torch.float32)
        return over.reshape(self.height, self.width, 3)

    def colours(self, atoms: Atoms) -> Float:
        """(C, 3). The colour of each column."""
        base = harmonics.sh_to_rgb(atoms.surface.sh[:, 0])
        surface = base.copy()
        outside = self.used[self.used < self.surface_count]
        surface[outside] = harmonics.colours(atoms.surface.sh[outside], self.directions)
        return np.concatenate([surface, atoms.interior.rgb, base]).astype(np.float32)

    def apply_used(self, colours: Float) -> Float:
        """(P, 3) = W times the colours (V, 3) of the used columns."""
        picture = np.empty((len(self.alpha), 3), np.float32)
        tasks = -(-len(self.alpha) // ROWS)
        for_each(apply, tasks, self.offsets, self.atoms, self.weights, np.ascontiguousarray(colours), picture)
        return picture

    def apply_transposed_used(self, picture: Float) -> Float:
        """(V, 3). The used rows of W^T times a picture (P, 3)."""
        parts = np.empty((BANDS, len(self.used), 3), np.float32)
        for_each(apply_transposed, BANDS, self.offsets, self.atoms, self.weights, picture, parts)
        return parts.sum(0)


@dataclass(frozen=True)
class _Faces:
    """The matrix rows of face pixels, before they join those of the outside."""

    hits: Hits
    alpha: Float  # [K]
    mass: Float  # [K] sum of the weights
    offsets: NDArray[np.int64]  # [K + 1]
    atoms: NDArray[np.int32]
    weights: Float

    @property
    def counts(self) -> NDArray[np.int64]:
        """(K,). Entries of each pixel; 0 for an empty one."""
        return np.where(self.alpha > 0, np.diff(self.offsets), 0)

    def fill(self, cursor: NDArray[np.int64], atoms: NDArray[np.int32], weights: Float) -> None:
        """Writes the entries at cursor (P,)."""
        share = self.alpha / np.where(self.mass > 0, self.mass, 1)
        for_each(
            fill_faces, -(-len(share) // ROWS), self.hits.pixels, self.offsets, self.atoms, self.weights,
            share.astype(np.float32), cursor, atoms, weights,
        )  # fmt: skip


def _faces(atoms: Atoms, camera: Camera, planes: Sequence[Plane], field: KernelField | None) -> _Faces:
    """The terms of the kernel field on cut faces; surface atoms take their columns for cut faces."""
    field = field or KernelField(atoms)
    hits = enter(camera_record(camera), camera_planes(camera, planes))
    if camera.orthographic and len(planes) == 1 and len(hits.pixels) == camera.height * camera.width:
        grid = hits.points.reshape(camera.height, camera.width, 3)
        offsets, columns, weights = field.entries_on(grid, float(hits.footprint[0]))
    else:
        offsets, columns, weights = field.entries(hits.points, hits.footprint)
    density, mass = np.empty(len(hits.pixels), np.float32), np.empty(len(hits.pixels), np.float32)
    tasks = -(-len(density) // ROWS)
    for_each(weigh_faces, tasks, offsets, columns, len(atoms.surface), weights, density, mass)
    alpha = coverage(density, hits.footprint, atoms.pitch).astype(np.float32)
    columns[columns < len(atoms.surface)] += len(atoms)
    return _Faces(hits, alpha, mass, offsets, columns, weights)


def _drop_unused_columns(
    atoms: Atoms,
    camera: Camera,
    offsets: NDArray[np.int64],
    entries: NDArray[np.int32],
    weights: Float,
    alpha: Float,
) -> ViewWeights:
    """The view with its columns renumbered to those in use."""
    surface_count = len(atoms.surface)
    columns = len(atoms) + surface_count
    occurs = np.zeros(columns, bool)
    tasks = -(-len(alpha) // ROWS)
    for_each(mark_columns, tasks, offsets, entries, occurs)
    used = np.flatnonzero(occurs).astype(np.int32)
    place = np.zeros(columns, np.int32)
    place[used] = np.arange(len(used), dtype=np.int32)
    for_each(renumber, tasks, offsets, entries, place)
    viewing = np.ascontiguousarray(directions(atoms.surface.means[used[used < surface_count]], camera))
    return ViewWeights(
        camera.height, camera.width, columns, surface_count, offsets, used, entries, weights, alpha, viewing
    )


class _Rows(torch.autograd.Function):
    """tensor[rows] with rows (V,) ascending and distinct: the backward pass need not sort and add as torch's does."""

    @staticmethod
    def forward(context: Any, tensor: torch.Tensor, rows: NDArray[np.int32]) -> torch.Tensor:
        context.rows, context.shape, context.kind = rows, tensor.shape, tensor.dtype
        return torch.from_numpy(tensor.detach().numpy()[rows])

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        gradient = torch.zeros(context.shape, dtype=context.kind)
        gradient.numpy()[context.rows] = gradients[0].numpy()
        return gradient, None


class _Product(torch.autograd.Function):
    """W colours (V, 3), and its gradient by the transpose."""

    @staticmethod
    def forward(context: Any, colours: torch.Tensor, view: ViewWeights) -> torch.Tensor:
        context.view = view
        return torch.from_numpy(view.apply_used(colours.detach().float().numpy()))

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        view: ViewWeights = context.view
        return torch.from_numpy(view.apply_transposed_used(gradients[0].contiguous().float().numpy())), None
