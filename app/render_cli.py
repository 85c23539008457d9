"""`fruitninja-render`: a picture or a film of a trained object, cut by planes, without a window."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from app.film_cli import Scene, make_film, save_film
from app.jobs.export import save_still
from engine.command import parse_numbers, parse_plane, print_result, run_command
from engine.errors import InputError
from engine.io.picture_file import save_png
from engine.io.trained import load_trained
from engine.render.cpu.kernel_field import KernelField
from engine.render.cpu.opaque import render_pieces
from engine.render.face_detail import Detailed, detailed
from engine.render.gl import GLMissing, Renderer
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera, equator, fit_distance, orbit
from engine.scene.image import Picture, to_8bit
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.priors.inside_file import read_inside

__all__ = ["default_angles", "main"]

FIELD_OF_VIEW = math.radians(35.0)
"""Vertical, radians: a portrait lens, with little perspective distortion."""

LARGEST = 16384
"""Pixels of a side: the smallest texture limit of OpenGL 4 drivers."""

MARGIN = 1.05
"""Distance without --camera: what fits exactly touches the edges."""

Rgb = tuple[float, float, float]
"""A colour, range [0, 1]."""

NAMED: dict[str, Rgb | None] = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), "transparent": None}

EPILOG = (
    "A plane keeps the side where a x + b y + c z + d is negative; several planes keep what all of them keep. "
    "Distance 1 fits the object into the picture. In a film the first plane sweeps, or all of them part what explodes. "
    "A film into a folder goes on where it was stopped. docs/EXPORT.md has the form of keyframes."
)

Draw = Callable[[Camera, Sequence[Piece], Rgb, bool], Picture]
"""Draws pieces over a colour, with or without light on their faces."""


def render_command(
    trained: Annotated[Path, typer.Argument(help="A trained object with its sidecar, as fruitninja-train writes it.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="A picture (.png, .webp); a film (.gif, .mp4, .webp), or its folder."),
    ],
    plane: Annotated[list[str] | None, typer.Option(help="A cut a,b,c,d; give it again for more.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="azimuth,elevation,distance: degrees, degrees, times the fitting distance.")
    ] = None,
    size: Annotated[str, typer.Option(help="WIDTHxHEIGHT in pixels.")] = "1280x720",
    background: Annotated[str, typer.Option(help="white, black, #rrggbb, or transparent (.png, .webp).")] = "white",
    film: Annotated[
        str | None, typer.Option(help="Draw a film: turntable, sweep, explode, or a file of keyframes (.json).")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="How long the film is; 6 unless told.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second; 25 unless told.")] = None,
) -> None:
    """Draw a trained object, whole or cut open, into a picture, or a film of it."""
    planes = tuple(parse_plane(text) for text in plane or [])
    width, height = parse_size(size)
    angles = None if camera is None else parse_numbers(camera, 3, f"--camera {camera}: give azimuth,elevation,distance")
    if angles and not angles[2] > 0:
        raise InputError(f"--camera {camera}: the distance must be above 0; 1 fits the object into the picture")
    ground = parse_background(background)
    if film is not None:
        wanted = make_film(film, out, planes, camera is not None, seconds, fps, ground is None)
    elif out.suffix.lower() not in (".png", ".webp"):
        raise InputError(f"{out}: the picture is a PNG or WebP; give a name that ends in .png, or --film for a film")
    elif seconds is not None or fps is not None:
        raise InputError("--seconds and --fps are of a film; give --film too")
    atoms, meta = load_trained(trained)
    inside = read_inside(trained) if planes or film is not None else None
    with drawing(atoms, bool(planes or film)) as (draw, who):
        if film is None:
            view = camera_for(atoms, meta.up, planes, angles, width, height)
            save(out, frame(draw, atoms, inside, view, [Piece(planes)], ground, light=False), ground is None)
            print_result(f"{out} ({width}x{height}, drawn by {who})")
            return
        azimuth, elevation, distance = angles or (*default_angles(planes, np.asarray(meta.up)), MARGIN)
        scene = Scene(trained, atoms, meta.up, (azimuth, elevation, distance), (width, height))

        def shot(view: Camera, pieces: Sequence[Piece]) -> NDArray[np.uint8]:
            return frame(draw, atoms, inside, view, pieces, ground, light=True)

        told = save_film(out, wanted, scene, shot, {"background": background, "drawn": who})
        print_result(f"{out} ({told} of {width}x{height}, drawn by {who})")


def frame(
    draw: Draw,
    atoms: Atoms,
    inside: Inside | None,
    view: Camera,
    pieces: Sequence[Piece],
    ground: Rgb | None,
    light: bool,
) -> NDArray[np.uint8]:
    """(H, W, 4). One picture with every detail of its faces, over a colour or, for None, with straight alpha."""
    picture = draw(view, pieces, ground or (0.0, 0.0, 0.0), light)
    if inside is not None:
        picture = detailed(picture, view, pieces, [Detailed(inside, atoms.pitch)], light)
    if ground is None:
        return picture.straight_alpha()
    return np.dstack([to_8bit(picture.rgb), np.full(picture.alpha.shape, 255, np.uint8)])


def save(path: Path, rgba: NDArray[np.uint8], transparent: bool) -> None:
    """Saves a picture (H, W, 4) as the suffix says; without its alpha unless it is transparent."""
    if path.suffix.lower() == ".png":
        save_png(path, rgba if transparent else rgba[..., :3])
    else:
        save_still(path, rgba, transparent)


@contextmanager
def drawing(atoms: Atoms, is_cut: bool) -> Iterator[tuple[Draw, str]]:
    """What draws pictures of atoms, whole or cut, and its name: OpenGL if available, else the CPU renderer."""
    try:
        renderer = Renderer()
    except GLMissing as missing:
        field = KernelField(atoms) if is_cut else None

        def by_kernels(camera: Camera, pieces: Sequence[Piece], ground: Rgb, light: bool) -> Picture:
            return render_pieces(atoms, camera, pieces, ground, light, field)

        yield by_kernels, f"the CPU renderer: {missing}"
        return
    with renderer:
        renderer.set_atoms(atoms)

        def by_opengl(camera: Camera, pieces: Sequence[Piece], ground: Rgb, light: bool) -> Picture:
            renderer.render(camera, pieces, background=ground, light=light)
            return renderer.read()

        yield by_opengl, f"OpenGL: {renderer.ctx.info['GL_RENDERER']}"


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
    azimuth, elevation, distance = angles or (*default_angles(planes, np.asarray(up)), MARGIN)
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


def parse_background(text: str) -> Rgb | None:
    """The colour of a --background, range [0, 1]; None for transparent."""
    if text in NAMED:
        return NAMED[text]
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        raise InputError(f"--background {text}: give white, black, transparent or #rrggbb, as in #20262e")
    r, g, b = (int(text[at : at + 2], 16) / 255 for at in (1, 3, 5))
    return r, g, b


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-render", render_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
