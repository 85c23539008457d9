"""The ways to export an object to other programs, and what each writes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from engine.errors import InputError
from engine.export.body import body_of, skin_outside
from engine.export.colours import Colours
from engine.export.particles import particles_of, save_particles
from engine.export.units import MILLIMETRES
from engine.export.voxels import voxels_of
from engine.io.trained import Meta, provenance
from engine.io.writers.provenance import Provenance
from engine.io.writers.solid_gaussians import piece_gaussians
from engine.io.writers.splats import SPLAT_WRITERS, write_splats
from engine.scene.atoms import Atoms
from engine.scene.grid import Body
from engine.scene.inside import KIND_NAMES, Inside
from engine.scene.moved import moved
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["IN_METRES", "KINDS", "SUFFIXES", "Export", "ExportKind", "kind_of", "write_export"]

Ink = tuple[int, int, int]
"""sRGB, range [0, 255]."""

STACK = ".zip"
"""Suffix of a stack of pictures for a printer."""

IN_METRES = (".glb", ".usda", ".usdc")
"""Suffixes of Gaussians whose unit is a metre."""

MOST_INKS = 16
"""Most inks; a printer has eight."""

LEAST_TOLD = 0.01
"""Share of the skin left out above which the user is told: less is stray atoms."""


@dataclass(frozen=True)
class Export:
    """What is exported, and where to."""

    source: Path
    """The object's file; its name goes into messages and meshes."""
    atoms: Atoms
    inside: Inside | None
    """None if there are only atoms."""
    meta: Meta
    planes: tuple[Plane, ...]
    """Only what is on the kept side of all of them is left."""
    out: Path
    pieces: bool = False
    """Whether to export every piece that the planes divide it into, each by itself, and not only what they keep."""
    step: float | None = None
    """World units between texels, voxels or particles; None lets the detail of the inside decide."""
    metres: float = 1.0
    """Length of a world unit."""
    inks: tuple[Ink, ...] = ()
    """What a printer's materials look like, for a stack in which each voxel is one of them; none for all colours."""


@dataclass(frozen=True)
class ExportKind:
    """A way to export an object to other programs."""

    suffixes: tuple[str, ...]
    """Suffixes of the files that it can be written as."""
    write: Callable[[Export], str]
    """Writes the file; returns what is in it, for the line that the command ends with."""
    divides: bool = False
    """Whether all pieces may be asked for."""


def write_export(export: Export, name: str | None = None) -> str:
    """Writes the file as the kind of this name, or else as its suffix says; returns what is in it, in a line.

    Raises InputError if name, suffix and options do not fit one another, and if the file cannot be written.
    """
    kind = kind_of(export.out, name)
    if export.inks and export.out.suffix.lower() != STACK:
        raise InputError(f"{export.out}: only a stack for a printer is of inks; give a name that ends in {STACK}")
    if export.inks and not 2 <= len(export.inks) <= MOST_INKS:
        raise InputError(f"{len(export.inks)} inks: give 2 to {MOST_INKS}")
    if export.pieces and not kind.divides:
        raise InputError(f"{export.out}: only a mesh holds several pieces; say mesh, or export each side by itself")
    for word, length in (("step", export.step), ("metres", export.metres)):
        if length is not None and not 0 < length < math.inf:
            raise InputError(f"{word} {length:g}: give a length above 0")
    if export.out.exists() and export.source.exists() and export.out.samefile(export.source):
        raise InputError(f"{export.out}: this is the object itself; give another name")
    return kind.write(export)


def kind_of(out: Path, name: str | None) -> ExportKind:
    """The kind of this name, or else of the file's suffix. Raises InputError if they do not fit."""
    if name is not None and name not in KINDS:
        raise InputError(f"'{name}': no kind of export; choose {', '.join(KINDS)}")
    chosen = KINDS if name is None else {name: KINDS[name]}
    for kind in chosen.values():
        if out.name.lower().endswith(kind.suffixes):
            return kind
    suffixes = ", ".join(dict.fromkeys(suffix for kind in chosen.values() for suffix in kind.suffixes))
    what = "an object is" if name is None else f"{name} are"
    raise InputError(f"{out}: {what} saved as {suffixes}; give a name that ends so")


