"""Classic 3DGS on the CPU: sorted alpha compositing of EWA splats, forward and backward (DESIGN §3, §6).

It shows a capture as it came, makes the surface views that training follows, and is what accuracy is measured with.
Kerbl et al. 2023 with the constants of INRIA's renderer: 0.3 px^2 low-pass, alpha at most 0.99, alpha under 1/255
left out, a pixel ends where less than 1e-4 of the light would be left. Every pixel where alpha reaches 1/255 is drawn,
so the picture does not depend on how it is cut into tiles.

A frame: order by depth; then, slice by slice from the front, project what may still be seen, list it per tile,
composite. Tiles that have become opaque close, and what lies behind them is never projected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from engine.render.classic.blend import ADJOINT, BLOCK, ROW, STATE, UNTOUCHED, blend, blend_backward, resolve
from engine.render.classic.depth_order import depth_order
from engine.render.classic.splats import RECORD, project, project_backward
from engine.render.classic.tiles import BLOCKS, SIDE, list_pairs, place_pairs, sort_pairs, sum_open
from engine.render.projection import CameraRecord, camera_record
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.image import Picture
from engine.threads import for_each

__all__ = ["rasterize", "render"]

SLICES = 16
"""Slices of a large scene: enough for the front ones to hide most of the rest, few enough that each fills the cores."""

LEAST_SLICE = 1 << 15
"""Gaussians under which a slice costs more to set up than it can save."""

CHUNKS = 16
"""Tasks in a slice, unless they fall under"""

LEAST_CHUNK = 2048
"""Gaussians: a tenth of a millisecond's work, against some microseconds to call a kernel."""

TILES_PER_TASK = 24
"""Few enough that the last task of a small picture keeps nobody waiting."""

ROWS_PER_TASK = 4
"""Rows of tiles that are filled or read out in one task."""


LINE = 64
"""Bytes of a cache line, and of the widest vector."""


@dataclass(frozen=True)
class _Scene:
    """Parameters of one float type, contiguous."""

    means: NDArray[np.floating]  # [N, 3]
    scales: NDArray[np.floating]  # [N, 3]
    quats: NDArray[np.floating]  # [N, 4]
    opacities: NDArray[np.floating]  # [N]
    colours: NDArray[np.floating]  # [N, K, 3]
    plain: bool  # colours are RGB, K = 1; otherwise SH


@dataclass
class _Slice:
    """What the backward pass needs to know of one slice."""

    first: int
    chunk_size: int
    record_counts: NDArray[np.int64]  # [chunks]
    first_places: NDArray[np.int64]  # [chunks]
    tiles: NDArray[np.int64]  # [T]
    tile_starts: NDArray[np.int64]  # [tiles + 1]
    pair_codes: NDArray[np.int32]  # [pairs]
    pair_tiles: NDArray[np.int32]  # [most pairs]
    pair_rows: NDArray[np.int32]  # [pairs]


@dataclass
class _Frame:
    """A composited picture, still in tiles, and how it came about."""

    cam: CameraRecord
    eye: NDArray[np.float64]
    records: NDArray[np.floating]  # [V, RECORD]
    owners: NDArray[np.int32]  # [V]
    pair_counts: NDArray[np.int32]  # [V]
    states: NDArray[np.floating]  # [tiles, BLOCKS, STATE * BLOCK]
    lasts: NDArray[np.int32]  # [tiles, BLOCKS, BLOCK]
    tile_lasts: NDArray[np.int32]  # [tiles]
    size: tuple[int, int]  # width and height of the picture
    slices: list[_Slice] = field(default_factory=list)


