"""Opens any scene file: a capture or a mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from engine.errors import InputError
from engine.io.file_axes import GLTF, MESH, PHOTOGRAPHED, STL, FileAxes, ply_axes
from engine.io.files import open_file
from engine.io.formats import MESH_SUFFIXES, SCENE_SUFFIXES
from engine.io.meshes.mesh import read_mesh
from engine.io.ply_header import read_header
from engine.io.splats.ply import read_ply
from engine.io.splats.splat import read_splat
from engine.io.splats.spz import GZIP, read_spz
from engine.io.unsupported import LONGEST, unsupported_kind
from engine.scene.gaussians import Gaussians

__all__ = ["LoadedScene", "load"]

TO_CONVERT = (".ksplat", ".sog", ".sogs")
"""Captures that only their own programs open."""


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and what the user should know about how it was read."""

    gaussians: Gaussians
    warnings: tuple[str, ...]
    """One line each, with the file's name."""
    file_axes: FileAxes
    """For what part of such files an axis is up."""


def load(path: str | Path, seed: int = 0) -> LoadedScene:
    """The scene in a capture (.ply, SuperSplat's compressed .ply, .splat, .spz) or in a mesh (.obj, .glb, .gltf, .ply,
    .stl), whose surface is sampled with `seed`.

    The content decides what a .ply, .spz or .glb is, not the name. Raises InputError for any other file.
    """
    path = Path(path)
    mesh = partial(_mesh, seed)
    read: Callable[[Path], tuple[Gaussians, list[str]]]
    axes: FileAxes
    suffix = path.suffix.lower()
    with open_file(path) as file:
        start = file.read(LONGEST)
    if not start:
        raise InputError(f"{path}: the file is empty; copy or download it again")
    if other := unsupported_kind(start):
        raise InputError(f"{path}: this is {other}")
    if start[:3] == b"ply" and start[3:4] in (b"\n", b"\r", b" ", b"\t"):
        header = read_header(path)
        is_mesh = header.faces > 0 and not header.is_splats
        read, axes = (mesh, MESH) if is_mesh else (read_ply, ply_axes(header))
    elif start[:4] == b"glTF" or (suffix in MESH_SUFFIXES and suffix != ".ply"):
        is_gltf = start[:4] == b"glTF" or suffix in (".glb", ".gltf")
        read, axes = mesh, GLTF if is_gltf else STL if suffix == ".stl" else MESH
    elif start[:2] == GZIP:
        read, axes = read_spz, PHOTOGRAPHED
    elif suffix == ".splat":
        read, axes = read_splat, PHOTOGRAPHED
    elif suffix == ".ply":
        read, axes = read_ply, {}  # not a .ply, as the reader will report
    elif suffix == ".spz":
        raise InputError(f"{path}: not an .spz scene, which would be gzipped; export the capture again")
    elif suffix in TO_CONVERT:
        raise InputError(f"{path}: {suffix} files cannot be opened; export the capture as a .ply, .splat or .spz")
    else:
        raise InputError(f"{path}: not a scene; {', '.join(SCENE_SUFFIXES)} can be opened")
    gaussians, warnings = read(path)
    return LoadedScene(gaussians, tuple(warnings), axes)


def _mesh(seed: int, path: Path) -> tuple[Gaussians, list[str]]:
    """A mesh with its surface sampled, and the warnings about it."""
    warnings: list[str] = []
    return read_mesh(path, seed=seed, warn=warnings.append), warnings
