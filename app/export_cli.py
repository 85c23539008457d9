"""`fruitninja-export`: a trained object, whole or cut, as a file for other programs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from engine.command import parse_plane, print_result, run_command
from engine.errors import InputError
from engine.io.trained import Meta, load_trained, provenance
from engine.io.writers.about import About
from engine.io.writers.solid_gaussians import piece_gaussians
from engine.io.writers.splats import SPLAT_WRITERS, write_splats
from engine.scene.atoms import Atoms
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["KINDS", "Export", "Kind", "main"]

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


@dataclass(frozen=True)
class Kind:
    """A way to hand an object to other programs."""

    suffixes: tuple[str, ...]
    """Of the files that it can be written as."""
    write: Callable[[Export], str]
    """Writes the file; returns what is in it, for the line that the command ends with."""


def write_atoms(export: Export) -> str:
    """The atoms whose centres are kept, as Gaussians."""
    gaussians = piece_gaussians(export.atoms, [Piece(export.planes)])
    about = About(export.meta.up, tuple(provenance(export.meta)))
    write_splats(export.out, gaussians, about)
    return f"{len(gaussians):,} Gaussians"


KINDS: dict[str, Kind] = {"splats": Kind(tuple(SPLAT_WRITERS), write_atoms)}
"""By the word of --as. Where several write a suffix, the first is meant unless --as says another."""


def export_command(
    trained: Annotated[Path, typer.Argument(help="A trained object with its sidecar, as fruitninja-train writes it.")],
    out: Annotated[
        Path, typer.Option("--out", "-o", help=f"The file: {', '.join(s for k in KINDS.values() for s in k.suffixes)}.")
    ],
    plane: Annotated[list[str] | None, typer.Option(help="A cut a,b,c,d; give it again for more.")] = None,
    as_: Annotated[
        str | None, typer.Option("--as", help=f"What is written, where the name does not tell: {', '.join(KINDS)}.")
    ] = None,
) -> None:
    """Save a trained object, whole or what planes leave of it, for other programs."""
    planes = tuple(parse_plane(text) for text in plane or [])
    kind = kind_of(out, as_)
    atoms, meta = load_trained(trained)
    if out.exists() and out.samefile(trained):
        raise InputError(f"{out}: this is the object itself; give another name")
    said = kind.write(Export(trained, atoms, meta, planes, out))
    print_result(f"{out} ({said})")


def kind_of(out: Path, name: str | None) -> Kind:
    """The kind of export that --as names, or else the file's suffix. Raises InputError if they do not fit."""
    suffix = out.suffix.lower()
    if name is not None and name not in KINDS:
        raise InputError(f"--as {name}: unknown; choose {', '.join(KINDS)}")
    chosen = KINDS if name is None else {name: KINDS[name]}
    for kind in chosen.values():
        if suffix in kind.suffixes:
            return kind
    suffixes = ", ".join(dict.fromkeys(suffix for kind in chosen.values() for suffix in kind.suffixes))
    what = "an object is" if name is None else f"{name} are"
    raise InputError(f"{out}: {what} saved as {suffixes}; give a name that ends so")


def main() -> None:
    """Entry point: one clear line and status 2 for bad input."""
    run_command("fruitninja-export", export_command, epilog=EPILOG)


if __name__ == "__main__":
    main()