def write_atoms(export: Export) -> str:
    """The atoms whose centres are kept, as Gaussians."""
    if export.step is not None:
        raise InputError(f"{export.out}: Gaussians have their own sizes; step is for meshes, volumes and particles")
    in_metres = export.out.name.lower().endswith(IN_METRES)
    if export.metres != 1 and not in_metres:
        raise InputError(f"{export.out}: a file without a unit; only {', '.join(IN_METRES)} tell how long a unit is")
    gaussians = piece_gaussians(export.atoms, [Piece(export.planes)])
    if export.metres != 1:
        gaussians = moved(gaussians, np.eye(3), factor=export.metres)
    about = Provenance(export.meta.up, tuple(provenance(export.meta)))
    write_splats(export.out, gaussians, about)
    return f"{len(gaussians):,} Gaussians"


def write_mesh(export: Export) -> str:
    """Closed meshes with textured cut faces."""
    from engine.export.meshes.cutting import MeshOptions
    from engine.export.meshes.files import save_mesh
    from engine.export.meshes.textured import textured_pieces

    body, colours = solid_of(export)
    wanted = export.planes if export.pieces else [MeshOptions(export.source.stem, (export.planes,))]
    made = textured_pieces(body, colours, wanted, export.step, str(export.out))
    files = save_mesh(export.out, made, export.meta.up, export.metres)
    height, width = made.texture.shape[:2]
    pieces = f"{len(made.pieces)} pieces, " if len(made.pieces) > 1 else ""
    triangles = sum(len(piece.triangles) for piece in made.pieces)
    volume = sum(piece.volume for piece in made.pieces) * export.metres**3
    left = skin_outside(export.atoms, body)
    without = f"; {left:.0%} of the skin has no inside and is left out" if left > LEAST_TOLD else ""
    picture = f"{width}x{height}{beside(files)}"
    return f"{pieces}{triangles:,} triangles, texture {picture}, volume {volume:.4g} m³{without}"


def write_volume(export: Export) -> str:
    """Colours and kinds in voxels."""
    from engine.export.volumes.files import save_volume

    voxels = voxels_of(*solid_of(export), export.planes, export.step, str(export.out))
    if export.inks:
        from engine.export.volumes.inks import halftoned

        drops = halftoned(voxels.rgb, voxels.kind > 0, export.inks)
        voxels = replace(voxels, rgb=np.array(export.inks, np.uint8)[drops])
    files = save_volume(export.out, voxels, export.meta.up, export.metres)
    kinds = [KIND_NAMES[n] for n in np.unique(voxels.kind)]
    x, y, z = voxels.grid.shape
    edge = f"{voxels.grid.cell * export.metres * MILLIMETRES:.4g} mm"
    return f"{x} x {y} x {z} voxels of {edge}{beside(files)}; labels {', '.join(kinds)}"


def beside(files: list[Path]) -> str:
    """What is said of all files but the first."""
    return "".join(f", {file.name} beside it" for file in files[1:])


def write_particles(export: Export) -> str:
    """Particles for a simulation."""
    step = export.step or export.atoms.pitch
    particles = particles_of(voxels_of(*solid_of(export), export.planes, step, str(export.out)))
    save_particles(export.out, particles, export.meta.up, export.metres)
    volume = particles.volumes.sum() * export.metres**3
    return f"{len(particles.points):,} particles, volume {volume:.4g} m³"


def solid_of(export: Export) -> tuple[Body, Colours]:
    """The object's body, and what it shows."""
    return body_of(export.atoms, str(export.source)), Colours(export.atoms, export.inside)


KINDS: dict[str, ExportKind] = {
    "splats": ExportKind(tuple(SPLAT_WRITERS), write_atoms),
    "mesh": ExportKind((".glb", ".obj", ".3mf"), write_mesh, divides=True),
    "volume": ExportKind((".nii.gz", ".nii", ".nrrd", ".zarr", STACK), write_volume),
    "particles": ExportKind((".npz", ".usda", ".usdc"), write_particles),
}
"""The kinds by name. If several write a suffix, the first is used unless another is named."""

SUFFIXES = tuple(dict.fromkeys(suffix for kind in KINDS.values() for suffix in kind.suffixes))
