"""Cut faces in all the detail that the inside has, for pictures that stand still.

Atoms show an inside only as finely as their lattice; a picture of a face may have three pixels for each. Once a picture
has been drawn, the pixels of its faces are read from the inside itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import face_layer
from engine.render.cpu.outside import camera_planes
from engine.render.cpu.ray_entry import enter, shade
from engine.render.projection import camera_record
from engine.scene.camera import Camera
from engine.scene.image import Picture
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from engine.threads import cores

__all__ = ["RIM", "Detailed", "FaceDetail", "FaceReading", "detailed", "detailed_from", "read_face", "straight_face"]

OF_A_CORE = 50_000
"""Points for each core that are read at once, a tenth of a second: a reading no longer wanted ends that soon. For a
quilt, four times as many take as long per point; with an eighth each point takes half as long again."""

TOLERANCE = 0.1
"""Most pitches between the depth of a pixel and that of a face which it shows: far more than rounding, far less than
the step to what lies beside it."""

RIM = 1.5
"""Pitches from the edge of a face over which the colours of atoms pass into those of the inside: the atoms there are
the skin's."""

SPLINE = 3
"""Degree of the splines between the pixels of a reading: linear ones blur its details."""


@dataclass(frozen=True)
class Detailed:
    """What a solid's faces are read from."""

    inside: Inside
    pitch: float
    """Pitch of its atoms, world units."""


@dataclass(frozen=True)
class _Face:
    """The pixels of one piece's faces."""

    inside: Inside
    footprint: float
    pixels: NDArray[np.intp]
    """(N,). Flat indices into the picture."""
    points: NDArray[np.float64]
    """(N, 3). Object space."""
    light: NDArray[np.float32]
    """(N,). Brightness."""
    share: NDArray[np.float32]
    """(N,). Weight of the reading, range (0, 1]: 1 inside the face, less at its rim."""


class FaceDetail:
    """A picture whose faces are read from the inside, some pixels at a time."""

    def __init__(
        self,
        picture: Picture,
        camera: Camera,
        pieces: Sequence[Piece],
        solids: Sequence[Detailed | None],
        light: bool,
    ) -> None:
        """`picture` shows the `pieces`, drawn with or without face light; `solids`: by `Piece.solid`, None for those
        that have nothing but atoms."""
        self.rgb = picture.rgb.copy()
        """(H, W, 3). The picture, as far as it has been read."""
        self._faces = []
        for piece in pieces:
            solid = solids[piece.solid]
            if solid is not None and piece.planes:
                self._faces += _faces_of(picture, camera, piece, solid, light)
        self._done = 0

    @property
    def ended(self) -> bool:
        """Whether all faces have been read."""
        return not self._faces

    def advance(self) -> None:
        """Reads the next pixels."""
        face, count = self._faces[0], OF_A_CORE * cores()
        rows = slice(self._done, self._done + count)
        rgb = face.inside.at(face.points[rows], face.footprint) * face.light[rows, None]
        flat = self.rgb.reshape(-1, 3)
        pixels, share = face.pixels[rows], face.share[rows, None]
        flat[pixels] += share * (rgb - flat[pixels])
        self._done += count
        if self._done >= len(face.pixels):
            self._faces.pop(0)
            self._done = 0


def detailed(
    picture: Picture, camera: Camera, pieces: Sequence[Piece], solids: Sequence[Detailed | None], light: bool
) -> Picture:
    """The picture with all of its faces read from the inside; arguments as in `FaceDetail`."""
    work = FaceDetail(picture, camera, pieces, solids, light)
    while not work.ended:
        work.advance()
    return Picture(work.rgb, picture.alpha, picture.depth)


@dataclass(frozen=True)
class FaceReading:
    """A face that was read once, for several pictures of it."""

    camera: Camera
    """Straight in front of it, orthographic."""
    rgb: NDArray[np.float32]
    """(H, W, 3). The inside, without light; outside the face, what the camera sees."""


def read_face(picture: Picture, camera: Camera, piece: Piece, solid: Detailed) -> FaceReading:
    """The face that an orthographic camera straight in front of it sees; `picture` is what it sees of the atoms."""
    rgb = picture.rgb.copy()
    for face in _faces_of(picture, camera, piece, solid, False):
        rgb.reshape(-1, 3)[face.pixels] = face.inside.at(face.points, face.footprint)
    return FaceReading(camera, rgb)


def detailed_from(
    reading: FaceReading, picture: Picture, camera: Camera, piece: Piece, solid: Detailed, light: bool
) -> Picture:
    """`detailed` for a face that was read before: it costs next to nothing, and is as sharp if the pixels of the
    reading are as small as those of the picture."""
    ahead = reading.camera
    rgb = picture.rgb.copy()
    flat = rgb.reshape(-1, 3)
    for face in _faces_of(picture, camera, piece, solid, light):
        x, y, _ = ahead.viewmat[:3, :3] @ face.points.T + ahead.viewmat[:3, 3:]
        at = y * ahead.fy + ahead.cy - 0.5, x * ahead.fx + ahead.cx - 0.5
        seen = [ndimage.map_coordinates(reading.rgb[..., c], at, order=SPLINE, mode="nearest") for c in range(3)]
        colours = np.clip(np.stack(seen, axis=1), 0, 1) * face.light[:, None]
        flat[face.pixels] += face.share[:, None] * (colours - flat[face.pixels])
    return Picture(rgb, picture.alpha, picture.depth)


def straight_face(field: KernelField, pitch: float, camera: Camera, plane: Plane) -> Picture:
    """Only the cut face that a camera in front of a plane sees, over black, without light: of everything that the
    field's atoms, which have this pitch, fill."""
    hits = enter(camera_record(camera), camera_planes(camera, [plane]))
    layer = face_layer(field, pitch, hits, (camera.height, camera.width), False)
    return Picture(layer.rgb, layer.alpha, layer.depth)


def _faces_of(picture: Picture, camera: Camera, piece: Piece, solid: Detailed, light: bool) -> list[_Face]:
    """The visible pixels of a piece's faces, none or one."""
    view = piece.camera(camera)
    hits = enter(camera_record(view), camera_planes(view, piece.planes))
    depth = picture.depth.reshape(-1)[hits.pixels]
    seen = np.abs(depth - hits.depth) < TOLERANCE * solid.pitch
    if not seen.any():
        return []
    shown = np.zeros(picture.alpha.shape, bool)
    shown.reshape(-1)[hits.pixels[seen]] = True
    # Half a pixel less: the outermost pixel of a face also shows what is behind it.
    from_edge = ndimage.distance_transform_edt(np.pad(shown, 1))[1:-1, 1:-1].reshape(-1)[hits.pixels] - 0.5
    share = np.clip(from_edge * hits.footprint / (RIM * solid.pitch), 0, 1).astype(np.float32)
    share[from_edge < 1] = 0
    rows = np.flatnonzero(seen & (share > 0))
    if not len(rows):
        return []
    brightness = shade(hits)[rows] if light else np.ones(len(rows), np.float32)
    footprint = float(np.median(hits.footprint[rows]))
    return [_Face(solid.inside, footprint, hits.pixels[rows], hits.points[rows], brightness, share[rows])]
