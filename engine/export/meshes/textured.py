"""Pieces with one texture for all of them: the skin's charts, and a chart for each plane that cuts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from engine.errors import InputError
from engine.export.colours import Colours
from engine.export.meshes.charts import SIDES, packed, rasterised
from engine.export.meshes.cutting import SKIN, Cut, MeshOptions, cut_skin, divided
from engine.export.meshes.surface import GAP, Skin, skin_of
from engine.scene.grid import Body
from engine.scene.plane import Plane, frame

__all__ = ["TexturedPiece", "TexturedPieces", "textured_pieces"]

SKIN_DETAIL = 0.25
"""Pitches. The skin has no finer texels: its atoms are no finer than half a pitch."""

COARSER = 1.25
"""Factor by which texels are enlarged, repeatedly, while the texture would be too large."""

BLED = 16
"""Texels around the skin's charts that take their nearest colour, so that reduced versions show no other."""


@dataclass(frozen=True)
class TexturedPiece:
    """A piece as a closed mesh, where it lies."""

    name: str
    points: NDArray[np.float64]
    """(V, 3). World units, the file's axes."""
    normals: NDArray[np.float64]
    """(V, 3). Unit, outwards; smooth on the skin, that of the plane on a face."""
    places: NDArray[np.float64]
    """(V, 2). Texture coordinates, from the lower left corner. Range [0, 1]."""
    triangles: NDArray[np.int32]
    """(T, 3). Counter-clockwise from outside."""
    volume: float
    """World units cubed."""


@dataclass(frozen=True)
class TexturedPieces:
    """Pieces and the texture of all of them."""

    pieces: tuple[TexturedPiece, ...]
    texture: NDArray[np.uint8]
    """(H, W, 3). sRGB as in the capture; the first row is the upper one."""


@dataclass(frozen=True)
class _Chart:
    """The part of a texture that shows a plane."""

    axes: NDArray[np.float64]
    """(3, 3). Rows: along columns, along rows, the plane's normal; right-handed."""
    corner: NDArray[np.float64]
    """(3,). Point at the outer corner of its first texel."""
    width: int
    height: int


def textured_pieces(
    body: Body, colours: Colours, wanted: Sequence[MeshOptions] | Sequence[Plane], texel: float | None, name: str
) -> TexturedPieces:
    """Pieces of a body, or all that planes divide it into, with texels of this size, world units; None: of one that
    keeps all details of the inside.

    Pieces without volume are left out. Raises InputError, in a line that begins with `name`, if none is left or if the
    skin alone is too large for a texture.
    """
    size = colours.detail if texel is None else texel
    skin = skin_of(body, max(size, SKIN_DETAIL * colours.atoms.pitch))
    given = divided(skin, [w for w in wanted if isinstance(w, Plane)]) or []
    pieces = [w for w in wanted if isinstance(w, MeshOptions)] or given
    cuts = [cut for cut in (cut_skin(skin, piece) for piece in pieces) if cut is not None]
    if not cuts:
        raise InputError(f"{name}: nothing to save; no part of the object is there")
    planes = list(dict.fromkeys(_facing(plane) for cut in cuts for plane in cut.planes))
    while True:
        charts = {p: chart for p in planes if (chart := _chart_of(p, cuts, size)) is not None}
        sizes = np.array([[skin.width, skin.height], *([c.width, c.height] for c in charts.values())])
        fitted = packed(sizes, GAP)
        if fitted is not None:
            break
        if max(skin.width, skin.height) > SIDES[-1] / 2:
            raise InputError(f"{name}: the texture is too large; give larger texels")
        size *= COARSER
    corners, (width, height) = fitted
    texture = np.zeros((height, width, 3), np.uint8)
    _paint(texture, corners[0], _skin_picture(skin, colours, size))
    for (plane, chart), corner in zip(charts.items(), corners[1:], strict=True):
        _paint(texture, corner, _face_picture(plane, chart, cuts, colours, size))
    placed = dict(zip(charts, corners[1:], strict=True))
    made = tuple(_piece(cut, corners[0], charts, placed, size, (width, height)) for cut in cuts)
    return TexturedPieces(made, texture)


def _facing(plane: Plane) -> Plane:
    """The same plane for both orientations of a plane: both sides show the same colours."""
    return max(plane, plane.flipped(), key=lambda p: p.normal)


def _chart_of(plane: Plane, cuts: Sequence[Cut], texel: float) -> _Chart | None:
    """The chart that all faces on a plane share; None if there are none."""
    axes = frame(plane.normal)
    points = np.concatenate([cut.points[_on(cut, plane)[0].ravel()] for cut in cuts]).astype(np.float64)
    if not len(points):
        return None
    flat = points @ axes[:2].T
    low, high = flat.min(0), flat.max(0)
    width, height = (np.ceil((high - low) / texel).astype(int) + 2 * GAP).tolist()
    start = (low + high) / 2 - np.array([width, height]) * texel / 2
    return _Chart(axes, start @ axes[:2] - plane.offset * axes[2], width, height)


