"""Classic 3DGS on the CPU: sorted alpha compositing of EWA splats, forward and backward.

It shows captures unchanged, renders the surface views that training follows, and is what accuracy is measured with.
Kerbl et al. 2023 with the constants of INRIA's renderer: 0.3 px^2 low-pass, alpha at most 0.99, alpha below 1/255
skipped, a pixel ends where less than 1e-4 of the light would be left. Every pixel where alpha reaches 1/255 is drawn,
so that the picture does not depend on the tiles.

A frame is sorted by depth; then, slice by slice from the front, projected, listed for each tile and composited. Tiles
that have become opaque are closed, and Gaussians behind closed tiles are never projected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.classic.blend import ADJOINT, BLOCK, ROW, STATE, UNTOUCHED, blend, blend_backward, resolve
from engine.render.classic.depth_order import depth_order
from engine.render.classic.records import RECORD, Frame, PictureGradient, Scene, Slice
from engine.render.classic.splats import project, project_backward
from engine.render.classic.tiles import BLOCKS, SIDE, list_pairs, place_pairs, sort_pairs, sum_open
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.scene.gaussians import Gaussians
from engine.scene.image import Picture
from engine.threads import for_each

__all__ = ["composite", "composite_backward", "composite_weights", "picture", "render"]

SLICES = 16
"""Slices of a large scene: enough that the front ones hide most of the rest, few enough that each fills the cores."""

LEAST_SLICE = 1 << 15
"""Gaussians below which a slice costs more to set up than it can save."""

CHUNKS = 16
"""Tasks in a slice, unless they get smaller than LEAST_CHUNK."""

LEAST_CHUNK = 2048
"""Gaussians in a task: a tenth of a millisecond's work, against a few microseconds to call a kernel."""

TILES_PER_TASK = 24
"""Few enough for the cores to finish a small picture at the same time."""

ROWS_PER_TASK = 4
"""Rows of tiles that are resolved in one task."""

LINE = 64
"""Bytes of a cache line, and of the widest vector."""


