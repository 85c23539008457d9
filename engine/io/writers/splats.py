"""Writes Gaussians in the formats of other programs, chosen by the file's suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from engine.errors import InputError
from engine.io.splats.ply import write_ply
from engine.io.writers.gltf import write_glb
from engine.io.writers.provenance import Provenance
from engine.io.writers.sog import write_sog
from engine.io.writers.spz import write_spz
from engine.io.writers.usd import write_usd
from engine.scene.gaussians import Gaussians

__all__ = ["SPLAT_WRITERS", "write_splats"]

Writer = Callable[[Path, Gaussians, Provenance], None]


def _ply(path: Path, gaussians: Gaussians, about: Provenance) -> None:
    write_ply(path, gaussians, ["FruitNinja", *about.lines])


SPLAT_WRITERS: dict[str, Writer] = {
    ".ply": _ply,
    ".spz": write_spz,
    ".sog": write_sog,
    ".glb": write_glb,
    ".usda": write_usd,
    ".usdc": write_usd,
}
"""The writer of each suffix."""


def write_splats(path: str | Path, gaussians: Gaussians, about: Provenance) -> None:
    """Writes Gaussians in the format of the path's suffix, all of the file or none of it.

    Raises InputError for any other suffix, if there are none, and if writing fails.
    """
    path = Path(path)
    write = SPLAT_WRITERS.get(path.suffix.lower())
    if write is None:
        raise InputError(f"{path}: Gaussians are saved as {', '.join(SPLAT_WRITERS)}")
    if not len(gaussians):
        raise InputError(f"{path}: nothing to save; nothing of the object is left")
    write(path, gaussians, about)