def _on(cut: Cut, plane: Plane) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """(F, 3), (T,). The triangles of a piece that lie on a plane, from either side, and their mask."""
    numbers = [n for n, other in enumerate(cut.planes) if _facing(other) == plane]
    rows = np.isin(cut.face, numbers)
    return cut.triangles[rows], rows


def _in_chart(chart: _Chart, points: NDArray[np.floating], texel: float) -> NDArray[np.float64]:
    """(N, 2). Column and row of points (N, 3) in a chart."""
    return (points.astype(np.float64) - chart.corner) @ chart.axes[:2].T / texel


def _skin_picture(skin: Skin, colours: Colours, texel: float) -> NDArray[np.float32]:
    """(H, W, 3). What the skin's charts show; around them their nearest colour."""
    points, covered = rasterised(skin.texels, skin.triangles, skin.points, skin.width, skin.height)
    picture = np.zeros((skin.height, skin.width, 3), np.float32)
    picture[covered] = colours.skin(points[covered], texel)
    distance, nearest = ndimage.distance_transform_edt(~covered, return_indices=True)
    bled = picture[nearest[0], nearest[1]]
    bled[distance > BLED] = picture[covered].mean(0) if covered.any() else 0
    return bled


def _face_picture(
    plane: Plane, chart: _Chart, cuts: Sequence[Cut], colours: Colours, texel: float
) -> NDArray[np.float32]:
    """(H, W, 3). The inside on a plane, where faces are and GAP texels around them."""
    covered = np.zeros((chart.height, chart.width), bool)
    for cut in cuts:
        triangles, _ = _on(cut, plane)
        if len(triangles):
            texels = _in_chart(chart, cut.points, texel)
            covered |= rasterised(texels, triangles, np.zeros((len(texels), 0)), chart.width, chart.height)[1]
    around = ndimage.distance_transform_edt(~covered) <= GAP if covered.any() else np.ones_like(covered)
    rows, columns = np.nonzero(around)
    points = chart.corner + np.stack([columns + 0.5, rows + 0.5], 1) * texel @ chart.axes[:2]
    picture = np.zeros((chart.height, chart.width, 3), np.float32)
    picture[around] = rgb = colours.within(points, texel)
    picture[~around] = rgb.mean(0)
    return picture


def _paint(texture: NDArray[np.uint8], corner: NDArray[np.int64], picture: NDArray[np.float32]) -> None:
    """Puts a picture into the texture, in place."""
    (column, row), (height, width) = corner.tolist(), picture.shape[:2]
    texture[row : row + height, column : column + width] = np.round(picture * 255).astype(np.uint8)


def _piece(
    cut: Cut,
    skin_corner: NDArray[np.int64],
    charts: dict[Plane, _Chart],
    placed: dict[Plane, NDArray[np.int64]],
    texel: float,
    size: tuple[int, int],
) -> TexturedPiece:
    """A piece with its texture coordinates: a point on several charts occurs once for each."""
    points, normals, texels, triangles = [], [], [], []
    count = 0
    sides: list[tuple[NDArray[np.bool_], Plane | None]] = [(cut.face == SKIN, None)]
    sides += [(cut.face == n, plane) for n, plane in enumerate(cut.planes)]
    for rows, plane in sides:
        if not rows.any():
            continue
        used, own = np.unique(cut.triangles[rows], return_inverse=True)
        points.append(cut.points[used].astype(np.float64))
        if plane is None:
            normals.append(cut.normals[used].astype(np.float64))
            texels.append(cut.texels[used] + skin_corner)
        else:
            chart = charts[_facing(plane)]
            normals.append(np.tile(np.asarray(plane.normal), (len(used), 1)))
            texels.append(_in_chart(chart, cut.points[used], texel) + placed[_facing(plane)])
        triangles.append(own.reshape(-1, 3) + count)
        count += len(used)
    at, turn = np.concatenate(points), cut.wanted.transform
    out = np.concatenate(normals)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    places = np.concatenate(texels) / size
    places[:, 1] = 1 - places[:, 1]
    return TexturedPiece(
        cut.wanted.name,
        at @ turn[:3, :3].T + turn[:3, 3],
        np.divide(out, length, out=np.tile([0.0, 0, 1], (len(out), 1)), where=length > 1e-6) @ turn[:3, :3].T,
        places,
        np.concatenate(triangles).astype(np.int32),
        cut.volume,
    )