def render(gaussians: Gaussians, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Picture:
    """The Gaussians seen by the camera over a background (3,); depth is the mean depth of what covers the pixel."""
    # Contiguous and writeable, so that the kernels that are compiled already fit.
    means, scales, quats, opacities, sh = (
        np.require(array, np.float32, ("C", "W"))
        for array in (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, gaussians.sh)
    )
    scene = _Scene(means, scales, quats, opacities, sh, plain=False)
    rgb, alpha, depth = _picture(_composite(scene, camera), camera, background)
    covered = alpha > 0
    depth[covered] /= alpha[covered]
    depth[~covered] = np.inf
    return Picture(rgb, alpha, depth)


def rasterize(
    means: torch.Tensor,  # [N, 3]
    scales: torch.Tensor,  # [N, 3]
    quats: torch.Tensor,  # [N, 4]
    opacities: torch.Tensor,  # [N]
    colours: torch.Tensor,  # [N, 3] RGB or [N, (d+1)^2, 3] SH
    camera: Camera,
    background: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(rgb (H, W, 3), alpha (H, W), depth times alpha (H, W)), differentiable in all five tensors.

    CPU tensors, all float32 or all float64, as `Gaussians` holds them; quaternions of any length, which is divided out
    (one of length 0 turns nothing). RGB is taken as it is; SH is evaluated towards the Gaussian and held at 0 from
    below. Means get the gradient of the view direction too. What is held or skipped passes no gradient on.
    """
    n, kind = len(means), means.dtype
    assert kind in (torch.float32, torch.float64), kind
    for tensor in (scales, quats, opacities, colours):
        assert tensor.dtype == kind, f"{tensor.dtype} beside {kind}"
        assert tensor.device.type == "cpu", tensor.device
    assert means.shape == scales.shape == (n, 3), (means.shape, scales.shape)
    assert quats.shape == (n, 4) and opacities.shape == (n,), (quats.shape, opacities.shape)
    assert colours.shape == (n, 3) or (colours.ndim == 3 and colours.shape[1] in (1, 4, 9, 16)), colours.shape
    return _Rasterize.apply(means, scales, quats, opacities, colours, camera, tuple(background))


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: torch.Tensor,
        scales: torch.Tensor,
        quats: torch.Tensor,
        opacities: torch.Tensor,
        colours: torch.Tensor,
        camera: Camera,
        background: tuple[float, ...],
    ) -> tuple[torch.Tensor, ...]:
        tensors = (means, scales, quats, opacities, colours)
        arrays = [tensor.detach().contiguous().numpy() for tensor in tensors]
        plain = colours.ndim == 2
        m, s, q, o, c = arrays
        scene = _Scene(m, s, q, o, c[:, None] if plain else c, plain)
        frame = _composite(scene, camera)
        ctx.save_for_backward(*tensors)  # notices if one is written to before the way back
        ctx.scene, ctx.frame, ctx.camera, ctx.background = scene, frame, camera, background
        # torch would fill a missing gradient with its own threads, which then keep a core busy looking for more work.
        ctx.set_materialize_grads(False)
        return tuple(torch.from_numpy(array) for array in _picture(frame, camera, background))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any, g_rgb: torch.Tensor | None, g_alpha: torch.Tensor | None, g_depth: torch.Tensor | None
    ) -> tuple[torch.Tensor | None, ...]:
        tensors = ctx.saved_tensors
        size, kind = (ctx.camera.height, ctx.camera.width), ctx.scene.means.dtype
        outer = [
            np.zeros(shape, kind) if gradient is None else gradient.contiguous().numpy()
            for gradient, shape in ((g_rgb, (*size, 3)), (g_alpha, size), (g_depth, size))
        ]
        gradients = _backward(ctx.scene, ctx.frame, ctx.background, outer)
        return (*(torch.from_numpy(g).view(t.shape) for g, t in zip(gradients, tensors, strict=True)), None, None)


def _backward(
    scene: _Scene, frame: _Frame, background: Sequence[float], outer: Sequence[NDArray[np.floating]]
) -> list[NDArray[np.floating]]:
    """Gradients of means, scales, quats, opacities and colours, given those of the picture (rgb, alpha, depth)."""
    kind = scene.means.dtype
    tiles_y, tiles_x = -(-outer[1].shape[0] // SIDE), -(-outer[1].shape[1] // SIDE)
    adjoints = _empty((tiles_y * tiles_x, BLOCKS, ADJOINT * BLOCK), kind)
    parameters = scene.means, scene.scales, scene.quats, scene.opacities, scene.colours
    ends = np.cumsum([array.size for array in parameters])
    flat = np.zeros(ends[-1], kind)
    gradients = [part.reshape(a.shape) for part, a in zip(np.split(flat, ends[:-1]), parameters, strict=True)]
    begun = np.zeros(tiles_y * tiles_x, np.uint8)
    behind = np.array(background, kind)
    deep = bool(outer[2].any())
    buffer = _empty((max((len(part.pair_tiles) for part in frame.slices), default=0), ROW), kind)
    for part in reversed(frame.slices):
        for_each(
            blend_backward, -(-len(part.tiles) // TILES_PER_TASK), TILES_PER_TASK, part.tiles, tiles_x,
            part.tile_starts, part.pair_codes, part.pair_rows, frame.records, frame.states, frame.lasts,
            frame.tile_lasts, behind, *outer, deep, begun, adjoints, buffer,
        )  # fmt: skip
        for_each(
            project_backward, len(part.record_counts), part.chunk_size, part.first, part.record_counts,
            frame.cam, frame.eye, *parameters, scene.plain, frame.records, frame.owners, frame.pair_counts,
            part.first_places, part.pair_tiles, frame.tile_lasts, buffer, *gradients,
        )  # fmt: skip
    return gradients


def _empty(shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """An array that begins with a cache line, so that a record or a vector of pixels fills whole lines."""
    size = math.prod(shape) * kind.itemsize
    raw = np.empty(size + LINE, np.uint8)
    start = -raw.__array_interface__["data"][0] % LINE
    return raw[start : start + size].view(kind).reshape(shape)


def _composite(scene: _Scene, camera: Camera) -> _Frame:
    kind = scene.means.dtype
    cam = camera_record(camera)
    tiles_x, tiles_y = -(-camera.width // SIDE), -(-camera.height // SIDE)
    order = depth_order(cam, scene.means)
    visible = len(order)
    frame = _Frame(
        cam,
        camera.position,
        _empty((visible, RECORD), kind),
        np.empty(visible, np.int32),
        np.empty(visible, np.int32),
        _empty((tiles_y * tiles_x, BLOCKS, STATE * BLOCK), kind),
        _empty((tiles_y * tiles_x, BLOCKS, BLOCK), np.dtype(np.int32)),
        np.full(tiles_y * tiles_x, UNTOUCHED, np.int32),
        (camera.width, camera.height),
    )
    open_tiles = np.ones((tiles_y, tiles_x), np.uint8)
    size = max(LEAST_SLICE, -(-visible // SLICES))
    for first in range(0, visible, size):
        if not open_tiles.any():
            break
        _composite_slice(scene, frame, order, first, min(first + size, visible), open_tiles)
    return frame


def _composite_slice(
    scene: _Scene, frame: _Frame, order: NDArray[np.int64], first: int, last: int, open_tiles: NDArray[np.uint8]
) -> None:
    tiles_y, tiles_x = open_tiles.shape
    chunk_size = max(LEAST_CHUNK, -(-(last - first) // CHUNKS))
    chunks = -(-(last - first) // chunk_size)
    open_sums = np.empty((tiles_y + 1, tiles_x + 1), np.int32)
    sum_open(open_tiles, open_sums)
    record_counts, pair_bounds = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    for_each(
        project, chunks, chunk_size, order, first, last, frame.cam, frame.eye,
        scene.means, scene.scales, scene.quats, scene.opacities, scene.colours, scene.plain,
        open_sums, frame.records, frame.owners, record_counts, pair_bounds,
    )  # fmt: skip
    first_places = np.cumsum(pair_bounds) - pair_bounds
    pair_tiles = np.empty(int(pair_bounds.sum()), np.int32)
    places = np.empty((chunks, tiles_y * tiles_x), np.int32)
    for_each(
        list_pairs, chunks, chunk_size, first, record_counts, frame.records, open_tiles, first_places,
        pair_tiles, frame.pair_counts, places,
    )  # fmt: skip
    tile_starts = np.empty(tiles_y * tiles_x + 1, np.int64)
    place_pairs(places, tile_starts)
    tiles = np.flatnonzero(np.diff(tile_starts))
    pair_codes, pair_rows = np.empty(tile_starts[-1], np.int32), np.empty(tile_starts[-1], np.int32)
    for_each(
        sort_pairs, chunks, chunk_size, first, record_counts, first_places, pair_tiles, frame.pair_counts, places,
        pair_codes, pair_rows,
    )  # fmt: skip
    tasks = -(-len(tiles) // TILES_PER_TASK)
    for_each(
        blend, tasks, TILES_PER_TASK, tiles, tile_starts, pair_codes, frame.records, frame.states, frame.lasts,
        frame.tile_lasts, open_tiles, *frame.size,
    )  # fmt: skip
    frame.slices.append(
        _Slice(first, chunk_size, record_counts, first_places, tiles, tile_starts, pair_codes, pair_tiles, pair_rows)
    )


def _picture(
    frame: _Frame, camera: Camera, background: Sequence[float]
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """rgb (H, W, 3), alpha (H, W) and depth times weight (H, W)."""
    kind = frame.states.dtype
    shape = camera.height, camera.width
    rgb, alpha, depth = np.empty((*shape, 3), kind), np.empty(shape, kind), np.empty(shape, kind)
    tasks = -(-camera.height // (SIDE * ROWS_PER_TASK))
    for_each(
        resolve, tasks, ROWS_PER_TASK, frame.states, frame.tile_lasts, np.array(background, kind), rgb, alpha, depth
    )
    return rgb, alpha, depth
