"""The outside of the opaque image before it is resolved: the splats of all pieces, summed behind one common front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.splats import RECORD, TILE, Splats, project
from engine.render.cpu.tiles import CHUNKS, TILES_PER_TASK, TiledSplats, accumulate, tile_lists
from engine.render.cpu.weights import SUMS, resolve
from engine.render.projection import camera_record
from engine.scene import sh
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.constants import EPSILON_PITCHES
from engine.scene.piece import Piece
from engine.scene.plane import Plane, stack
from engine.threads import for_each

__all__ = ["Outside", "Splats", "camera_planes", "directions", "draw", "splats_of", "tiled_splats", "view_colours"]


@dataclass(frozen=True)
class Outside:
    """The sums of a picture's outside, and the splats that they were made from."""

    tiled: TiledSplats
    front: NDArray[np.floating]
    """(H, W). Depth of the nearest core, inf if there is none."""
    sums: NDArray[np.floating]
    """(H, W, SUMS). Sums in the layer at the front, before and behind it, as in `engine.render.cpu.weights`."""

    @property
    def tasks(self) -> int:
        """Number of tasks of the kernels that walk the tiles."""
        return -(-(len(self.tiled.tile_starts) - 1) // TILES_PER_TASK)

    def resolved(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """RGB (H, W, 3), weighted by alpha, and alpha (H, W)."""
        rgb, alpha = np.empty((*self.front.shape, 3), self.sums.dtype), np.empty_like(self.front)
        for_each(resolve, len(self.front), self.sums, rgb, alpha)
        return rgb, alpha


def splats_of(atoms: Atoms) -> Splats:
    """The atoms that are visible from outside: those of the surface."""
    return Splats(atoms.surface.means, atoms.surface.scales, atoms.surface.quats)


def view_colours(atoms: Atoms, camera: Camera) -> NDArray[np.float32]:
    """(N, 3). RGB of `splats_of(atoms)` as this camera sees them."""
    surface = atoms.surface
    if surface.sh_degree == 0:
        return sh.sh_to_rgb(surface.sh[:, 0]).astype(np.float32)
    return sh.colours(surface.sh, directions(surface.means, camera)).astype(np.float32)


def directions(means: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """(N, 3). Unit directions from the eye to means (N, 3); an orthographic camera has one direction."""
    if camera.orthographic:
        return np.broadcast_to(camera.forward.astype(np.float32), means.shape)
    offset = means - camera.position.astype(np.float32)
    return offset / np.maximum(np.linalg.norm(offset, axis=1, keepdims=True), np.float32(1e-12))


def camera_planes(camera: Camera, planes: Sequence[Plane]) -> NDArray[np.float64]:
    """(P, 4). The planes' a, b, c, d in camera space."""
    rows = stack(planes)
    rows[:, :3] = rows[:, :3] @ camera.viewmat[:3, :3].T
    rows[:, 3] -= rows[:, :3] @ camera.viewmat[:3, 3]
    return rows


def draw(
    splats: Splats,
    colours: Sequence[NDArray[np.floating]],  # [N, 3] for each piece
    camera: Camera,
    pieces: Sequence[Piece],
    pitch: float,
) -> Outside:
    """Projects the splats once per piece and sums their fragments, pixel by pixel."""
    kind = splats.means.dtype
    tiled = tiled_splats(splats, camera, pieces, pitch)
    front = np.empty((camera.height, camera.width), kind)
    outside = Outside(tiled, front, np.empty((*front.shape, SUMS), kind))
    stacked = np.ascontiguousarray(np.concatenate(colours) if len(colours) > 1 else colours[0], kind)
    for_each(accumulate, outside.tasks, tiled, stacked, front, outside.sums)
    return outside


def tiled_splats(splats: Splats, camera: Camera, pieces: Sequence[Piece], pitch: float) -> TiledSplats:
    """The splats as the pixel loops need them: projected once per piece, and listed for each tile."""
    kind, count = splats.means.dtype, len(splats.means)
    views = [piece.camera(camera) for piece in pieces]
    planes = np.concatenate(
        [np.zeros((0, 4))] + [camera_planes(view, piece.planes) for view, piece in zip(views, pieces, strict=True)]
    )
    end = np.cumsum([0] + [len(piece.planes) for piece in pieces])
    records = np.empty((len(pieces) * count, RECORD), kind)
    spans = np.empty((len(pieces) * count, 6), np.int32)
    size = -(-count // CHUNKS)
    for k, view in enumerate(views):
        rows = slice(k * count, (k + 1) * count)
        for_each(
            project, CHUNKS, size, camera_record(view), planes, end[k : k + 2],
            splats, records[rows], spans[rows],
        )  # fmt: skip

    columns, lines = -(-camera.width // TILE), -(-camera.height // TILE)
    tile_starts, splat_ids = tile_lists(spans, columns, lines)
    cam = camera_record(camera)
    return TiledSplats(cam, planes, records, spans, tile_starts, splat_ids, columns, EPSILON_PITCHES * pitch)
