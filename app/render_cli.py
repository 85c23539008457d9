"""`fruitninja-render`: draws a picture, film or page of a trained object, cut by planes, without a window."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from app.film_cli import Scene, film_project, is_project, make_film, save_film
from app.jobs.export import save_still
from engine.command import parse_numbers, parse_plane, parse_rgb, print_result, run_command
from engine.errors import InputError
from engine.export.page.page import PAGES
from engine.io.picture_file import save_png
from engine.io.trained import load_trained
from engine.render.face_detail import Detailed
from engine.scene.camera import Camera
from engine.scene.piece import Piece
from fruitninja.drawing import LARGEST, MARGIN, Rgb, camera_for, default_angles, drawing, frame
from fruitninja.solid import open_solid
from training.priors.inside_file import read_inside

__all__ = ["main"]

NAMED: dict[str, Rgb | None] = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0), "transparent": None}

EPILOG = (
    "A plane keeps the side where a x + b y + c z + d is negative; several planes keep what all of them keep. "
    "Distance 1 fits the object into the picture. In a film the first plane sweeps, or all of them part what explodes. "
    "A film into a folder goes on where it was stopped. A page begins with these planes, or one across the middle, and "
    "its reader moves them. docs/EXPORT.md has the form of keyframes."
)


def render_command(
    trained: Annotated[
        Path,
        typer.Argument(help="A trained object with its sidecar, or a project (.fruitninja), whose film is drawn."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="A picture (.png, .webp); a page (.html); a film (.gif, .mp4, .webp), or its folder."
        ),
    ],
    plane: Annotated[list[str] | None, typer.Option(help="A cut a,b,c,d; give it again for more.")] = None,
    camera: Annotated[
        str | None, typer.Option(help="azimuth,elevation,distance: degrees, degrees, times the fitting distance.")
    ] = None,
    size: Annotated[str | None, typer.Option(help="WIDTHxHEIGHT in pixels; 1280x720 unless told.")] = None,
    background: Annotated[
        str | None,
        typer.Option(
            help="white, black, #rrggbb, or transparent (.png, .webp); white unless told, a page as its reader has it."
        ),
    ] = None,
    html: Annotated[
        bool, typer.Option("--html", help="Write a page that any browser opens offline, to turn, zoom and cut it.")
    ] = False,
    film: Annotated[
        str | None, typer.Option(help="Draw a film: turntable, sweep, explode, or a file of keyframes (.json).")
    ] = None,
    seconds: Annotated[float | None, typer.Option(help="How long the film is; 6 unless told.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second; 25 unless told.")] = None,
) -> None:
    """Draw a trained object, whole or cut open, as a picture, a film or a page."""
    planes = tuple(parse_plane(text) for text in plane or [])
    width, height = parse_size(size or "1280x720")
    angles = None if camera is None else parse_numbers(camera, 3, f"--camera {camera}: give azimuth,elevation,distance")
    if angles and not angles[2] > 0:
        raise InputError(f"--camera {camera}: the distance must be above 0; 1 fits the object into the picture")
    ground = parse_background(background or "white")
    if html or out.suffix.lower() in PAGES:
        if not film is seconds is fps is size is None:
            raise InputError(f"{out}: a page has no --film, --seconds, --fps or --size; leave them out")
        if ground is None:
            raise InputError("--background transparent: a page has a colour; give white, black or #rrggbb")
        azimuth, elevation, distance = angles or (None, None, None)
        solid, colour = open_solid(trained).cut(*planes), ground if background else None
        with Progress(console=Console(stderr=True), transient=True) as bar:
            written = partial(bar.update, bar.add_task(f"Writing {out.name}", total=1.0))
            said = solid.html(
                out,
                azimuth=azimuth,
                elevation=elevation,
                distance=distance,
                background=colour,
                progress=lambda part: written(completed=part),
            )
        print_result(f"{out} ({said})")
        return
    if is_project(trained):
        if planes or camera is not None or film is not None or seconds is not None:
            raise InputError(
                f"{trained}: the film of a project has planes, camera and times of its own; leave them out"
            )
        with Progress(console=Console(stderr=True), transient=True) as bar:
            drawn = partial(bar.update, bar.add_task(f"Drawing {out.name}", total=1.0))
            asked = (width, height) if size else None
            said = film_project(
                trained, out, asked, fps, (ground,) if background else None, lambda part: drawn(completed=part)
            )
        print_result(f"{out} ({said})")
        return
    if film is not None:
        wanted = make_film(film, out, planes, camera is not None, seconds, fps, ground is None)
    elif out.suffix.lower() not in (".png", ".webp"):
        raise InputError(f"{out}: the picture is a PNG or WebP; give a name that ends in .png, or --film or --html")
    elif seconds is not None or fps is not None:
        raise InputError("--seconds and --fps are of a film; give --film too")
    atoms, meta = load_trained(trained)
    inside = read_inside(trained) if planes or film is not None else None
    details = [None if inside is None else Detailed(inside, atoms.pitch)]
    with drawing([atoms], bool(planes or film)) as (draw, who):
        if film is None:
            view = camera_for(atoms, meta.up, planes, angles, width, height)
            save(out, frame(draw, details, view, [Piece(planes)], ground, light=False), ground is None)
            print_result(f"{out} ({width}x{height}, drawn by {who})")
            return
        azimuth, elevation, distance = angles or (*default_angles(planes, np.asarray(meta.up)), MARGIN)
        scene = Scene(trained, atoms, meta.up, (azimuth, elevation, distance), (width, height))

        def shot(view: Camera, pieces: Sequence[Piece]) -> NDArray[np.uint8]:
            return frame(draw, details, view, pieces, ground, light=True)

        frames = save_film(out, wanted, scene, shot, {"background": background or "white", "drawn": who})
        print_result(f"{out} ({frames} of {width}x{height}, drawn by {who})")


def save(path: Path, rgba: NDArray[np.uint8], transparent: bool) -> None:
    """Saves a picture (H, W, 4) in the format of the suffix, with its alpha only if it is `transparent`."""
    if path.suffix.lower() == ".png":
        save_png(path, rgba if transparent else rgba[..., :3])
    else:
        save_still(path, rgba, transparent)


def parse_size(text: str) -> tuple[int, int]:
    """Width and height from a text WIDTHxHEIGHT. Raises InputError for any other text."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(p.isdecimal() and p.isascii() and 1 <= int(p) <= LARGEST for p in parts):
        raise InputError(f"--size {text}: give WIDTHxHEIGHT, each from 1 to {LARGEST}, as in 1280x720")
    return int(parts[0]), int(parts[1])


def parse_background(text: str) -> Rgb | None:
    """The colour of a --background, range [0, 1]; None for transparent."""
    if text in NAMED:
        return NAMED[text]
    complaint = f"--background {text}: give white, black, transparent or #rrggbb, as in #20262e"
    r, g, b = parse_rgb(text, complaint)
    return r / 255, g / 255, b / 255


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-render", render_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
