"""Names of files that hold scenes, apart from their readers: a dialog that offers them need not load those."""

from __future__ import annotations

__all__ = ["MESH_SUFFIXES", "SCENE_SUFFIXES", "SPLAT_SUFFIXES"]

SPLAT_SUFFIXES = (".ply", ".splat", ".spz")
"""Captures. SuperSplat's compressed .ply is one of the first."""

MESH_SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl")

SCENE_SUFFIXES = tuple(dict.fromkeys((*SPLAT_SUFFIXES, *MESH_SUFFIXES)))
"""Everything that `engine.io.load` opens."""
