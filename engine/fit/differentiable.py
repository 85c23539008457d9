"""The opaque image as a torch function, differentiable in the colours, means, scales and quaternions of the atoms.

Discrete choices have no derivative: the front depth, which atoms lie in the layer behind it, what planes clip, and
which atoms reach a face point are constants in the backward pass. Away from these jumps the gradient is exact.
Float32, or float64 for checking.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from engine.fit.face_kernels import POINTS, FieldAtoms, FieldPoints, field_backward, field_sums, transpose
from engine.fit.harmonics import harmonic_colours
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.outside import Outside, camera_planes, draw
from engine.render.cpu.ray_entry import covered_part, enter, face_edge
from engine.render.cpu.splats import GRADIENT, Splats, project_backward
from engine.render.cpu.tiles import CHUNKS, accumulate_backward
from engine.render.cpu.weights import resolve_backward
from engine.render.projection import camera_record
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.camera import Camera
from engine.scene.constants import FILLED_DENSITY
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.scene.sh import C0
from engine.threads import for_each

__all__ = ["AtomTensors", "opaque_image"]


@dataclass(frozen=True)
class AtomTensors:
    """Atoms as torch tensors of one float type; those to be trained require a gradient."""

    means: torch.Tensor
    """(S, 3). Surface atoms, world units."""
    scales: torch.Tensor
    """(S, 3). Standard deviations, world units. Range (0, inf)."""
    quats: torch.Tensor
    """(S, 4). wxyz, of any length; they are normalised."""
    sh: torch.Tensor
    """(S, (d+1)^2, 3). Degree d = 0..3."""
    interior_means: torch.Tensor
    """(I, 3). Interior atoms."""
    sigmas: torch.Tensor
    """(I,). Standard deviations, world units."""
    rgb: torch.Tensor
    """(I, 3). Range [0, 1]."""
    pitch: float
    """World units."""

    @staticmethod
    def of(atoms: Atoms, kind: torch.dtype = torch.float32) -> AtomTensors:
        """Copies of the arrays, without gradients."""
        s, i = atoms.surface, atoms.interior

        def tensor(array: NDArray[np.float32]) -> torch.Tensor:
            return torch.tensor(array, dtype=kind)

        interior = tensor(i.means), tensor(i.sigmas), tensor(i.rgb)
        return AtomTensors(tensor(s.means), tensor(s.scales), tensor(s.quats), tensor(s.sh), *interior, atoms.pitch)

    def atoms(self) -> Atoms:
        """The atoms as float32 arrays."""
        means, scales, quats, sh, interior_means, sigmas, rgb = (
            t.detach().float().numpy()
            for t in (self.means, self.scales, self.quats, self.sh, self.interior_means, self.sigmas, self.rgb)
        )
        return Atoms(SurfaceAtoms(means, scales, quats, sh), InteriorAtoms(interior_means, sigmas, rgb), self.pitch)


def opaque_image(
    atoms: AtomTensors,
    camera: Camera,
    planes: Sequence[Plane] = (),
    background: Sequence[float] = (1.0, 1.0, 1.0),
) -> tuple[torch.Tensor, torch.Tensor]:
    """RGB (H, W, 3) and alpha (H, W) of the atoms cut by the planes: a differentiable `opaque.render`."""
    kind = atoms.means.dtype
    colours = harmonic_colours(atoms.means, atoms.sh, camera)
    outside, cover = _Outside.apply(atoms.means, atoms.scales, atoms.quats, colours, camera, tuple(planes), atoms.pitch)
    over = outside + (1 - cover)[..., None] * torch.tensor(background, dtype=kind)
    if not planes:
        return over, cover
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=kind).repeat(len(atoms.sigmas), 1)
    means = torch.cat([atoms.means, atoms.interior_means])
    scales = torch.cat([atoms.scales, atoms.sigmas[:, None].expand(-1, 3)])
    quats = torch.cat([atoms.quats, identity])
    skin = (0.5 + C0 * atoms.sh[:, 0]).clamp(min=0)
    face, alpha = _face(means, scales, quats, torch.cat([skin, atoms.rgb]), atoms, camera, planes)
    return face + (1 - alpha)[..., None] * over, 1 - (1 - alpha) * (1 - cover)


def _face(
    means: torch.Tensor,
    scales: torch.Tensor,
    quats: torch.Tensor,
    colours: torch.Tensor,
    atoms: AtomTensors,
    camera: Camera,
    planes: Sequence[Plane],
) -> tuple[torch.Tensor, torch.Tensor]:
    """RGB (H, W, 3) of the cut faces, weighted by alpha, and alpha (H, W)."""
    kind = means.dtype
    hits = enter(camera_record(camera), camera_planes(camera, planes))
    offsets, listed, _ = KernelField(atoms.atoms()).entries(hits.points, hits.footprint)
    footprint = torch.from_numpy(hits.footprint).to(kind)
    points = hits.points.astype(means.detach().numpy().dtype)
    sums = []
    for of_kind in (listed >= len(atoms.means), listed < len(atoms.means)):  # the interior's, the skin's
        some = np.concatenate([[0], np.cumsum(of_kind)])[offsets]
        least = (0.5 * footprint).numpy()
        sums += _Field.apply(means, scales, quats, colours, points, least, some, listed[of_kind])
    total, interior, skin_total, skin = sums
    density = interior + skin
    part = (1 - interior / FILLED_DENSITY).clamp(min=0)  # as `skin_part`
    total, mass = total + part[:, None] * skin_total, interior + part * skin
    edge = torch.from_numpy(face_edge(footprint.numpy(), atoms.pitch))
    covered = covered_part(density, edge)
    rgb = total * (covered / torch.where(mass > 0, mass, torch.ones_like(mass)))[:, None]
    pixels = torch.from_numpy(hits.pixels)
    size = camera.height * camera.width
    face = torch.zeros(size, 3, dtype=kind).index_copy(0, pixels, rgb)
    alpha = torch.zeros(size, dtype=kind).index_copy(0, pixels, covered)
    return face.view(camera.height, camera.width, 3), alpha.view(camera.height, camera.width)


class _Outside(torch.autograd.Function):
    """Surface splatting: RGB weighted by alpha, and alpha."""

    @staticmethod
    def forward(
        context: Any,
        means: torch.Tensor,
        scales: torch.Tensor,
        quats: torch.Tensor,
        colours: torch.Tensor,
        camera: Camera,
        planes: tuple[Plane, ...],
        pitch: float,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        m, s, q, c = (t.detach().contiguous().numpy() for t in (means, scales, quats, colours))
        context.splats, context.colours, context.camera = Splats(m, s, q), c, camera
        context.outside = draw(context.splats, [c], camera, [Piece(planes)], pitch)
        rgb, alpha = context.outside.resolved()
        return torch.from_numpy(rgb), torch.from_numpy(alpha)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        outside: Outside = context.outside
        splats: Splats = context.splats
        d_rgb, d_alpha = (g.contiguous().numpy() for g in gradients)
        d_sums = np.empty_like(outside.sums)
        for_each(resolve_backward, len(d_alpha), outside.sums, d_rgb, d_alpha, d_sums)
        spans, count = outside.tiled.spans, len(splats.means)
        tiles = (spans[:, 1] - spans[:, 0]).astype(np.int64) * (spans[:, 3] - spans[:, 2])
        first = np.concatenate([np.zeros(1, np.int64), np.cumsum(tiles)])
        rows = np.zeros((first[-1], GRADIENT), outside.sums.dtype)
        for_each(accumulate_backward, outside.tasks, outside.tiled, context.colours, outside.front, d_sums, first, rows)
        out = [np.empty((count, n), outside.sums.dtype) for n in (3, 3, 4, 3)]
        d_splats = Splats(*out[:3])
        for_each(
            project_backward, CHUNKS, -(-count // CHUNKS), outside.tiled.cam, splats, first, rows, d_splats, out[3],
        )  # fmt: skip
        return (*(torch.from_numpy(o) for o in out), None, None, None)


class _Field(torch.autograd.Function):
    """The sums of the kernel field at fixed points over fixed lists of atoms: sum w c (K, 3) and sum w (K,)."""

    @staticmethod
    def forward(
        context: Any,
        means: torch.Tensor,
        scales: torch.Tensor,
        quats: torch.Tensor,
        colours: torch.Tensor,
        points: NDArray[np.floating],
        least: NDArray[np.floating],
        offsets: NDArray[np.int64],
        listed: NDArray[np.int32],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        atoms = FieldAtoms(*(t.detach().contiguous().numpy() for t in (means, scales, quats, colours)))
        at = FieldPoints(points, least)
        context.atoms, context.at, context.offsets, context.listed = atoms, at, offsets, listed
        total, density = np.empty_like(points), np.empty(len(points), points.dtype)
        for_each(field_sums, -(-len(points) // POINTS), at, offsets, listed, atoms, total, density)
        return torch.from_numpy(total), torch.from_numpy(density)

    @staticmethod
    def backward(context: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        d_total, d_density = (g.contiguous().numpy() for g in gradients)
        count = len(context.atoms.means)
        first, entries = transpose(context.offsets, context.listed, count)
        out = FieldAtoms(*(np.empty_like(a) for a in context.atoms))
        tasks = -(-count // POINTS)
        for_each(field_backward, tasks, context.at, first, entries, context.atoms, d_total, d_density, out)
        return (*(torch.from_numpy(o) for o in out), None, None, None, None)
