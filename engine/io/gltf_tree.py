"""The JSON of a glTF file, for the readers of meshes and of Gaussians."""

from __future__ import annotations

import json
import os
import struct
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.files import open_file, read_file

__all__ = ["BINARY_CHUNK", "GAUSSIANS", "JSON_CHUNK", "MAGIC", "damaged", "extensions", "read_tree", "rows"]

MAGIC = b"glTF"
"""First bytes of a .glb."""

JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942

MOST_JSON = 1 << 30
"""Bytes of the JSON that is read: a .gltf may hold its buffers in it, as text."""

GAUSSIANS = "KHR_gaussian_splatting"


def read_tree(path: Path) -> tuple[dict[str, Any], int]:
    """The JSON of a .glb or .gltf of version 2, and where in the file the bytes after it begin.

    Raises InputError if it is damaged or of another version.
    """
    after = 0
    with open_file(path) as file:
        head = file.read(20)
        if head[:4] == MAGIC and len(head) == 20:
            version, _, size, chunk = struct.unpack("<4I", head[4:])
            if version == 1:
                raise _old(path, "1.0")
            there = os.fstat(file.fileno()).st_size - len(head)
            if version != 2 or chunk != JSON_CHUNK or size > min(there, MOST_JSON):
                raise damaged(path)
            data = file.read(size)
            after = 20 + size
        else:
            data = read_file(path, MOST_JSON)
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise damaged(path) from error
    if not isinstance(tree, dict):
        raise damaged(path)
    asset = tree.get("asset")
    version = str(asset.get("version", "2.0") if isinstance(asset, dict) else "2.0")
    if version.split(".")[0] != "2":
        raise _old(path, version[:10])
    return tree, after


def rows(tree: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """The objects in one of a glTF's lists; an empty one for anything that is no object."""
    found = tree.get(key)
    return [row if isinstance(row, dict) else {} for row in found] if isinstance(found, list) else []


def extensions(row: dict[str, Any]) -> dict[str, Any]:
    """The extensions of an object, by name."""
    found = row.get("extensions")
    return found if isinstance(found, dict) else {}


def damaged(path: Path) -> InputError:
    """The error for a file that is no glTF."""
    return InputError(f"{path}: cannot be read as a mesh; the file is damaged or not what its name says")


def _old(path: Path, version: str) -> InputError:
    return InputError(f"{path}: this is glTF {version}, which cannot be read; export it as glTF 2.0 (.glb)")
