"""`fruitninja-render`: a picture of a trained object, cut by planes, without a window."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from engine.command import parse_numbers, parse_plane, print_result, run_command
from engine.errors import InputError
from engine.io.picture_file import save_png
from engine.io.trained import load_trained
from fruitninja.drawing import LARGEST, camera_for, draw
from training.priors.inside_file import read_inside

__all__ = ["main"]

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
    picture, who = draw(atoms, read_inside(trained) if planes else None, view, planes)
    save_png(out, picture.rgb)
    print_result(f"{out} ({width}x{height}, drawn by {who})")


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
