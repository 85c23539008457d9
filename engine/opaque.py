"""The opaque image (DESIGN, section 3): surface splatting outside, the kernel field on cut faces. CPU, float32.

The result is linear in the colours and does not depend on the order of the atoms. Pieces share one front: what two
halves leave of the skin adds up to what it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine import sh
from engine.atoms import Atoms
from engine.camera import Camera
from engine.faces import Hits, coverage, enter, shade
from engine.formula import EPSILON_PITCHES
from engine.kernel_field import KernelField
from engine.picture import Picture
from engine.piece import Piece
from engine.plane import Plane, stack
from engine.projection import pack_camera
from engine.splat_kernels import RECORD, TILE, accumulate, list_tiles, project, resolve

__all__ = ["Splats", "camera_planes", "render", "render_pieces", "splats", "view_colours"]

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
    drawn = splats(atoms, camera, pieces)
    shape = (camera.height, camera.width)
    rgb, alpha = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    resolve(drawn.sums, rgb, alpha)
    layers = [Layer(rgb, alpha, drawn.front)]
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


@dataclass(frozen=True)
class Splats:
    """The outside before it is resolved, and what it was made of."""

    cam: NDArray[np.float64]
    """Packed camera."""
    planes: NDArray[np.float64]
    """(P, 4). Planes of all pieces in camera space."""
    records: Float
    """(pieces * N, RECORD). Projected splats, piece after piece."""
    spans: NDArray[np.int32]
    """(pieces * N, 6). Tiles and planes of each."""
    colours: Float
    """(pieces * N, 3)."""
    first: NDArray[np.int64]
    """(tiles + 1,). Where the list of each tile begins."""
    listed: NDArray[np.int32]
    """(pairs,). Splats of the tiles."""
    front: Float
    """(H, W). Depth of the nearest core; inf where there is none."""
    sums: Float
    """(H, W, 5). Weight, weight times sharpness, weight times RGB."""

    @property
    def columns(self) -> int:
        """Tiles in a row of the picture."""
        return -(-self.front.shape[1] // TILE)


def splats(atoms: Atoms, camera: Camera, pieces: Sequence[Piece]) -> Splats:
    """The outside of the pieces: surface atoms and exposed interior ones, both passes."""
    surface, interior, exposed = atoms.surface, atoms.interior, atoms.interior.exposed
    upright = np.zeros((exposed, 4), np.float32)
    upright[:, 0] = 1
    means = np.concatenate([surface.means, interior.means[:exposed]])
    scales = np.concatenate([surface.scales, np.repeat(interior.sigmas[:exposed, None], 3, 1)])
    quats = np.concatenate([surface.quats, upright])

    cam = pack_camera(camera)
    count = len(means)
    records = np.empty((len(pieces) * count, RECORD), np.float32)
    spans = np.empty((len(pieces) * count, 6), np.int32)
    views = [piece.camera(camera) for piece in pieces]
    planes = np.concatenate(
        [np.zeros((0, 4))] + [camera_planes(v, p.planes) for v, p in zip(views, pieces, strict=True)]
    )
    end = np.cumsum([0] + [len(p.planes) for p in pieces])
    colours = np.empty((len(pieces) * count, 3), np.float32)
    for k, view in enumerate(views):
        own = slice(k * count, (k + 1) * count)
        project(pack_camera(view), planes, end[k : k + 2], means, scales, quats, records[own], spans[own])
        colours[own][: len(surface)] = view_colours(surface.sh, surface.means, view)
        colours[own][len(surface) :] = interior.rgb[:exposed]

    columns, rows = -(-camera.width // TILE), -(-camera.height // TILE)
    first, listed = list_tiles(spans, columns, rows)
    front = np.empty((camera.height, camera.width), np.float32)
    sums = np.empty((camera.height, camera.width, 5), np.float32)
    layer = EPSILON_PITCHES * atoms.pitch
    accumulate(cam, planes, records, spans, colours, first, listed, columns, layer, front, sums)
    return Splats(cam, planes, records, spans, colours, first, listed, front, sums)


def view_colours(coefficients: Float, means: Float, camera: Camera) -> Float:
    """(N, 3). RGB of splats as this camera sees them: from eye to mean, orthographic along the view."""
    if coefficients.shape[1] == 1:
        return sh.sh_to_rgb(coefficients[:, 0]).astype(np.float32)
    if camera.orthographic:
        way = np.broadcast_to(camera.forward.astype(np.float32), means.shape)
    else:
        way = means - camera.position.astype(np.float32)
        way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    return sh.colours(coefficients, way).astype(np.float32)


def camera_planes(camera: Camera, planes: Sequence[Plane]) -> NDArray[np.float64]:
    """(P, 4). The planes' a, b, c, d in camera space."""
    rows = stack(planes)
    rows[:, :3] = rows[:, :3] @ camera.viewmat[:3, :3].T
    rows[:, 3] -= rows[:, :3] @ camera.viewmat[:3, 3]
    return rows


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
