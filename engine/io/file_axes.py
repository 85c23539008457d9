"""Which axis is up in each kind of file, as far as there is a convention.

The shares are estimates, not counts, and kept low: the rest, up to 1, are objects in no particular position, which must
not be assumed to stand upright. Captures trained on photographs keep the axes of the first cameras, OpenCV's, with y
down; those trained on renders, or sampled from meshes, keep the modeller's.
"""

from __future__ import annotations

from collections.abc import Mapping

from engine.io.ply_header import Header
from engine.io.splats.compressed_ply import is_compressed

__all__ = ["GLTF", "MESH", "PHOTOGRAPHED", "STL", "FileAxes", "ply_axes"]

FileAxes = Mapping[tuple[int, int, int], float]
"""Share of the files in which each axis, a unit vector, is up."""

PHOTOGRAPHED: FileAxes = {(0, -1, 0): 0.4}
"""A .splat, .ksplat, SuperSplat's .ply and SOG, and an .spz, which is stored with y up and turned when it is read."""

ANY_PLY: FileAxes = {(0, -1, 0): 0.25, (0, 0, 1): 0.2}
"""A 3DGS .ply, which may come from photographs or from renders."""

STATED: dict[str, FileAxes] = {
    "x": {(1, 0, 0): 0.5},
    # Brush states y for every capture, yet keeps the axes of the photographs.
    "y": {(0, -1, 0): 0.4, (0, 1, 0): 0.1},
    "z": {(0, 0, 1): 0.7},
}
"""A .ply that states its axis, as in the comment 'Vertical Axis: z' of Nerfstudio and Brush."""

GLTF: FileAxes = {(0, 1, 0): 0.5}
"""A .glb or .gltf: the standard says y, for Gaussians and meshes alike."""

STL: FileAxes = {(0, 0, 1): 0.4}
"""An .stl: made for printers, whose bed is the xy plane."""

MESH: FileAxes = {(0, 1, 0): 0.25, (0, 0, 1): 0.2}
"""An .obj or a .ply: y from programs that animate, z from those that measure."""


def ply_axes(header: Header) -> FileAxes:
    """The axes of a .ply with Gaussians."""
    for comment in header.comments:
        name, _, value = comment.partition(":")
        if name.strip().lower() == "vertical axis" and value.strip().lower() in STATED:
            return STATED[value.strip().lower()]
    return PHOTOGRAPHED if is_compressed(header) else ANY_PLY
