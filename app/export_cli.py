"""`fruitninja-export`: writes a trained object, whole or cut, as a file for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from engine.command import parse_plane, parse_rgb, print_result, run_command
from engine.export.kinds import KINDS, SUFFIXES, kind_of
from fruitninja.solid import open_solid

__all__ = ["main"]

EPILOG = (
    "A plane keeps the side where a x + b y + c z + d is negative; several planes keep what all of them keep. "
    "The name's ending says which format is written."
)


def export_command(
    trained: Annotated[Path, typer.Argument(help="A trained object with its sidecar, as fruitninja-train writes it.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help=f"The file: {', '.join(SUFFIXES)}."),
    ],
    plane: Annotated[list[str] | None, typer.Option(help="A cut a,b,c,d; give it again for more.")] = None,
    as_: Annotated[
        str | None, typer.Option("--as", help=f"What is written, where the name does not tell: {', '.join(KINDS)}.")
    ] = None,
    pieces: Annotated[
        bool,
        typer.Option("--pieces", help="All that the cuts divide it into, each an object of its own; meshes."),
    ] = False,
    step: Annotated[
        float | None,
        typer.Option(
            help="Units of the file between texels of a mesh, voxels or particles; by itself as fine as the inside, "
            "particles as the atoms."
        ),
    ] = None,
    metres: Annotated[float, typer.Option(help="How long a unit of the file is; meshes, volumes and particles.")] = 1.0,
    inks: Annotated[
        str | None,
        typer.Option(
            help="Colours of a printer's materials, #rrggbb,#rrggbb,...: each voxel of a .zip is one of them."
        ),
    ] = None,
) -> None:
    """Save a trained object, whole or the part that planes leave of it, for other programs."""
    planes = [parse_plane(text) for text in plane or []]
    kind_of(out, as_)  # reports a name that does not fit before the object is loaded
    complaint = f"--inks {inks}: give colours as #rrggbb with commas between, as in #ffffff,#231f20"
    of_inks = [] if inks is None else [parse_rgb(colour.strip(), complaint) for colour in inks.split(",")]
    solid = open_solid(trained).cut(*planes)
    said = solid.export(out, as_, pieces=pieces, step=step, metres=metres, inks=of_inks)
    print_result(f"{out} ({said})")


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-export", export_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
