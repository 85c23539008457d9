"""Frozen geometry: a view as a sparse matrix, picture = W colours (DESIGN, sections 3 and 6).

While only colours are trained a view needs its geometry once. `ViewWeights` is exact: it gives what `opaque.render`
gives, to float32 rounding. `TruncatedViewWeights` keeps the largest entries of a pixel and is an approximation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from engine.errors import InputError
from engine.fit.view_kernels import (
    ROWS,
    apply,
    apply_transposed,
    count_splats,
    fill_faces,
    fill_splats,
    layer_limit,
    mark,
    rename,
    row_sums,
    truncate,
)
from engine.io.files import atomic
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.outside import camera_planes, directions, draw, splats_of, view_colours
from engine.render.cpu.ray_entry import Hits, coverage, enter
from engine.render.projection import camera_record
from engine.scene import sh as harmonics
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.constants import MIN_WEIGHT
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import for_each

__all__ = ["TruncatedViewWeights", "ViewWeights", "load"]

Float = NDArray[np.float32]

BANDS = 4
"""Parts of a picture whose gradients are summed apart and then together; fixed, so that threads do not matter."""


@dataclass(frozen=True)
class ViewWeights:
    """The matrix W of a view, (P, C): P = H W pixels; columns as `surface` and `section` say. Rows sum to alpha."""

    height: int
    width: int
    columns: int
    """C. M atoms, surface before interior; then S more, the colours of the surface atoms on cut faces."""
    skin: int
    """S. Surface atoms: columns 0..S-1 show them from outside, C-S..C-1 on faces."""
    offsets: NDArray[np.int64]
    """(P + 1,). Where the entries of each pixel begin."""
    used: NDArray[np.int32]
    """(V,). Columns that have entries, ascending."""
    atoms: NDArray[np.int32]
    """(E,). Places in `used`."""
    weights: Float
    """(E,). Range [0, 1]."""
    alpha: Float
    """(P,). How much of each pixel is covered. Range [0, 1]."""
    directions: Float
    """(U, 3). Unit, eye to atom, of the used columns under S."""

    @staticmethod
    def surface(
        atoms: Atoms, camera: Camera, planes: Sequence[Plane] = (), field: KernelField | None = None
    ) -> ViewWeights:
        """The opaque view that `opaque.render` draws (without light): the outside and, given planes, the cut faces."""
        piece = Piece(tuple(planes))
        outside = draw(splats_of(atoms), [view_colours(atoms, camera)], camera, [piece], atoms.pitch)
        cover = outside.resolved()[1]
        weight = outside.sums[..., 0]
        faces = _faces(atoms, camera, planes, field) if planes else None
        left = np.ones_like(cover)
        if faces is not None:
            left.reshape(-1)[faces.hits.pixels] -= faces.alpha
        share = np.where(weight > MIN_WEIGHT, left * cover / np.maximum(weight, MIN_WEIGHT), 0).astype(np.float32)
        limit = layer_limit(outside.front, outside.tiled.layer)
        count = np.zeros(cover.shape, np.int64)
        for_each(count_splats, outside.tasks, outside.tiled, limit, share, count)
        counted = count.reshape(-1)
        if faces is not None:
            counted[faces.hits.pixels] += faces.counts
        offsets = np.concatenate([[0], np.cumsum(counted)])
        entries, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        cursor = offsets[:-1].reshape(cover.shape).copy()
        for_each(fill_splats, outside.tasks, outside.tiled, limit, share, cursor, entries, weights)
        if faces is not None:
            faces.fill(cursor.reshape(-1), entries, weights)
        alpha = (1 - left * (1 - cover)).reshape(-1)
        return _packed(atoms, camera, offsets, entries, weights, alpha)

    @staticmethod
    def section(atoms: Atoms, plane: Plane, camera: Camera, field: KernelField | None = None) -> ViewWeights:
        """The face on a plane alone, seen from either side: the kernel field; pixels outside of the solid are empty."""
        towards = float(np.dot(plane.normal, camera.forward))
        faces = _faces(atoms, camera, [plane if towards <= 0 else plane.flipped()], field)
        alpha = np.zeros(camera.height * camera.width, np.float32)
        alpha[faces.hits.pixels] = faces.alpha
        count = np.zeros(len(alpha), np.int64)
        count[faces.hits.pixels] = faces.counts
        offsets = np.concatenate([[0], np.cumsum(count)])
        entries, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        faces.fill(offsets[:-1].copy(), entries, weights)
        return _packed(atoms, camera, offsets, entries, weights, alpha)

    @property
    def exact(self) -> bool:
        """Whether the pictures are those of the full renderer."""
        return True

    @property
    def pixels(self) -> NDArray[np.bool_]:
        """(P,). Pixels that show something."""
        return self.alpha > 0

    def truncated(self, keep: int) -> TruncatedViewWeights:
        """The approximation by the `keep` largest entries of each pixel, which are scaled to the row's sum."""
        assert keep >= 1, keep
        offsets = np.concatenate([[0], np.cumsum(np.minimum(np.diff(self.offsets), keep))])
        atoms, weights = np.empty(offsets[-1], np.int32), np.empty(offsets[-1], np.float32)
        tasks = -(-len(self.alpha) // ROWS)
        for_each(truncate, tasks, self.offsets, self.atoms, self.weights, keep, offsets, atoms, weights)
        short = {"offsets": offsets, "atoms": atoms, "weights": weights, "keep": keep}
        return TruncatedViewWeights(**(vars(self) | short))

    def apply(self, colours: NDArray[np.floating]) -> Float:
        """(H, W, 3) = W colours (C, 3): weighted by alpha, over black."""
        assert colours.shape == (self.columns, 3), colours.shape
        return self._forward(colours[self.used].astype(np.float32, copy=False)).reshape(self.height, self.width, 3)

    def apply_transposed(self, picture: NDArray[np.floating]) -> Float:
        """(C, 3) = W^T picture (H, W, 3) or (P, 3)."""
        colours = np.zeros((self.columns, 3), np.float32)
        colours[self.used] = self._backward(np.ascontiguousarray(picture.reshape(-1, 3), np.float32))
        return colours

    def matmul(self, colours: torch.Tensor) -> torch.Tensor:
        """(P, 3) = W colours (C, 3), differentiable; float32."""
        assert colours.shape == (self.columns, 3), colours.shape
        return _Product.apply(_Rows.apply(colours, self.used), self)

    def picture(
        self,
        coefficients: torch.Tensor,  # [S, K, 3] spherical harmonics of the surface atoms
        rgb: torch.Tensor,  # [I, 3] of the interior atoms
        background: Sequence[float] | torch.Tensor = (1.0, 1.0, 1.0),
    ) -> torch.Tensor:
        """(H, W, 3). What `opaque.render` shows with these colours, differentiable in both."""
        used, interior = self.used, self.columns - self.skin
        outside, face = used[used < self.skin], used[used >= interior] - interior
        inside = used[(used >= self.skin) & (used < interior)] - self.skin
        degree = round(coefficients.shape[1] ** 0.5) - 1
        basis = torch.from_numpy(harmonics.basis(self.directions, degree).astype(np.float32))
        seen = 0.5 + torch.einsum("nk,nkc->nc", basis, _Rows.apply(coefficients, outside))
        skin = 0.5 + harmonics.C0 * _Rows.apply(coefficients, face)[:, 0]
        colours = torch.cat([seen.clamp(min=0), _Rows.apply(rgb, inside), skin.clamp(min=0)])
        product = _Product.apply(colours, self)
        uncovered = torch.from_numpy(1 - self.alpha)[:, None]
        over = product + uncovered * torch.as_tensor(background, dtype=torch.float32)
        return over.reshape(self.height, self.width, 3)

    def colours(self, atoms: Atoms) -> Float:
        """(C, 3). The colours that the columns stand for."""
        base = harmonics.sh_to_rgb(atoms.surface.sh[:, 0])
        seen = base.copy()
        outside = self.used[self.used < self.skin]
        seen[outside] = harmonics.colours(atoms.surface.sh[outside], self.directions)
        return np.concatenate([seen, atoms.interior.rgb, base]).astype(np.float32)

    def save(self, path: str | Path) -> None:
        """Writes a .safetensors file. Raises InputError where it cannot."""
        arrays = {name: getattr(self, name) for name in ARRAYS}
        sizes = {name: str(getattr(self, name)) for name in SIZES} | {"keep": str(getattr(self, "keep", 0))}
        with atomic(path) as temporary:
            save_file(arrays, temporary, sizes)

    def _forward(self, colours: Float) -> Float:
        picture = np.empty((len(self.alpha), 3), np.float32)
        tasks = -(-len(self.alpha) // ROWS)
        for_each(apply, tasks, self.offsets, self.atoms, self.weights, np.ascontiguousarray(colours), picture)
        return picture

    def _backward(self, picture: Float) -> Float:
        parts = np.empty((BANDS, len(self.used), 3), np.float32)
        for_each(apply_transposed, BANDS, self.offsets, self.atoms, self.weights, picture, parts)
        return parts.sum(0)


@dataclass(frozen=True)
class TruncatedViewWeights(ViewWeights):
    """W with the `keep` largest entries of each pixel only: to train with, never to report from."""

    keep: int

    @property
    def exact(self) -> bool:
        return False


SIZES = ("height", "width", "columns", "skin")
ARRAYS = ("offsets", "used", "atoms", "weights", "alpha", "directions")


def load(path: str | Path) -> ViewWeights:
    """What `ViewWeights.save` wrote, exact or truncated. Raises InputError for any other file."""
    try:
        with safe_open(path, "numpy") as file:
            told = file.metadata() or {}
            sizes = [int(told[name]) for name in SIZES]
            keep = int(told["keep"])
            arrays = [file.get_tensor(name) for name in ARRAYS]
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise InputError(f"{path}: not the weights of a view ({error}); build them again") from error
    height, width, columns, skin = sizes
    offsets, used, atoms, weights, alpha, directions = arrays
    sound = (
        len(offsets) == height * width + 1 == len(alpha) + 1
        and offsets[0] == 0
        and bool((np.diff(offsets) >= 0).all())
        and offsets[-1] == len(atoms) == len(weights)
        and directions.shape == (int((used < skin).sum()), 3)
        and (not len(atoms) or 0 <= atoms.min() <= atoms.max() < len(used))
        and (not len(used) or 0 <= used.min() <= used.max() < columns)
    )
    if not sound:
        raise InputError(f"{path}: the weights of this view do not fit together; build them again")
    exact = ViewWeights(height, width, columns, skin, offsets, used, atoms, weights, alpha, directions)
    return TruncatedViewWeights(**vars(exact), keep=keep) if keep else exact


@dataclass(frozen=True)
class _Faces:
    """The rows of face pixels, before they are put among the others."""

    hits: Hits
    alpha: Float  # [K]
    density: Float  # [K]
    offsets: NDArray[np.int64]  # [K + 1]
    atoms: NDArray[np.int32]
    weights: Float

    @property
    def counts(self) -> NDArray[np.int64]:
        """(K,). Entries of each pixel; none where it is empty."""
        return np.where(self.alpha > 0, np.diff(self.offsets), 0)

    def fill(self, cursor: NDArray[np.int64], atoms: NDArray[np.int32], weights: Float) -> None:
        """Writes the entries at cursor (P,)."""
        share = self.alpha / np.where(self.density > 0, self.density, 1)
        for_each(
            fill_faces, -(-len(share) // ROWS), self.hits.pixels, self.offsets, self.atoms, self.weights,
            share.astype(np.float32), cursor, atoms, weights,
        )  # fmt: skip


def _faces(atoms: Atoms, camera: Camera, planes: Sequence[Plane], field: KernelField | None) -> _Faces:
    """The terms of the kernel field on cut faces; a surface atom's column is that of its colour on faces."""
    field = field or KernelField(atoms)
    hits = enter(camera_record(camera), camera_planes(camera, planes))
    if camera.orthographic and len(planes) == 1 and len(hits.pixels) == camera.height * camera.width:
        grid = hits.points.reshape(camera.height, camera.width, 3)
        offsets, columns, weights = field.entries_on(grid, float(hits.footprint[0]))
    else:
        offsets, columns, weights = field.entries(hits.points, hits.footprint)
    density = np.empty(len(hits.pixels), np.float32)
    for_each(row_sums, -(-len(density) // ROWS), offsets, weights, density)
    alpha = coverage(density, hits.footprint, atoms.pitch).astype(np.float32)
    columns[columns < len(atoms.surface)] += len(atoms)
    return _Faces(hits, alpha, density, offsets, columns, weights)


def _packed(
    atoms: Atoms,
    camera: Camera,
    offsets: NDArray[np.int64],
    entries: NDArray[np.int32],
    weights: Float,
    alpha: Float,
) -> ViewWeights:
    """Leaves out the columns without entries."""
    skin = len(atoms.surface)
    columns = len(atoms) + skin
    occurs = np.zeros(columns, bool)
    tasks = -(-len(alpha) // ROWS)
    for_each(mark, tasks, offsets, entries, occurs)
    used = np.flatnonzero(occurs).astype(np.int32)
    place = np.zeros(columns, np.int32)
    place[used] = np.arange(len(used), dtype=np.int32)
    for_each(rename, tasks, offsets, entries, place)
    way = np.ascontiguousarray(directions(atoms.surface.means[used[used < skin]], camera))
    return ViewWeights(camera.height, camera.width, columns, skin, offsets, used, entries, weights, alpha, way)


class _Rows(torch.autograd.Function):
    """tensor[rows] with rows (V,) ascending: none twice, so the way back need not add (torch's sorts and adds)."""

    @staticmethod
    def forward(context: Any, tensor: torch.Tensor, rows: NDArray[np.int32]) -> torch.Tensor:
        context.rows, context.shape, context.kind = rows, tensor.shape, tensor.dtype
        return torch.from_numpy(tensor.detach().numpy()[rows])

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        whole = torch.zeros(context.shape, dtype=context.kind)
        whole.numpy()[context.rows] = gradients[0].numpy()
        return whole, None


class _Product(torch.autograd.Function):
    """W colours and its transpose."""

    @staticmethod
    def forward(context: Any, colours: torch.Tensor, view: ViewWeights) -> torch.Tensor:
        context.view = view
        return torch.from_numpy(view._forward(colours.detach().float().numpy()))

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor, None]:
        view: ViewWeights = context.view
        return torch.from_numpy(view._backward(gradients[0].contiguous().float().numpy())), None
