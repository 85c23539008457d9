"""File name suffixes of scenes, separate from the readers so that a file dialog need not load these."""

from __future__ import annotations

__all__ = ["MESH_SUFFIXES", "SCENE_SUFFIXES", "SPLAT_SUFFIXES"]

SPLAT_SUFFIXES = (".ply", ".splat", ".spz", ".sog", "meta.json", ".ksplat")
"""Captures. A .ply may be SuperSplat's compressed form; an SOG in a folder is opened by its meta.json. A .glb or .gltf
holds Gaussians or a mesh."""

MESH_SUFFIXES = (".obj", ".glb", ".gltf", ".ply", ".stl")

SCENE_SUFFIXES = tuple(dict.fromkeys((*SPLAT_SUFFIXES, *MESH_SUFFIXES)))
"""Everything that `engine.io.load` opens."""