def render(gaussians: Gaussians, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Picture:
    """The Gaussians seen by the camera over a background (3,); depth is the mean depth of what covers the pixel."""
    scene = _scene(gaussians, gaussians.sh, plain=False)
    rgb, alpha, depth, _ = picture(composite(scene, camera)[0], camera, background)
    covered = alpha > 0
    depth[covered] /= alpha[covered]
    depth[~covered] = np.inf
    return Picture(rgb, alpha, depth)


def composite_weights(gaussians: Gaussians, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What each Gaussian adds to the picture, and where the picture's surface is.

    The weights (N,), alpha times the transmittance in front, summed over the pixels; and the median depth (H, W), that
    of the Gaussian that takes the transmittance below a half, or inf.
    """
    # A picture is linear in the colours, so its derivative by one of them is that Gaussian's weight.
    scene = _scene(gaussians, np.zeros((len(gaussians), 1, 3), np.float32), plain=True)
    frame, slices = composite(scene, camera)
    rgb, alpha, depth, median = picture(frame, camera, (0.0, 0.0, 0.0))
    gradient = PictureGradient(
        np.zeros_like(rgb), np.zeros_like(alpha), np.zeros_like(depth), False, np.zeros(3, np.float32)
    )
    gradient.rgb[..., 0] = 1
    weights = composite_backward(scene, frame, slices, gradient)[4][:, 0, 0]
    median[median == 0] = np.inf
    return weights, median


def _scene(gaussians: Gaussians, colours: NDArray[np.float32], plain: bool) -> Scene:
    """The Gaussians in other colours, contiguous and writeable, so that the kernels compiled for training fit."""
    means, scales, quats, opacities, shown = (
        np.require(array, np.float32, ("C", "W"))
        for array in (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, colours)
    )
    return Scene(means, scales, quats, opacities, shown, plain)


def composite_backward(
    scene: Scene, frame: Frame, slices: Sequence[Slice], gradient: PictureGradient
) -> list[NDArray[np.floating]]:
    """Gradients of means, scales, quats, opacities and colours, given that of the picture."""
    kind = scene.means.dtype
    tiles = len(frame.states)
    adjoints = _empty((tiles, BLOCKS, ADJOINT * BLOCK), kind)
    parameters = scene.means, scene.scales, scene.quats, scene.opacities, scene.colours
    ends = np.cumsum([array.size for array in parameters])
    flat = np.zeros(ends[-1], kind)
    gradients = [part.reshape(a.shape) for part, a in zip(np.split(flat, ends[:-1]), parameters, strict=True)]
    d_means, d_scales, d_quats, d_opacities, d_colours = gradients
    scene_gradient = Scene(d_means, d_scales, d_quats, d_opacities, d_colours, scene.plain)
    begun = np.zeros(tiles, np.uint8)
    rows = _empty((max((len(part.pair_tiles) for part in slices), default=0), ROW), kind)
    for part in reversed(slices):
        tasks = -(-len(part.tiles) // TILES_PER_TASK)
        for_each(blend_backward, tasks, TILES_PER_TASK, part, frame, gradient, begun, adjoints, rows)
        for_each(project_backward, len(part.record_counts), scene, frame, part, rows, scene_gradient)
    return gradients


def _empty(shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """An array aligned to cache lines, so that a record or a vector of pixels fills whole lines."""
    size = math.prod(shape) * kind.itemsize
    raw = np.empty(size + LINE, np.uint8)
    start = -raw.__array_interface__["data"][0] % LINE
    return raw[start : start + size].view(kind).reshape(shape)


def composite(scene: Scene, camera: Camera) -> tuple[Frame, list[Slice]]:
    """The composited picture, still in tiles, and its slices, nearest first."""
    kind = scene.means.dtype
    cam = camera_record(camera)
    tiles_x, tiles_y = -(-camera.width // SIDE), -(-camera.height // SIDE)
    order = depth_order(cam, scene.means)
    visible = len(order)
    frame = Frame(
        cam,
        camera.position,
        _empty((visible, RECORD), kind),
        np.empty(visible, np.int32),
        np.empty(visible, np.int32),
        _empty((tiles_y * tiles_x, BLOCKS, STATE * BLOCK), kind),
        _empty((tiles_y * tiles_x, BLOCKS, BLOCK), np.dtype(np.int32)),
        np.full(tiles_y * tiles_x, UNTOUCHED, np.int32),
        camera.width,
        camera.height,
    )
    slices: list[Slice] = []
    open_tiles = np.ones((tiles_y, tiles_x), np.uint8)
    size = max(LEAST_SLICE, -(-visible // SLICES))
    for first in range(0, visible, size):
        if not open_tiles.any():
            break
        slices.append(_composite_slice(scene, frame, order, first, min(first + size, visible), open_tiles))
    return frame, slices


def _composite_slice(
    scene: Scene, frame: Frame, order: NDArray[np.int64], first: int, last: int, open_tiles: NDArray[np.uint8]
) -> Slice:
    """Composites Gaussians first..last of the order into the frame."""
    tiles_y, tiles_x = open_tiles.shape
    chunk_size = max(LEAST_CHUNK, -(-(last - first) // CHUNKS))
    chunks = -(-(last - first) // chunk_size)
    open_sums = np.empty((tiles_y + 1, tiles_x + 1), np.int32)
    sum_open(open_tiles, open_sums)
    record_counts, pair_bounds = np.empty(chunks, np.int64), np.empty(chunks, np.int64)
    for_each(
        project, chunks, chunk_size, order, first, last, scene, frame, open_sums, record_counts, pair_bounds,
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
    part = Slice(
        first, chunk_size, record_counts, first_places, tiles, tile_starts, pair_codes, pair_tiles, pair_rows
    )  # fmt: skip
    for_each(blend, -(-len(tiles) // TILES_PER_TASK), TILES_PER_TASK, part, frame, open_tiles)
    return part


def picture(frame: Frame, camera: Camera, background: Sequence[float]) -> tuple[NDArray[np.floating], ...]:
    """rgb (H, W, 3), alpha, depth times weight and median depth (H, W), 0 where less than half of the light stops."""
    kind = frame.states.dtype
    shape = camera.height, camera.width
    rgb, (alpha, depth, median) = np.empty((*shape, 3), kind), (np.empty(shape, kind) for _ in range(3))
    tasks = -(-camera.height // (SIDE * ROWS_PER_TASK))
    for_each(
        resolve, tasks, ROWS_PER_TASK, frame.states, frame.tile_lasts, np.array(background, kind), rgb, alpha, depth,
        median,
    )  # fmt: skip
    return rgb, alpha, depth, median
