"""The opaque image (DESIGN, section 3): surface splatting outside, the kernel field on cut faces. CPU, float32.

The result is linear in the colours and does not depend on the order of the atoms. Pieces share one front: what two
halves leave of the skin adds up to what it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.atoms import Atoms
from engine.camera import Camera
from engine.faces import Hits, coverage, enter, shade
from engine.kernel_field import KernelField
from engine.outside import camera_planes, draw, splats_of, view_colours
from engine.picture import Picture
from engine.piece import Piece
from engine.plane import Plane
from engine.projection import pack_camera

__all__ = ["render", "render_pieces"]

Float = NDArray[np.float32]

JOINT_PITCHES = 1e-3
"""Pieces that did not move apart have no face between them; a point this near the other's plane touches it."""


def render(
    atoms: Atoms,
    camera: Camera,
    planes: Sequence[Plane] = (),
    background: Sequence[float] = (1.0, 1.0, 1.0),
    light: bool = False,
    field: KernelField | None = None,
) -> Picture:
    """What the planes leave of the atoms; `light` shades cut faces a little by their slant to the eye.

    `field` is KernelField(atoms), for callers that draw the same atoms often; made here where it is needed and absent.
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
    """Several pieces of the same atoms in one picture."""
    colours = [view_colours(atoms, piece.camera(camera)) for piece in pieces]
    outside = draw(splats_of(atoms), colours, camera, pieces, atoms.pitch)
    layers = [Layer(*outside.resolved(), outside.front)]
    if any(piece.planes for piece in pieces) and field is None:
        field = KernelField(atoms)
    for piece in pieces:
        if piece.planes and field is not None:
            joined = [p.planes for p in pieces if p is not piece and np.array_equal(p.transform, piece.transform)]
            view = piece.camera(camera)
            hits = enter(pack_camera(view), camera_planes(view, piece.planes))
            hits = hits.outside(joined, JOINT_PITCHES * atoms.pitch)
            layers.append(face_layer(field, atoms.pitch, hits, (camera.height, camera.width), light))
    return compose(layers, background)


@dataclass(frozen=True)
class Layer:
    """Something to put over something else."""

    rgb: Float
    """(H, W, 3). Weighted by alpha."""
    alpha: Float
    """(H, W). Range [0, 1]."""
    depth: Float
    """(H, W). Where it lies; inf where it is not."""


def face_layer(field: KernelField, pitch: float, hits: Hits, shape: tuple[int, int], light: bool) -> Layer:
    """The cut faces of one piece in a picture of this shape."""
    rgb, density = field.at(hits.points, hits.footprint)
    alpha = coverage(density, hits.footprint, pitch)
    if light:
        rgb = rgb * shade(hits)[:, None]
    full = Layer(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32))
    full.rgb.reshape(-1, 3)[hits.pixels] = rgb * alpha[:, None]
    full.alpha.reshape(-1)[hits.pixels] = alpha
    full.depth.reshape(-1)[hits.pixels] = np.where(alpha > 0, hits.depth, np.inf)
    return full


def compose(layers: Sequence[Layer], background: Sequence[float]) -> Picture:
    """Layers over each other in order of depth, over the background. The first layer is the outside.

    The depth of the picture is the nearest face's that covers half of the pixel, or the outside's if that is nearer.
    """
    outside = layers[0]
    ordered = list(layers)
    if len(layers) == 2:
        ordered = [layers[1], outside]  # nothing of a piece lies before its own cut
    elif len(layers) > 2:
        rank = np.argsort(np.stack([layer.depth for layer in layers]), axis=0, kind="stable")
        rgb, alpha = np.stack([layer.rgb for layer in layers]), np.stack([layer.alpha for layer in layers])
        depth = np.stack([layer.depth for layer in layers])
        rgb = np.take_along_axis(rgb, rank[..., None], 0)
        alpha, depth = np.take_along_axis(alpha, rank, 0), np.take_along_axis(depth, rank, 0)
        ordered = [Layer(*parts) for parts in zip(rgb, alpha, depth, strict=True)]
    colour, left = np.zeros_like(outside.rgb), np.ones_like(outside.alpha)
    for layer in ordered:
        colour = colour + left[..., None] * layer.rgb
        left = left * (1 - layer.alpha)
    depth = outside.depth
    for layer in layers[1:]:
        depth = np.where((layer.alpha >= 0.5) & (layer.depth < depth), layer.depth, depth)
    return Picture(colour + left[..., None] * np.asarray(background, np.float32), 1 - left, depth)
