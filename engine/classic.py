"""Classic 3DGS on the CPU: sorted alpha compositing of EWA splats, forward and backward (DESIGN §3, §6).

It shows a capture as it came, makes the surface views that training follows, and is what accuracy is measured with.
Kerbl et al. 2023 with the constants of INRIA's renderer: 0.3 px^2 low-pass, alpha at most 0.99, alpha under 1/255 left
out, a pixel ends where less than 1e-4 of the light would be left. Every pixel where alpha reaches 1/255 is drawn, so the
picture does not depend on how it is cut into tiles.

A frame: order by depth; then, slice by slice from the front, project what may still be seen, list it per tile,
composite. Tiles that have become opaque close, and what lies behind them is never projected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from engine.camera import Camera
from engine.cpu.blend import BLOCK, BLOCKS, STATE, blend, resolve, start
from engine.cpu.depth_order import depth_order
from engine.cpu.splats import RECORD, project
from engine.cpu.tiles import SIDE, list_pairs, place_pairs, sum_open
from engine.gaussians import Gaussians
from engine.picture import Picture
from engine.projection import pack_camera
from engine.threads import for_each

__all__ = ["render"]

SLICES = 8
"""Slices of a large scene: enough for the front ones to hide most of the rest, few enough that each fills the cores."""

LEAST_SLICE = 8192
"""Gaussians under which a slice costs more to set up than it can save."""

CHUNKS = 16
"""Tasks in a slice."""

TILES_PER_TASK = 32


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
    first_rows: NDArray[np.int64]  # [chunks]
    tiles: NDArray[np.int64]  # [T]
    tile_starts: NDArray[np.int64]  # [tiles + 1]
    pair_slots: NDArray[np.int32]  # [pairs]
    pair_rows: NDArray[np.int32]  # [pairs]


@dataclass
class _Frame:
    """A composited picture, still in tiles, and how it came about."""

    cam: NDArray[np.float64]
    eye: NDArray[np.float64]
    records: NDArray[np.floating]  # [V, RECORD]
    owners: NDArray[np.int32]  # [V]
    pair_counts: NDArray[np.int32]  # [V]
    states: NDArray[np.floating]  # [tiles, BLOCKS, STATE * BLOCK]
    lasts: NDArray[np.int32]  # [tiles, BLOCKS, BLOCK]
    slices: list[_Slice] = field(default_factory=list)


def render(gaussians: Gaussians, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Picture:
    """The Gaussians seen by the camera over a background (3,); depth is the mean depth of what covers the pixel."""
    arrays = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.opacities, gaussians.sh)
    scene = _Scene(*(np.ascontiguousarray(array) for array in arrays), plain=False)
    rgb, alpha, depth = _picture(_composite(scene, camera), camera, background)
    covered = alpha > 0
    depth[covered] /= alpha[covered]
    depth[~covered] = np.inf
    return Picture(rgb, alpha, depth)


def _composite(scene: _Scene, camera: Camera) -> _Frame:
    kind = scene.means.dtype
    cam = pack_camera(camera)
    tiles_x, tiles_y = -(-camera.width // SIDE), -(-camera.height // SIDE)
    order = depth_order(cam, scene.means)
    visible = len(order)
    frame = _Frame(
        cam,
        camera.position,
        np.empty((visible, RECORD), kind),
        np.empty(visible, np.int32),
        np.empty(visible, np.int32),
        np.empty((tiles_y * tiles_x, BLOCKS, STATE * BLOCK), kind),
        np.empty((tiles_y * tiles_x, BLOCKS, BLOCK), np.int32),
    )
    for_each(start, tiles_y, frame.states, frame.lasts, camera.width, camera.height)
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
    chunk_size = max(512, -(-(last - first) // CHUNKS))
    chunks = -(-(last - first) // chunk_size)
    open_sums = np.empty((tiles_y + 1, tiles_x + 1), np.int32)
    sum_open(open_tiles, open_sums)
    record_counts = np.empty(chunks, np.int64)
    places = np.empty((chunks, tiles_y * tiles_x), np.int32)
    for_each(
        project, chunks, chunk_size, order, first, last, frame.cam, frame.eye,
        scene.means, scene.scales, scene.quats, scene.opacities, scene.colours, scene.plain,
        open_tiles, open_sums, frame.records, frame.owners, frame.pair_counts, record_counts, places,
    )  # fmt: skip
    first_rows = np.cumsum(places.sum(axis=1, dtype=np.int64))
    pairs = int(first_rows[-1])
    first_rows = np.concatenate([[0], first_rows[:-1]])
    tile_starts = np.empty(tiles_y * tiles_x + 1, np.int64)
    place_pairs(places, tile_starts)
    tiles = np.flatnonzero(np.diff(tile_starts))
    pair_slots = np.empty(pairs, np.int32)
    pair_rows = np.empty(pairs, np.int32)
    for_each(
        list_pairs, chunks, chunk_size, first, record_counts, frame.records, open_tiles, places, first_rows,
        pair_slots, pair_rows,
    )  # fmt: skip
    tasks = -(-len(tiles) // TILES_PER_TASK)
    for_each(
        blend, tasks, TILES_PER_TASK, tiles, tile_starts, pair_slots, frame.records, frame.states, frame.lasts,
        open_tiles,
    )  # fmt: skip
    frame.slices.append(_Slice(first, chunk_size, record_counts, first_rows, tiles, tile_starts, pair_slots, pair_rows))


def _picture(
    frame: _Frame, camera: Camera, background: Sequence[float]
) -> tuple[NDArray[np.floating], NDArray[np.floating], NDArray[np.floating]]:
    """rgb (H, W, 3), alpha (H, W) and depth times weight (H, W)."""
    kind = frame.states.dtype
    shape = camera.height, camera.width
    rgb, alpha, depth = np.empty((*shape, 3), kind), np.empty(shape, kind), np.empty(shape, kind)
    for_each(resolve, -(-camera.height // SIDE), frame.states, np.asarray(background, kind), rgb, alpha, depth)
    return rgb, alpha, depth
