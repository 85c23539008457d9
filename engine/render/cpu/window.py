"""Opaque mode where the processor is the graphics card: the same frame from the renderer's own kernels.

Software GL shades four by four pixels at a time and blends wide targets; the kernels of the CPU renderer add up the
same splats in a third of the time, and the frame is handed to GL as a texture. Who is drawn is decided as for a
graphics card.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.splats import RECORD, TILE
from engine.render.cpu.tiles import CHUNKS, TILES_PER_TASK, accumulate, tile_lists
from engine.render.cpu.tiles import Frame as Tiled
from engine.render.cpu.window_faces import BAND, SECTION, add_faces, bin_bands, sections
from engine.render.cpu.window_frame import compose, gather, pack
from engine.render.cpu.window_grid import KeptGrids
from engine.render.cpu.window_holes import fill_holes, seen_through, tile_depths
from engine.render.culling.groups import Group, Rect, seen_groups
from engine.render.culling.look import Look
from engine.render.culling.piece_faces import Face, near_face, scale_of, visible_faces
from engine.render.culling.solid import Solid
from engine.render.culling.store import Ellipsoids, Spheres
from engine.render.culling.view import View
from engine.render.culling.visible import visible_atoms
from engine.render.projection import CameraRecord, camera_record
from engine.scene.camera import Camera
from engine.scene.constants import EPSILON_PITCHES, JOINT_PITCHES, NOTHING
from engine.scene.piece import Piece
from engine.scene.plane import frame as frame_of
from engine.threads import for_each

__all__ = ["SoftwareMode", "is_software"]

Double = NDArray[np.float64]


NO_FACE = np.zeros((0, 0, 4), np.float32)
NO_HALVES = np.zeros((0, 0, 4), np.uint16)


def is_software(renderer: str) -> bool:
    """Whether a GL renderer of this name draws on the processor."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swr"))


