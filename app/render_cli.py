"""`fruitninja-render`: a picture of a trained object, cut by planes, without a window."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from engine.command import parse_numbers, parse_plane, print_result, run_command
from engine.errors import InputError
from engine.io.picture_file import save_png
from engine.io.trained import load_trained
from engine.render.cpu.opaque import render
from engine.render.face_detail import Detailed, detailed
from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, equator, fit_distance, orbit
from engine.scene.image import Picture
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.priors.inside_file import read_inside

__all__ = ["default_angles", "main"]

FIELD_OF_VIEW = math.radians(35.0)
"""Vertical, radians: a portrait lens, with little perspective distortion."""

LARGEST = 16384
"""Pixels of a side: the smallest texture limit of OpenGL 4 drivers."""

EPILOG = (
    "A plane keeps the side where a x + b y + c z + d is negative; several planes keep what all of them keep. "
    "Distance 1 fits the object into the picture."
)


def render_command(
    trained: Annotated[Path, typer.Argument(help="A trained object with its sidecar, as fruitninja-train writes it.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The picture (.png).")],
    plane: Annotated[list[str] | None, typer.Option(help="A cut a,b,c,d; give it again for more.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="azimuth,elevation,distance: degrees, degrees, times the fitting distance.")
    ] = None,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "1280x720",
) -> None:
    """Draw a trained object, whole or cut open, into a PNG."""
    planes = tuple(parse_plane(text) for text in plane or [])
    width, height = parse_size(size)
    angles = None if camera is None else parse_numbers(camera, 3, f"--camera {camera}: give azimuth,elevation,distance")
    if angles and not angles[2] > 0:
        raise InputError(f"--camera {camera}: the distance must be above 0; 1 fits the object into the picture")
    if out.suffix.lower() != ".png":
        raise InputError(f"{out}: the picture is a PNG; give a name that ends in .png")
    atoms, meta = load_trained(trained)
    view = camera_for(atoms, meta.up, planes, angles, width, height)
    picture, who = draw(atoms, view, planes)
    inside = read_inside(trained) if planes else None
    if inside is not None:
        picture = detailed(picture, view, [Piece(planes)], [Detailed(inside, atoms.pitch)], light=False)
    save_png(out, picture.rgb)
    print_result(f"{out} ({width}x{height}, drawn by {who})")


def draw(atoms: Atoms, camera: Camera, planes: tuple[Plane, ...]) -> tuple[Picture, str]:
    """The picture, and which renderer drew it: OpenGL if available, else the CPU renderer."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        return render(atoms, camera, planes), f"the CPU renderer: {missing}"
    with renderer:
        renderer.set_atoms(atoms)
        renderer.render(camera, [Piece(planes)])
        return renderer.read(), f"OpenGL: {renderer.ctx.info['GL_RENDERER']}"


def camera_for(
    atoms: Atoms,
    up: tuple[float, float, float],
    planes: tuple[Plane, ...],
    angles: list[float] | None,
    width: int,
    height: int,
) -> Camera:
    """The camera on its orbit about the object's centre, `angles` as in --camera; None: one that shows the cut."""
    points = np.concatenate([atoms.surface.means, atoms.interior.means]).astype(np.float64)
    if angles is None:  # then the picture frames the part that is left
        for plane in planes:
            left = points[plane.distance(points) <= 0]
            points = left if len(left) else points
    azimuth, elevation, distance = angles or (*default_angles(planes, np.asarray(up)), 1.05)
    centre, radius = np.zeros(3), 1.0
    if len(points):
        centre = (points.min(0) + points.max(0)) / 2
        radius = float(np.linalg.norm(points - centre, axis=1).max()) + atoms.pitch
    fit = fit_distance(radius, FIELD_OF_VIEW, width / height)
    return orbit(centre, up, azimuth, elevation, distance * fit, width, height, FIELD_OF_VIEW)


def default_angles(planes: tuple[Plane, ...], up: NDArray[np.floating]) -> tuple[float, float]:
    """Azimuth and elevation, degrees, of a view onto the cut faces, a little from the side."""
    out = np.sum([p.normal for p in planes], axis=0) if planes else np.zeros(3)
    if np.linalg.norm(out) < 1e-6:
        return 30.0, 20.0
    out = out / np.linalg.norm(out)
    axis = np.asarray(up, np.float64) / np.linalg.norm(up)
    e1, e2 = equator(axis)
    elevation = math.degrees(math.asin(float(np.clip(out @ axis, -1, 1))))
    if abs(elevation) > 65:  # from above, turning about the axis shows no side: lower the elevation instead
        return 30.0, math.copysign(52.0, elevation)
    azimuth = math.degrees(math.atan2(float(out @ e2), float(out @ e1)))
    return azimuth + 20.0, min(elevation + 15.0, 65.0)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of WIDTHxHEIGHT."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdecimal() and p.isascii() and 1 <= int(p) <= LARGEST for p in parts):
        raise InputError(f"--size {text}: give WIDTHxHEIGHT, each from 1 to {LARGEST}, as in 1280x720")
    return int(parts[0]), int(parts[1])


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-render", render_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
