"""The opaque image: surface splatting outside, the kernel field on cut faces. CPU, float32.

The result is linear in the colours and independent of the order of the atoms. Pieces that lie together share one front,
so that the skins of two halves add up to the whole skin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.outside import camera_planes, draw, splats_of, view_colours
from engine.render.cpu.ray_entry import Hits, coverage, enter, shade
from engine.render.projection import camera_record
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.constants import JOINT_PITCHES
from engine.scene.image import Picture
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["render", "render_pieces"]

Float = NDArray[np.float32]


def render(
    atoms: Atoms,
    camera: Camera,
    planes: Sequence[Plane] = (),
    background: Sequence[float] = (1.0, 1.0, 1.0),
    light: bool = False,
    field: KernelField | None = None,
) -> Picture:
    """The part of the atoms that the planes keep; `light` shades cut faces slightly by their slant to the eye.

    `field` is KernelField(atoms), for callers that draw the same atoms often; None makes it here if it is needed.
    """
    return render_pieces(atoms, camera, [Piece(tuple(planes))], background, light, field)


def render_pieces(
    atoms: Atoms,
    camera: Camera,
    pieces: Sequence[Piece],
    background: Sequence[float] = (1.0, 1.0, 1.0),
    light: bool = False,
    field: KernelField | None = None,
) -> Picture:
    """Several pieces of the same atoms in one picture.

    Pieces with the same transform fit together as in the uncut object and share their sums. Groups that were moved
    apart are rendered separately and composited by depth, so that an edge is blended with what lies behind it.
    """
    if not pieces:
        shape = (camera.height, camera.width)
        blank = np.broadcast_to(np.asarray(background, np.float32), (*shape, 3)).copy()
        return Picture(blank, np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32))
    if any(piece.planes for piece in pieces) and field is None:
        field = KernelField(atoms)
    groups: dict[bytes, list[Piece]] = {}
    for piece in pieces:
        groups.setdefault(np.ascontiguousarray(piece.transform, np.float64).tobytes(), []).append(piece)
    middle = np.append(atoms.bounds.mean(0), 1.0)
    by_depth = sorted(groups.values(), key=lambda group: (group[0].camera(camera).viewmat @ middle)[2])
    result = over([group_layer(atoms, camera, group, light, field) for group in by_depth])
    rgb = result.rgb + (1 - result.alpha)[..., None] * np.asarray(background, np.float32)
    return Picture(rgb, result.alpha, result.depth)


@dataclass(frozen=True)
class Layer:
    """A picture to composite with others."""

    rgb: Float
    """(H, W, 3). Weighted by alpha."""
    alpha: Float
    """(H, W). Range [0, 1]."""
    depth: Float
    """(H, W). Along the camera's axis, world units; inf where the layer is empty."""
    solid: Float
    """(H, W). The depth where the layer hides what is behind it, at a core of the outside or on a face with coverage of
    a half; inf elsewhere."""


def group_layer(atoms: Atoms, camera: Camera, pieces: Sequence[Piece], light: bool, field: KernelField | None) -> Layer:
    """Pieces that lie together: their outside, and their faces where no other piece is joined."""
    colours = [view_colours(atoms, piece.camera(camera)) for piece in pieces]
    outside = draw(splats_of(atoms), colours, camera, pieces, atoms.pitch)
    layers = [Layer(*outside.resolved(), outside.front, outside.front)]
    for piece in pieces:
        if piece.planes and field is not None:
            view = piece.camera(camera)
            hits = enter(camera_record(view), camera_planes(view, piece.planes))
            others = [other.planes for other in pieces if other is not piece]
            hits = hits.outside(others, JOINT_PITCHES * atoms.pitch)
            # First in the list: nothing of a piece is in front of its own cut, so the face wins equal depths.
            layers.insert(0, face_layer(field, atoms.pitch, hits, (camera.height, camera.width), light))
    return over(layers)


def face_layer(field: KernelField, pitch: float, hits: Hits, shape: tuple[int, int], light: bool) -> Layer:
    """The cut faces of one piece in a picture of this shape."""
    rgb, density = field.at(hits.points, hits.footprint)
    alpha = coverage(density, hits.footprint, pitch)
    if light:
        rgb = rgb * shade(hits)[:, None]
    weighted, covered = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    depth = np.full(shape, np.inf, np.float32)
    weighted.reshape(-1, 3)[hits.pixels] = rgb * alpha[:, None]
    covered.reshape(-1)[hits.pixels] = alpha
    depth.reshape(-1)[hits.pixels] = np.where(alpha > 0, hits.depth, np.inf)
    return Layer(weighted, covered, depth, np.where(covered >= 0.5, depth, np.float32(np.inf)))


def over(layers: Sequence[Layer]) -> Layer:
    """Layers composited by depth, pixel by pixel; at equal depths the first one is in front."""
    if len(layers) == 1:
        return layers[0]
    rank = np.argsort(np.stack([layer.depth for layer in layers]), axis=0, kind="stable")
    rgb = np.take_along_axis(np.stack([layer.rgb for layer in layers]), rank[..., None], 0)
    alpha = np.take_along_axis(np.stack([layer.alpha for layer in layers]), rank, 0)
    colour, left = rgb[0], 1 - alpha[0]
    for k in range(1, len(layers)):
        colour = colour + left[..., None] * rgb[k]
        left = left * (1 - alpha[k])
    solid = np.minimum.reduce([layer.solid for layer in layers])
    return Layer(colour, 1 - left, solid, solid)