class SoftwareMode:
    """Draws a solid's pieces into a frame."""

    def __init__(self) -> None:
        self.grids = KeptGrids()
        self._rooms: dict[str, NDArray[Any]] = {}
        self._size = (0, 0)
        self._drawn: Rect | None = None
        """What of the frame is not background; None: unknown."""
        self._background = np.zeros(3, np.float32)
        self._info: NDArray[np.float32] | None = None
        """(H, W, 2). Of the last frame, until it is asked for."""

    def forget(self) -> None:
        """Something else has drawn into the frame, or it is a new one."""
        self._drawn = self._info = None

    def draw(
        self,
        solid: Solid,
        camera: Camera,
        pieces: Sequence[Piece],
        groups: Sequence[Group],
        background: Double,
        look: Look,
    ) -> tuple[Rect, NDArray[np.uint16]]:
        """Puts the pieces over the background. Returns which part of the frame has changed, and its pixels (height,
        width, 4) as half floats, which last until the next frame."""
        self.grids.begin()
        ground = background.astype(np.float32)
        rgb = self._room("rgb", (camera.height, camera.width, 3), np.float32)
        info = self._room("info", (camera.height, camera.width, 2), np.float32)
        whole = (0, 0, camera.width, camera.height)
        if self._size != (camera.width, camera.height) or not np.array_equal(ground, self._background):
            self._drawn = None
        self._size, self._background = (camera.width, camera.height), ground
        stale = whole if self._drawn is None else self._drawn
        drawn: Rect = (0, 0, 0, 0)
        jobs = list(seen_groups(solid, camera, pieces, groups))
        for *_, rect in jobs:
            drawn = union(drawn, rect)
        # The first group writes all pixels of its rectangle.
        for x, y, width, height in [stale, drawn] if len(jobs) > 1 else around(stale, drawn):
            rgb[y : y + height, x : x + width] = ground
            info[y : y + height, x : x + width] = NOTHING, -2.0
        changed = union(stale, drawn)
        halves = self._room("halves", (changed[3], changed[2], 4), np.uint16)
        for k, (number, view, planes, rect) in enumerate(jobs):
            ready = changed, halves if k == len(jobs) - 1 else None
            self._group(view, planes, solid, rect, look, ground, number, k > 0, rgb, info, *ready)
        self._drawn = drawn
        for x, y, width, height in around(changed, jobs[-1][-1]) if jobs else [changed]:
            part = rgb[y : y + height, x : x + width]
            for_each(pack, -(-height // BAND), x, y, part, *changed[:2], halves)
        self._info = info
        return changed, halves

    def _group(
        self,
        view: View,
        planes: list[Double],
        solid: Solid,
        rect: Rect,
        look: Look,
        ground: NDArray[np.float32],
        number: int,
        below: bool,
        rgb: NDArray[np.float32],
        info: NDArray[np.float32],
        changed: Rect,
        halves: NDArray[np.uint16] | None,
    ) -> None:
        """Adds up pieces that lie together and puts them into the frame, the last ones into `halves` of `changed`."""
        x, y, width, height = rect
        whole = camera_record(view.camera)
        cam = whole._replace(
            translation=tuple(view.matrix[:3, 3].tolist()),
            cx=whole.cx - x,
            cy=whole.cy - y,
            width=float(width),
            height=float(height),
        )
        face = self._room("face", (height, width, 4), np.float32)
        depths = self._room("depths", (height, width), np.float32)
        has_faces = False
        for i, piece in enumerate(planes):
            mates = planes[:i] + planes[i + 1 :]
            has_faces |= self._faces(view, cam, piece, mates, solid, look, face, depths, not has_faces)
        front, sums = self._splats(view, cam, rect, planes, solid, look, face if has_faces else NO_FACE, depths)
        for_each(
            compose, -(-height // BAND), x, y, sums, front, has_faces, face, depths,
            np.float32(JOINT_PITCHES * solid.pitch), ground, np.float32(number), below, rgb, info, np.float32(NOTHING),
            halves is not None, *changed[:2], NO_HALVES if halves is None else halves,
        )  # fmt: skip

    def _splats(
        self,
        view: View,
        cam: CameraRecord,
        rect: Rect,
        planes: list[Double],
        solid: Solid,
        look: Look,
        face: NDArray[np.float32],
        depths: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Front depth (H, W) and sums (H, W, 5) of the outside; `face` (H, W, 4) and `depths` are the faces, if any."""
        shape = rect[3], rect[2]
        front = self._room("front", shape, np.float32)
        sums = self._room("sums", (*shape, 5), np.float32)
        jobs, hidden = [], []
        for splats in solid.splats(look.interior_only):
            every = [np.ones(len(splats.chunks), bool)]
            for k, ((free, clipped, behind),) in enumerate(visible_atoms(view, planes, splats, look, every)):
                jobs.append((splats, k, np.concatenate([free, clipped])))
                hidden.append((splats, k, behind))
        tiled, colours = self._tiled("", view, cam, planes, jobs, solid, look, shape)
        for_each(accumulate, -(-(len(tiled.first) - 1) // TILES_PER_TASK), tiled, colours, front, sums)

        lines, columns = -(-shape[0] // TILE), -(-shape[1] // TILE)
        ends = self._room("ends", shape, np.float32)
        limits = self._room("limits", (lines, columns), np.float32)
        left_open, right_open = rect[0] > 0, rect[0] + rect[2] < view.camera.width
        if any(len(rows) for _, _, rows in hidden):
            for_each(tile_depths, lines, front, len(face) > 0, face, depths, left_open, right_open, ends, limits)
            jobs = []
            for splats, k, rows in hidden:
                seen = self._room("seen", (len(rows),), np.bool_)
                for_each(
                    seen_through, CHUNKS, -(-len(rows) // CHUNKS), rows, splats.kept[0], look.disc_scale, cam, limits,
                    tiled.layer, seen,
                )  # fmt: skip
                jobs.append((splats, k, rows[seen]))
            if any(len(rows) for _, _, rows in jobs):
                behind_tiled, behind_colours = self._tiled("behind ", view, cam, planes, jobs, solid, look, shape)
                for_each(fill_holes, lines, tiled, colours, behind_tiled, behind_colours, ends, front, sums)
        return front, sums

    def _tiled(
        self,
        name: str,
        view: View,
        cam: CameraRecord,
        planes: list[Double],
        jobs: Sequence[tuple[Ellipsoids, int, NDArray[np.uint32]]],  # each: atoms of a piece
        solid: Solid,
        look: Look,
        shape: tuple[int, int],
    ) -> tuple[Tiled, NDArray[np.float32]]:
        """Projected atoms in lists for each tile, and their colours (N, 3)."""
        count = sum(len(rows) for _, _, rows in jobs)
        means = self._room(name + "means", (count, 3), np.float32)
        scales = self._room(name + "scales", (count, 3), np.float32)
        quats = self._room(name + "quats", (count, 4), np.float32)
        colours = self._room(name + "colours", (count, 3), np.float32)
        records = self._room(name + "records", (count, RECORD), np.float32)
        spans = self._room(name + "spans", (count, 6), np.int32)
        stacked = np.concatenate([np.zeros((0, 4)), *(view.planes_in_camera(p) for p in planes)])
        end = np.cumsum([0] + [len(p) for p in planes])
        at = 0
        for splats, k, rows in jobs:
            own = slice(at, at + len(rows))
            at += len(rows)
            for_each(
                gather, CHUNKS, -(-len(rows) // CHUNKS), rows, *splats.kept, splats.degree, look.disc_scale, view.eye,
                view.camera.orthographic, means[own], scales[own], quats[own], colours[own],
                cam, stacked, end[k : k + 2], records[own], spans[own],
            )  # fmt: skip
        columns, lines = -(-shape[1] // TILE), -(-shape[0] // TILE)
        first, listed = tile_lists(spans, columns, lines, lambda part, *of: self._room(name + part, *of))
        layer = EPSILON_PITCHES * solid.pitch * look.disc_scale
        return Tiled(cam, stacked, records, spans, first, listed, columns, layer), colours

    def _faces(
        self,
        view: View,
        cam: CameraRecord,
        planes: Double,
        mates: list[Double],
        solid: Solid,
        look: Look,
        face: NDArray[np.float32],
        depths: NDArray[np.float32],
        fresh: bool,
    ) -> bool:
        """Adds the faces of one piece to the layer; False where it shows none."""
        visible = visible_faces(view, planes, mates, solid.box, JOINT_PITCHES * solid.pitch)
        if not visible:
            return False
        jobs: list[tuple[Face, Spheres | Ellipsoids, NDArray[np.uint32]]] = []
        keys = []
        for f in visible:
            minified = 0.5 * f.widest_pixel(view) > float(solid.inside.reach.min(initial=np.inf)) / 3
            key = None if look.exact or minified else self.grids.get(f.plane, solid.inside, look)
            if key is not None:
                keys.append((f.index, key))
            else:
                jobs.append((f, solid.inside, near_face(view, planes, f, solid.inside, look)))
            if not look.interior_only:
                jobs.append((f, solid.skin, near_face(view, planes, f, solid.skin, look)))
        count = sum(len(rows) for _, _, rows in jobs)
        records = self._room("sections", (count, SECTION), np.float32)
        boxes = self._room("boxes", (count, 4), np.int32)
        owner = self._room("owner", (count,), np.int32)
        frames = np.zeros((len(planes), 8))
        for f in visible:
            for k, axis in enumerate(frame_of(f.plane[:3])[:2]):
                turned = view.matrix[:3, :3] @ axis
                frames[f.index, 4 * k : 4 * k + 3] = turned
                frames[f.index, 4 * k + 3] = -turned @ view.matrix[:3, 3]
        at = 0
        for f, store, rows in jobs:
            own = slice(at, at + len(rows))
            at += len(rows)
            e1, e2, _ = frame_of(f.plane[:3])
            owner[own] = f.index
            enlarge = scale_of(store, look)
            for_each(
                sections, CHUNKS, -(-len(rows) // CHUNKS), rows, *store.kept, enlarge, f.plane, e1, e2, view.matrix,
                cam, records[own], boxes[own],
            )  # fmt: skip
        corners = np.concatenate([f.corners for f in visible])
        low, high = view.extent(corners, np.zeros(len(corners)))
        height = len(depths)
        shift = view.camera.cy - cam.cy
        lines = np.clip([low[1] - shift - 1, high[1] - shift + 1], 0, height)
        cells, table = self.grids.together(keys, len(planes))
        first, listed = bin_bands(boxes, -(-height // BAND))
        beside = np.concatenate([np.zeros((0, 4)), *(view.planes_in_camera(m) for m in mates)])
        first_mate = np.cumsum([0] + [len(m) for m in mates])
        for_each(
            add_faces, -(-height // BAND), cam, view.planes_in_camera(planes), frames, beside, first_mate,
            JOINT_PITCHES * solid.pitch, first, listed, boxes, records, owner, cells, table, solid.pitch / 2,
            look.light, lines, fresh, face, depths,
        )  # fmt: skip
        return True

    def news(self) -> NDArray[np.float32] | None:
        """(H, W, 2). Depths and pieces of the last frame as shaders/resolve.frag.glsl writes them, once; then None."""
        info, self._info = self._info, None
        return info

    def _room(self, name: str, shape: tuple[int, ...], kind: type) -> Any:
        """An array of this shape that is used again from frame to frame; it holds what it held."""
        need = int(np.prod(shape))
        if name not in self._rooms or len(self._rooms[name]) < need:
            self._rooms[name] = np.zeros(need + need // 4, kind)
        return self._rooms[name][:need].reshape(shape)

    def release(self) -> None:
        """Frees the arrays."""
        self._rooms.clear()
        self.grids.clear()
        self.forget()


def around(outer: Rect, hole: Rect) -> list[Rect]:
    """What is left of a rectangle without another: strips above, below, left and right."""
    x, y, width, height = outer
    x0, y0 = min(max(hole[0], x), x + width), min(max(hole[1], y), y + height)
    x1, y1 = min(max(hole[0] + hole[2], x0), x + width), min(max(hole[1] + hole[3], y0), y + height)
    strips = [
        (x, y, width, y0 - y),
        (x, y1, width, y + height - y1),
        (x, y0, x0 - x, y1 - y0),
        (x1, y0, x + width - x1, y1 - y0),
    ]
    return [strip for strip in strips if strip[2] > 0 and strip[3] > 0]


def union(a: Rect, b: Rect) -> Rect:
    """The rectangle about both; one without pixels does not count."""
    if not a[2] or not a[3]:
        return b
    if not b[2] or not b[3]:
        return a
    x, y = min(a[0], b[0]), min(a[1], b[1])
    return x, y, max(a[0] + a[2], b[0] + b[2]) - x, max(a[1] + a[3], b[1] + b[3]) - y
