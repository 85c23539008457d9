"""The opaque picture where OpenGL runs in software: the same frame from kernels on the processor.

A software GL shades four by four pixels at a time and blends wide targets. These kernels, shared with the CPU renderer,
sum the same splats in a third of the time and hand the frame to GL as a texture. The culling is the same as for a
graphics card.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.ray_entry import PieceBounds
from engine.render.cpu.software_faces import PieceFaces, add_faces
from engine.render.cpu.software_frame import (
    FrameArrays,
    GroupLayers,
    HalfFloats,
    SplatBatch,
    SplatView,
    compose,
    gather,
    pack,
)
from engine.render.cpu.software_grids import GridArrays
from engine.render.cpu.software_holes import fill_holes, seen_through, tile_depths
from engine.render.cpu.software_sections import BAND, SECTION, AtomBatch, SectionView, bin_bands, sections
from engine.render.cpu.splats import RECORD, TILE, Splats
from engine.render.cpu.tiles import CHUNKS, TILES_PER_TASK, TiledSplats, accumulate, tile_lists
from engine.render.cpu.weights import SUMS
from engine.render.culling.draw_options import DrawOptions
from engine.render.culling.drawable import Drawable
from engine.render.culling.groups import Group, Rect, visible_groups
from engine.render.culling.piece_faces import Face, atoms_at_face, scale_of, visible_faces
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


def is_software(renderer: str) -> bool:
    """Whether a GL renderer of this name runs on the processor."""
    return any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swr"))


@dataclass(frozen=True)
class _Group:
    """Pieces that lie together, in a rectangle of the picture."""

    solid: Drawable
    options: DrawOptions
    number: int
    view: View
    cam: CameraRecord
    """Camera of the rectangle, in centred object space."""
    planes: list[Double]
    """(P, 4) for each piece, centred object space."""
    rect: Rect

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the rectangle, pixels."""
        return self.rect[3], self.rect[2]


