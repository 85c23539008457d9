"""`fruitninja-export`: a trained object, whole or cut, as a file for other programs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from engine.command import parse_plane, print_result, run_command
from engine.errors import InputError
from engine.export.body import body_of, skin_outside
from engine.export.colours import Colours
from engine.export.particles import particles_of, save_particles
from engine.export.voxels import voxels_of
from engine.io.trained import Meta, load_trained, provenance
from engine.io.writers.about import About
from engine.io.writers.solid_gaussians import piece_gaussians
from engine.io.writers.splats import SPLAT_WRITERS, write_splats
from engine.scene.atoms import Atoms
from engine.scene.grid import Body
from engine.scene.inside import KIND_NAMES
from engine.scene.piece import Piece
from engine.scene.plane import Plane
from training.priors.inside_file import read_inside

__all__ = ["KINDS", "Export", "Kind", "main"]

LEAST_TOLD = 0.01
"""Part of the skin that is left out from which the user is told: less is stray atoms."""

EPILOG = (
    "A plane keeps the side where a x + b y + c z + d is negative; several planes keep what all of them keep. "
    "The name's ending says which format is written."
)


@dataclass(frozen=True)
class Export:
    """What is exported, and where to."""

    trained: Path
    """The object's file, beside which its inside is."""
    atoms: Atoms
    meta: Meta
    planes: tuple[Plane, ...]
    """What is left is on the kept side of all of them."""
    out: Path
    pieces: bool = False
    """All that the planes divide it into is wanted, each piece by itself, and not only what they keep."""
    step: float | None = None
    """World units between texels, voxels or particles; None where the detail of the inside decides."""
    metres: float = 1.0
    """Length of a world unit."""


@dataclass(frozen=True)
class Kind:
    """A way to hand an object to other programs."""

    suffixes: tuple[str, ...]
    """Of the files that it can be written as."""
    write: Callable[[Export], str]
    """Writes the file; returns what is in it, for the line that the command ends with."""
    divides: bool = False
    """Whether all pieces may be asked for."""


def write_atoms(export: Export) -> str:
    """The atoms whose centres are kept, as Gaussians."""
    gaussians = piece_gaussians(export.atoms, [Piece(export.planes)])
    about = About(export.meta.up, tuple(provenance(export.meta)))
    write_splats(export.out, gaussians, about)
    return f"{len(gaussians):,} Gaussians"


def write_mesh(export: Export) -> str:
    """Closed meshes with textured cut faces."""
    from engine.export.meshes.cutting import Wanted
    from engine.export.meshes.files import save_mesh
    from engine.export.meshes.textured import textured_pieces

    body, colours = solid_of(export)
    wanted = export.planes if export.pieces else [Wanted(export.trained.stem, (export.planes,))]
    made = textured_pieces(body, colours, wanted, export.step, str(export.out))
    save_mesh(export.out, made, export.meta.up, export.metres)
    height, width = made.texture.shape[:2]
    pieces = f"{len(made.pieces)} pieces, " if len(made.pieces) > 1 else ""
    triangles = sum(len(piece.triangles) for piece in made.pieces)
    volume = sum(piece.volume for piece in made.pieces) * export.metres**3
    left = skin_outside(export.atoms, body)
    without = f"; {left:.0%} of the skin has no inside and is left out" if left > LEAST_TOLD else ""
    return f"{pieces}{triangles:,} triangles, texture {width}x{height}, volume {volume:.4g} m³{without}"


def write_volume(export: Export) -> str:
    """Colours and kinds in voxels."""
    from engine.export.volumes.files import save_volume

    voxels = voxels_of(*solid_of(export), export.planes, export.step, str(export.out))
    files = save_volume(export.out, voxels, export.meta.up, export.metres)
    told = [KIND_NAMES[n] for n in np.unique(voxels.kind)]
    x, y, z = voxels.grid.shape
    edge = f"{voxels.grid.cell * export.metres * 1000:.4g} mm"
    beside = "".join(f", {file.name} beside it" for file in files[1:])
    return f"{x} x {y} x {z} voxels of {edge}{beside}; labels {', '.join(told)}"


def write_particles(export: Export) -> str:
    """Particles for a simulation."""
    step = export.step or export.atoms.pitch
    particles = particles_of(voxels_of(*solid_of(export), export.planes, step, str(export.out)))
    save_particles(export.out, particles, export.meta.up, export.metres)
    volume = particles.volumes.sum() * export.metres**3
    return f"{len(particles.points):,} particles, volume {volume:.4g} m³"


def solid_of(export: Export) -> tuple[Body, Colours]:
    """The object's body, and what it shows."""
    return body_of(export.atoms, str(export.trained)), Colours(export.atoms, read_inside(export.trained))


KINDS: dict[str, Kind] = {
    "splats": Kind(tuple(SPLAT_WRITERS), write_atoms),
    "mesh": Kind((".glb", ".obj", ".3mf"), write_mesh, divides=True),
    "volume": Kind((".nii.gz", ".nii", ".nrrd", ".zarr", ".zip"), write_volume),
    "particles": Kind((".npz", ".usda", ".usdc"), write_particles),
}
"""By the word of --as. Where several write a suffix, the first is meant unless --as says another."""

SUFFIXES = tuple(dict.fromkeys(suffix for kind in KINDS.values() for suffix in kind.suffixes))


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
) -> None:
    """Save a trained object, whole or what planes leave of it, for other programs."""
    planes = tuple(parse_plane(text) for text in plane or [])
    kind = kind_of(out, as_)
    if pieces and not kind.divides:
        raise InputError("--pieces: only meshes hold several; give --as mesh, or export each side by itself")
    if step is not None and not 0 < step < math.inf:
        raise InputError(f"--step {step:g}: give a length above 0")
    if not 0 < metres < math.inf:
        raise InputError(f"--metres {metres:g}: give a length above 0")
    atoms, meta = load_trained(trained)
    if out.exists() and out.samefile(trained):
        raise InputError(f"{out}: this is the object itself; give another name")
    said = kind.write(Export(trained, atoms, meta, planes, out, pieces, step, metres))
    print_result(f"{out} ({said})")


def kind_of(out: Path, name: str | None) -> Kind:
    """The kind of export that --as names, or else the file's suffix. Raises InputError if they do not fit."""
    if name is not None and name not in KINDS:
        raise InputError(f"--as {name}: unknown; choose {', '.join(KINDS)}")
    chosen = KINDS if name is None else {name: KINDS[name]}
    for kind in chosen.values():
        if out.name.lower().endswith(kind.suffixes):
            return kind
    suffixes = ", ".join(dict.fromkeys(suffix for kind in chosen.values() for suffix in kind.suffixes))
    what = "an object is" if name is None else f"{name} are"
    raise InputError(f"{out}: {what} saved as {suffixes}; give a name that ends so")


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-export", export_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
