"""Draws pictures of a solid: from a camera, with or without OpenGL, and of a cut face seen straight on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from engine.errors import InputError
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render_pieces
from engine.render.face_detail import Detailed, detailed, straight_face
from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms
from engine.scene.camera import SECTION_WIDTH, Camera, equator, fit_distance, orbit, plane_points, section
from engine.scene.image import Picture, to_8bit
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = [
    "LARGEST",
    "MARGIN",
    "Rgb",
    "ball_around",
    "camera_for",
    "check_size",
    "default_angles",
    "draw_section",
    "drawing",
    "frame",
]

FIELD_OF_VIEW = math.radians(35.0)
"""Vertical field of view, radians: a portrait lens, with little perspective distortion."""

LARGEST = 16384
"""Most pixels along a side: the smallest texture limit of OpenGL 4 drivers."""

MARGIN = 1.05
"""Distance of the default view, in fitting distances: at 1 the object would touch the edges of the picture."""

Rgb = tuple[float, float, float]
"""A colour as RGB, range [0, 1]."""

Draw = Callable[[Camera, Sequence[Piece], Rgb, bool], Picture]
"""Draws pieces over a background colour, with or without light on their faces."""


@contextmanager
def drawing(solids: Sequence[Atoms], is_cut: bool) -> Iterator[tuple[Draw, str]]:
    """Yields a function that draws solids, whole or cut, and the renderer's name: OpenGL if available, else the CPU
    renderer, which draws only one solid. Raises InputError for several solids without OpenGL."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        if len(solids) != 1:
            raise InputError(f"several objects are drawn with OpenGL only: {missing}") from missing
        (atoms,) = solids
        field = KernelField(atoms) if is_cut else None

        def by_kernels(camera: Camera, pieces: Sequence[Piece], ground: Rgb, light: bool) -> Picture:
            return render_pieces(atoms, camera, pieces, ground, light, field)

        yield by_kernels, f"the CPU renderer: {missing}"
        return
    with renderer:
        renderer.set_atoms(*solids)

        def by_opengl(camera: Camera, pieces: Sequence[Piece], ground: Rgb, light: bool) -> Picture:
            renderer.render(camera, pieces, background=ground, light=light)
            return renderer.read()

        yield by_opengl, f"OpenGL: {renderer.ctx.info['GL_RENDERER']}"


def frame(
    draw: Draw,
    solids: Sequence[Detailed | None],
    view: Camera,
    pieces: Sequence[Piece],
    ground: Rgb | None,
    light: bool,
) -> NDArray[np.uint8]:
    """(H, W, 4). One picture with full detail on its faces, over the colour `ground` or, for None, with straight alpha.

    `solids`: what the faces of each solid are read from, None for a solid that has only atoms.
    """
    picture = draw(view, pieces, ground or (0.0, 0.0, 0.0), light)
    if any(solids):
        picture = detailed(picture, view, pieces, solids, light)
    if ground is None:
        return picture.straight_alpha()
    return np.dstack([to_8bit(picture.rgb), np.full(picture.alpha.shape, 255, np.uint8)])


def draw_section(
    field: KernelField,
    pitch: float,
    inside: Inside | None,
    plane: Plane,
    planes: Sequence[Plane],
    up: ArrayLike,  # [3]
    bounds: NDArray[np.floating],  # [2, 3]
    size: int,
    width: float | None,
) -> Picture:
    """The cut face in `plane` seen straight on, over black, without what `planes` cut away. It is drawn from the atoms
    of `field`, which have this pitch, or read from `inside`. The picture has `size` pixels a side and is `width` world
    units wide; None: as wide as the bounds need."""
    view = section(plane, up, bounds, size, None if width is None else width / (2 * SECTION_WIDTH))
    picture = straight_face(field, pitch, view, plane)
    if inside is not None:
        picture = detailed(picture, view, [Piece((plane,))], [Detailed(inside, pitch)], light=False)
    if not planes:
        return picture
    points = plane_points(view, plane)
    kept = np.logical_and.reduce([other.distance(points) <= 0 for other in planes])
    return replace(picture, rgb=picture.rgb * kept[..., None], alpha=picture.alpha * kept)


def camera_for(
    atoms: Atoms,
    up: ArrayLike,  # [3]
    planes: Sequence[Plane],
    angles: Sequence[float] | None,
    width: int,
    height: int,
) -> Camera:
    """The camera that orbits the object's centre. `angles`: azimuth and elevation in degrees, and the distance as a
    multiple of the fitting one; None: a view that shows the cut."""
    points = np.concatenate([atoms.surface.means, atoms.interior.means]).astype(np.float64)
    if angles is None:  # the default view frames the part that is left
        for plane in planes:
            left = points[plane.distance(points) <= 0]
            points = left if len(left) else points
    azimuth, elevation, distance = angles or (*default_angles(planes, np.asarray(up)), MARGIN)
    centre, radius = ball_around(points, atoms.pitch)
    fit = fit_distance(radius, FIELD_OF_VIEW, width / height)
    return orbit(centre, up, azimuth, elevation, distance * fit, width, height, FIELD_OF_VIEW)


def ball_around(points: NDArray[np.float64], pitch: float) -> tuple[NDArray[np.float64], float]:
    """Centre (3,) and radius of the ball around atoms with centres (N, 3), which a picture is fitted to."""
    if not len(points):
        return np.zeros(3), 1.0
    centre = (points.min(0) + points.max(0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + pitch


def default_angles(planes: Sequence[Plane], up: NDArray[np.floating]) -> tuple[float, float]:
    """Azimuth and elevation, in degrees, of a view onto the cut faces from slightly to one side."""
    out = np.sum([p.normal for p in planes], axis=0) if planes else np.zeros(3)
    if np.linalg.norm(out) < 1e-6:
        return 30.0, 20.0
    out = out / np.linalg.norm(out)
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    e1, e2 = equator(axis)
    elevation = math.degrees(math.asin(float(np.clip(out @ axis, -1, 1))))
    if abs(elevation) > 65:  # seen from above, turning about the axis reveals no side: lower the elevation instead
        return 30.0, math.copysign(52.0, elevation)
    azimuth = math.degrees(math.atan2(float(out @ e2), float(out @ e1)))
    return azimuth + 20.0, min(elevation + 15.0, 65.0)


def check_size(*sides: int) -> None:
    """Raises InputError if a picture cannot have sides of these many pixels."""
    if not all(1 <= side <= LARGEST for side in sides):
        raise InputError(f"size {'x'.join(map(str, sides))}: give pixels, each side from 1 to {LARGEST}")