class SoftwareMode:
    """Draws pieces of solids into a frame."""

    def __init__(self) -> None:
        self.grids = GridArrays()
        self._buffers: dict[str, NDArray[Any]] = {}
        self._size = (0, 0)
        self._drawn: Rect | None = None
        """The part of the frame that is not background; None: unknown."""
        self._background = np.zeros(3, np.float32)
        self._info: NDArray[np.float32] | None = None
        """(H, W, 2). `FrameArrays.info` of the last frame, until it is taken."""

    def reset(self) -> None:
        """Forgets what the frame shows: it is new, or something else has drawn into it, so all of it is drawn again."""
        self._drawn = self._info = None

    def draw(
        self,
        solids: Sequence[Drawable],
        camera: Camera,
        pieces: Sequence[Piece],
        groups: Sequence[Group],
        background: Double,
        options: DrawOptions,
    ) -> tuple[Rect, NDArray[np.uint16]]:
        """Draws the pieces over the background. Returns the part of the frame that has changed and its pixels (height,
        width, 4) as half floats, which are valid until the next frame."""
        self.grids.begin()
        frame = FrameArrays(
            self._buffer("rgb", (camera.height, camera.width, 3), np.float32),
            self._buffer("info", (camera.height, camera.width, 2), np.float32),
            background.astype(np.float32),
            np.float32(NOTHING),
        )
        if self._size != (camera.width, camera.height) or not np.array_equal(frame.background, self._background):
            self._drawn = None
        self._size, self._background = (camera.width, camera.height), frame.background
        stale = (0, 0, camera.width, camera.height) if self._drawn is None else self._drawn
        drawn: Rect = (0, 0, 0, 0)
        visible = [
            _Group(solid, options, number, view, _camera_of(view, rect), planes, rect)
            for number, solid, view, planes, rect in visible_groups(solids, camera, pieces, groups)
        ]
        for group in visible:
            drawn = union(drawn, group.rect)
        # The first group writes all pixels of its rectangle.
        for x, y, width, height in [stale, drawn] if len(visible) > 1 else around(stale, drawn):
            frame.rgb[y : y + height, x : x + width] = frame.background
            frame.info[y : y + height, x : x + width] = NOTHING, -2.0
        changed = union(stale, drawn)
        rgba = self._buffer("half_floats", (changed[3], changed[2], 4), np.uint16)
        half_floats = HalfFloats(*changed[:2], rgba)
        for k, group in enumerate(visible):
            self._draw_group(group, frame, k > 0, half_floats, k == len(visible) - 1)
        self._drawn = drawn
        for x, y, width, height in around(changed, visible[-1].rect) if visible else [changed]:
            for_each(pack, -(-height // BAND), x, y, frame.rgb[y : y + height, x : x + width], half_floats)
        self._info = frame.info
        return changed, rgba

    def _draw_group(
        self, group: _Group, frame: FrameArrays, over_earlier: bool, half_floats: HalfFloats, last: bool
    ) -> None:
        """Sums up pieces that lie together and puts them into the frame; the last group goes to the half floats."""
        face = self._buffer("face", (*group.shape, 4), np.float32)
        depths = self._buffer("depths", group.shape, np.float32)
        has_faces = False
        for i in range(len(group.planes)):
            has_faces |= self._add_faces(group, i, face, depths, not has_faces)
        front, sums = self._sum_splats(group, face if has_faces else NO_FACE, depths)
        tolerance = np.float32(JOINT_PITCHES * group.solid.pitch)
        layers = GroupLayers(*group.rect[:2], sums, front, has_faces, face, depths, tolerance, np.float32(group.number))
        for_each(compose, -(-group.shape[0] // BAND), layers, frame, over_earlier, half_floats, last)

    def _sum_splats(
        self,
        group: _Group,
        face: NDArray[np.float32],  # [H, W, 4] or NO_FACE
        depths: NDArray[np.float32],  # [H, W] depths of the faces, if any
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Front depth (H, W) and sums (H, W, SUMS) of the outside."""
        shape, rect, options = group.shape, group.rect, group.options
        front = self._buffer("front", shape, np.float32)
        sums = self._buffer("sums", (*shape, SUMS), np.float32)
        chosen, culled = [], []
        splats = group.solid.splats(options.interior_only)
        for k, (unclipped, clipped, hidden) in enumerate(visible_atoms(group.view, group.planes, splats, options)):
            chosen.append((splats, k, np.concatenate([unclipped, clipped])))
            culled.append((splats, k, hidden))
        tiled, colours = self._tile(group, "", chosen)
        for_each(accumulate, -(-(len(tiled.tile_starts) - 1) // TILES_PER_TASK), tiled, colours, front, sums)
        if not any(len(rows) for _, _, rows in culled):
            return front, sums

        lines, columns = -(-shape[0] // TILE), -(-shape[1] // TILE)
        ends = self._buffer("ends", shape, np.float32)
        limits = self._buffer("limits", (lines, columns), np.float32)
        left_open, right_open = rect[0] > 0, rect[0] + rect[2] < group.view.camera.width
        for_each(tile_depths, lines, front, sums, len(face) > 0, face, depths, left_open, right_open, ends, limits)
        chosen = []
        for splats, k, rows in culled:
            seen = self._buffer("seen", (len(rows),), np.bool_)
            for_each(
                seen_through, CHUNKS, -(-len(rows) // CHUNKS), rows, splats.geometry, options.disc_scale, group.cam,
                limits, tiled.layer, seen,
            )  # fmt: skip
            chosen.append((splats, k, rows[seen]))
        if any(len(rows) for _, _, rows in chosen):
            hidden_tiled, hidden_colours = self._tile(group, "hidden ", chosen)
            for_each(fill_holes, lines, tiled, colours, hidden_tiled, hidden_colours, ends, front, sums)
        return front, sums

    def _tile(
        self,
        group: _Group,
        name: str,
        chosen: Sequence[tuple[Ellipsoids, int, NDArray[np.uint32]]],  # each: atoms of one piece
    ) -> tuple[TiledSplats, NDArray[np.float32]]:
        """The chosen atoms, projected and listed for each tile, and their colours (N, 3)."""
        view, options, planes = group.view, group.options, group.planes
        count = sum(len(rows) for _, _, rows in chosen)
        means = self._buffer(name + "means", (count, 3), np.float32)
        scales = self._buffer(name + "scales", (count, 3), np.float32)
        quats = self._buffer(name + "quats", (count, 4), np.float32)
        colours = self._buffer(name + "colours", (count, 3), np.float32)
        records = self._buffer(name + "records", (count, RECORD), np.float32)
        spans = self._buffer(name + "spans", (count, 6), np.int32)
        stacked = np.concatenate([np.zeros((0, 4)), *(view.planes_in_camera(p) for p in planes)])
        end = np.cumsum([0] + [len(p) for p in planes])
        start = 0
        for splats, k, rows in chosen:
            part = slice(start, start + len(rows))
            start += len(rows)
            atoms = AtomBatch(rows, *splats.arrays, options.disc_scale)
            splat_view = SplatView(group.cam, view.eye, stacked, end[k : k + 2], splats.degree)
            out = SplatBatch(
                Splats(means[part], scales[part], quats[part]), colours[part], records[part], spans[part]
            )  # fmt: skip
            for_each(gather, CHUNKS, -(-len(rows) // CHUNKS), atoms, splat_view, out)
        columns, lines = -(-group.shape[1] // TILE), -(-group.shape[0] // TILE)
        lists = tile_lists(spans, columns, lines, lambda part, *of: self._buffer(name + part, *of))
        layer = EPSILON_PITCHES * group.solid.pitch * options.disc_scale
        return TiledSplats(group.cam, stacked, records, spans, *lists, columns, layer), colours

    def _add_faces(
        self, group: _Group, piece: int, face: NDArray[np.float32], depths: NDArray[np.float32], fresh: bool
    ) -> bool:
        """Adds the faces of one piece to the layer; False if none is visible."""
        solid, options, view, cam = group.solid, group.options, group.view, group.cam
        planes, neighbours = group.planes[piece], group.planes[:piece] + group.planes[piece + 1 :]
        tolerance = JOINT_PITCHES * solid.pitch
        visible = visible_faces(view, planes, neighbours, solid.box, tolerance)
        if not visible:
            return False
        chosen: list[tuple[Face, Spheres | Ellipsoids, NDArray[np.uint32]]] = []
        kept = []
        for f in visible:
            minified = 0.5 * f.widest_pixel(view) > float(solid.inside.reach.min(initial=np.inf)) / 3
            grid = None if options.exact or minified else self.grids.get(f.plane, solid.inside, options)
            if grid is not None:
                kept.append((f.index, grid))
            else:
                chosen.append((f, solid.inside, atoms_at_face(view, planes, f, solid.inside, options)))
            if not options.interior_only:
                chosen.append((f, solid.skin, atoms_at_face(view, planes, f, solid.skin, options)))
        count = sum(len(rows) for _, _, rows in chosen)
        records = self._buffer("sections", (count, SECTION), np.float32)
        boxes = self._buffer("boxes", (count, 4), np.int32)
        section_planes = self._buffer("section planes", (count,), np.int32)
        is_skin = self._buffer("is skin", (count,), np.bool_)
        start = 0
        for f, store, rows in chosen:
            part = slice(start, start + len(rows))
            start += len(rows)
            e1, e2, _ = frame_of(f.plane[:3])
            section_planes[part], is_skin[part] = f.index, store is solid.skin
            atoms = AtomBatch(rows, *store.arrays, scale_of(store, options))
            section_view = SectionView(f.plane, e1, e2, view.matrix, cam)
            for_each(sections, CHUNKS, -(-len(rows) // CHUNKS), atoms, section_view, records[part], boxes[part])
        joined = np.concatenate([np.zeros((0, 4)), *(view.planes_in_camera(n) for n in neighbours)])
        first_joined = np.cumsum([0] + [len(n) for n in neighbours])
        bands = -(-len(depths) // BAND)
        band_starts, section_ids = bin_bands(boxes, bands)
        cells, grids = self.grids.concatenated(kept, len(planes))
        faces = PieceFaces(
            cam,
            PieceBounds(view.planes_in_camera(planes), joined, first_joined, tolerance),
            _plane_coordinates(view, visible, len(planes)),
            records,
            boxes,
            section_planes,
            is_skin,
            band_starts,
            section_ids,
            cells,
            grids,
            solid.pitch / 2,
            options.light,
            _row_range(view, cam, visible),
        )
        for_each(add_faces, bands, faces, fresh, face, depths)
        return True

    def take_info(self) -> NDArray[np.float32] | None:
        """(H, W, 2). Depths and groups of the last frame, as in resolve.frag.glsl; then None until the next frame."""
        info, self._info = self._info, None
        return info

    def _buffer(self, name: str, shape: tuple[int, ...], kind: type) -> Any:
        """An array of this shape that is reused from frame to frame and keeps its content."""
        need = int(np.prod(shape))
        if name not in self._buffers or len(self._buffers[name]) < need:
            self._buffers[name] = np.zeros(need + need // 4, kind)
        return self._buffers[name][:need].reshape(shape)

    def release(self) -> None:
        """Frees the arrays."""
        self._buffers.clear()
        self.grids.clear()
        self.reset()


def _camera_of(view: View, rect: Rect) -> CameraRecord:
    """The camera of centred object space, for a rectangle of the picture."""
    x, y, width, height = rect
    cam = camera_record(view.camera)
    return cam._replace(
        translation=tuple(view.matrix[:3, 3].tolist()),
        cx=cam.cx - x,
        cy=cam.cy - y,
        width=float(width),
        height=float(height),
    )


def _plane_coordinates(view: View, faces: Sequence[Face], planes: int) -> Double:
    """(planes, 8). For each face e1 and e2 in camera space, each with its offset: s = e . p + offset."""
    coordinates = np.zeros((planes, 8))
    for f in faces:
        for k, axis in enumerate(frame_of(f.plane[:3])[:2]):
            rotated = view.matrix[:3, :3] @ axis
            coordinates[f.index, 4 * k : 4 * k + 3] = rotated
            coordinates[f.index, 4 * k + 3] = -rotated @ view.matrix[:3, 3]
    return coordinates


def _row_range(view: View, cam: CameraRecord, faces: Sequence[Face]) -> Double:
    """(2,). First and end row of the rectangle that faces can touch."""
    corners = np.concatenate([f.corners for f in faces])
    low, high = view.extent(corners, np.zeros(len(corners)))
    shift = view.camera.cy - cam.cy
    return np.clip([low[1] - shift - 1, high[1] - shift + 1], 0, int(cam.height))


def around(outer: Rect, hole: Rect) -> list[Rect]:
    """The part of a rectangle outside another one: strips above, below, left and right."""
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
    """The bounding rectangle of both; one without pixels is ignored."""
    if not a[2] or not a[3]:
        return b
    if not b[2] or not b[3]:
        return a
    x, y = min(a[0], b[0]), min(a[1], b[1])
    return x, y, max(a[0] + a[2], b[0] + b[2]) - x, max(a[1] + a[3], b[1] + b[3]) - y
