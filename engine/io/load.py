"""Opens any scene file: a capture or a mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from engine.errors import InputError
from engine.io.file_axes import GLTF, MESH, PHOTOGRAPHED, STL, FileAxes, ply_axes
from engine.io.files import open_file
from engine.io.formats import MESH_SUFFIXES, SCENE_SUFFIXES
from engine.io.ply_header import read_header
from engine.io.splats.gltf import holds_gaussians, read_gltf
from engine.io.splats.ksplat import read_ksplat
from engine.io.splats.ply import read_ply
from engine.io.splats.sog import META, is_zipped_sog, read_sog
from engine.io.splats.splat import read_splat
from engine.io.splats.spz import GZIP, MAGIC, read_spz
from engine.io.unsupported import LONGEST, unsupported_kind
from engine.scene.gaussians import Gaussians

__all__ = ["LoadedScene", "load", "load_sample"]

Reader = Callable[[Path, int | None], tuple[Gaussians, list[str]]]
"""Takes a file and the most Gaussians to read (None: all). Returns them and a line on each thing left out."""


@dataclass(frozen=True)
class LoadedScene:
    """A scene, and what the user should know about how it was read."""

    gaussians: Gaussians
    warnings: tuple[str, ...]
    """One line each, with the file's name."""
    file_axes: FileAxes
    """Share of such files in which each axis is up."""


def load(path: str | Path, seed: int = 0) -> LoadedScene:
    """The scene in a capture (.ply, SuperSplat's compressed .ply, .splat, .spz, .sog or its meta.json, .ksplat, or
    glTF with Gaussians) or in a mesh (.obj, .glb, .gltf, .ply, .stl), whose surface is sampled with `seed`.

    The content decides what a .ply, .spz, .sog or .glb is, not the name. Raises InputError for any other file.
    """
    path = Path(path)
    read, axes = _reader(path)
    gaussians, warnings = _mesh(path, seed) if read is None else read(path, None)
    return LoadedScene(gaussians, tuple(warnings), axes)


def load_sample(path: str | Path, most: int) -> LoadedScene | None:
    """At most `most` Gaussians of a capture, evenly chosen from its file and with SH of degree 0: what a first coarse
    picture needs, in a fraction of the time of `load`.

    None for what is better left to `load`: a mesh, a file in which too little can be used, and a scene so far from zero
    that it is moved, since a sample might be moved elsewhere.
    """
    path = Path(path)
    try:
        read, axes = _reader(path)
        if read is None:
            return None
        gaussians, warnings = read(path, most)
    except InputError:  # `load` will say what is wrong with all of it
        return None
    return None if any(gaussians.origin) else LoadedScene(gaussians, tuple(warnings), axes)


def _reader(path: Path) -> tuple[Reader | None, FileAxes]:
    """The reader of a capture, None for a mesh, and the up axes of such files. Raises InputError for other files."""
    suffix = path.suffix.lower()
    with open_file(path) as file:
        start = file.read(LONGEST)
    if not start:
        raise InputError(f"{path}: the file is empty; copy or download it again")
    if path.name.lower().endswith(META) or (start[:4] == b"PK\x03\x04" and is_zipped_sog(path)):
        return read_sog, PHOTOGRAPHED
    if other := unsupported_kind(start):
        raise InputError(f"{path}: this is {other}")
    if start[:3] == b"ply" and start[3:4] in (b"\n", b"\r", b" ", b"\t"):
        header = read_header(path)
        return (None, MESH) if header.faces > 0 and not header.is_splats else (read_ply, ply_axes(header))
    if start[:4] == b"glTF" or (suffix in MESH_SUFFIXES and suffix != ".ply"):
        if start[:4] == b"glTF" or suffix in (".glb", ".gltf"):
            return read_gltf if holds_gaussians(path) else None, GLTF
        return None, STL if suffix == ".stl" else MESH
    if start[:2] == GZIP or start[:4] == MAGIC:
        return read_spz, PHOTOGRAPHED
    if suffix == ".splat":
        return read_splat, PHOTOGRAPHED
    if suffix == ".ksplat":
        return read_ksplat, PHOTOGRAPHED
    if suffix == ".ply":
        return read_ply, {}  # not a .ply, as the reader will report
    if suffix == ".spz":
        raise InputError(f"{path}: not an .spz scene; export the capture again")
    raise InputError(f"{path}: not a scene; {', '.join(SCENE_SUFFIXES)} can be opened")


def _mesh(path: Path, seed: int) -> tuple[Gaussians, list[str]]:
    """A mesh with its surface sampled, and the warnings about it."""
    from engine.io.meshes.mesh import read_mesh  # trimesh takes half a second, which captures need not wait for

    warnings: list[str] = []
    return read_mesh(path, seed=seed, warn=warnings.append), warnings
