"""Opens whatever a user may have: a capture or a scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from engine.errors import InputError
from engine.gaussians import Gaussians
from engine.mesh import MESH_SUFFIXES, read_mesh
from engine.ply import read_ply
from engine.ply_header import open_file, read_header

__all__ = ["Loaded", "load"]

SPLATS_TO_CONVERT = (".ksplat", ".splat", ".spz", ".sog")
"""Captures that other programs turn into a .ply."""


@dataclass(frozen=True)
class Loaded:
    """A scene, and what the user should know about how it was read."""

    gaussians: Gaussians
    warnings: tuple[str, ...]
    """One line each, with the file's name."""


def load(path: str | Path, seed: int = 0) -> Loaded:
    """The scene in a 3DGS .ply, or in a mesh (.obj, .glb, .gltf, .ply, .stl), whose surface is sampled with `seed`.

    What a .ply or .glb is shows its content, not its name. Raises InputError for anything else.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with open_file(path) as file:
        start = file.read(4)
    if start[:3] == b"ply" and start[3:] in (b"\n", b"\r", b" ", b"\t"):
        header = read_header(path)
        is_mesh = header.faces > 0 and not header.is_splats
    elif start == b"glTF" or (suffix in MESH_SUFFIXES and suffix != ".ply"):
        is_mesh = True
    elif suffix == ".ply":
        is_mesh = False  # it is no .ply, and the reader says so
    elif suffix in SPLATS_TO_CONVERT:
        raise InputError(f"{path}: {suffix} files cannot be opened yet; export the capture as an uncompressed .ply")
    else:
        kinds = ", ".join(s for s in MESH_SUFFIXES if s != ".ply")
        raise InputError(f"{path}: not a scene; a 3DGS .ply or a mesh ({kinds} or .ply) can be opened")
    if is_mesh:
        warnings: list[str] = []
        return Loaded(read_mesh(path, seed=seed, warn=warnings.append), tuple(warnings))
    gaussians, dropped = read_ply(path)
    return Loaded(gaussians, tuple(dropped))
