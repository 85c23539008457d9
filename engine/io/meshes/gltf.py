"""Checks a glTF file's JSON before its geometry is read, so that errors name what cannot be opened."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.files import open_file, read_file

__all__ = ["buffer_files"]

MAGIC = b"glTF"
JSON_CHUNK = 0x4E4F534A

MOST_JSON = 1 << 30
"""Bytes of the JSON that is read: a .gltf may hold its buffers in it, as text."""

MOST_VALUES = 200_000_000
"""Most rows of all arrays together: those of ten times the faces of a fine scan."""

MOST_ZEROS = 5_000_000
"""Most rows that the file does not hold: zeros in a sparse accessor. A short file may claim any number."""

FACES = (4, 5)
"""Modes of primitives that are faces: triangles and strips of them. 4 is the default."""

SHAPES = {0: "points", 1: "lines", 2: "lines", 3: "lines", 6: "fans of triangles"}

GAUSSIANS = "KHR_gaussian_splatting"
DRACO = "KHR_draco_mesh_compression"
PACKED = {
    DRACO: "compressed with Draco",
    "EXT_meshopt_compression": "compressed with meshopt",
    "KHR_meshopt_compression": "compressed with meshopt",
    "KHR_mesh_quantization": "quantized",
}
"""Extensions that pack geometry, in the words of exporters' dialogs."""

HARMLESS = ("KHR_materials_", "KHR_lights_", "KHR_xmp", "KHR_animation_", "EXT_texture_webp")
"""Prefixes of required extensions that change neither shape nor colours here, except WebP, which is supported."""


def buffer_files(path: Path, warn: Callable[[str], None]) -> frozenset[str]:
    """Names of the files with a glTF's geometry, as it gives them; a .glb and data URIs have theirs inside.

    Raises InputError if it requires what cannot be read, has no faces, or is damaged. `warn` takes a line on Gaussians
    that are left out.
    """
    tree = _tree(path)
    asset = tree.get("asset")
    version = str(asset.get("version", "2.0") if isinstance(asset, dict) else "2.0")
    if version.split(".")[0] != "2":
        raise _old(path, version[:10])
    primitives = [primitive for mesh in _rows(tree, "meshes") for primitive in _rows(mesh, "primitives")]
    modes = {mode for primitive in primitives if isinstance(mode := primitive.get("mode", 4), int)}
    gaussians = any(GAUSSIANS in _extensions(primitive) for primitive in primitives)
    if modes and modes.isdisjoint(FACES):
        if gaussians:
            raise InputError(
                f"{path}: this holds Gaussians as glTF ({GAUSSIANS}), which cannot be opened yet; export the capture "
                "as a .ply, .splat or .spz"
            )
        shapes = " and ".join(sorted({SHAPES.get(mode, "unknown shapes") for mode in modes}))
        raise InputError(f"{path}: there is no face in it, only {shapes}; a mesh with faces is needed")
    _check_extensions(path, tree, primitives)
    counts = [(row, count) for row in _rows(tree, "accessors") if isinstance(count := row.get("count"), int)]
    held = sum(max(count, 0) for row, count in counts if "bufferView" in row)
    zeros = sum(max(count, 0) for row, count in counts if "bufferView" not in row)
    if held > MOST_VALUES:
        raise InputError(f"{path}: {held:,} values in its arrays; the most is {MOST_VALUES:,}: simplify the mesh")
    if zeros > MOST_ZEROS:
        raise InputError(f"{path}: {zeros:,} values that it names are not in it; export it again")
    if gaussians:
        warn(f"{path}: the Gaussians in it ({GAUSSIANS}) are left out; only its mesh is opened")
    uris = (row.get("uri") for row in _rows(tree, "buffers"))
    return frozenset(uri for uri in uris if isinstance(uri, str) and not uri.startswith("data:"))


def _check_extensions(path: Path, tree: dict[str, Any], primitives: list[dict[str, Any]]) -> None:
    """Raises InputError if the file requires an extension that is not supported."""
    names = tree.get("extensionsRequired")
    required = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    accessors = _rows(tree, "accessors")
    for primitive in primitives:  # some exporters forget to list it as required
        attributes = primitive.get("attributes")
        index = attributes.get("POSITION") if isinstance(attributes, dict) else None
        there = isinstance(index, int) and 0 <= index < len(accessors) and "bufferView" in accessors[index]
        if DRACO in _extensions(primitive) and not there:
            required.append(DRACO)
    unknown = sorted({name for name in required if not name.startswith(HARMLESS)})
    for name in unknown:
        if name in PACKED:
            raise InputError(f"{path}: its mesh is {PACKED[name]} ({name}), which cannot be read; export it without")
    if unknown:
        raise InputError(f"{path}: it needs {', '.join(unknown)}, which cannot be read; export it without")


def _tree(path: Path) -> dict[str, Any]:
    """The JSON of a .glb or .gltf."""
    with open_file(path) as file:
        head = file.read(20)
        if head[:4] == MAGIC and len(head) == 20:
            version, _, size, chunk = struct.unpack("<4I", head[4:])
            if version == 1:
                raise _old(path, "1.0")
            if version != 2 or chunk != JSON_CHUNK or size > MOST_JSON:
                raise _damaged(path)
            data = file.read(size)
        else:
            data = read_file(path, MOST_JSON)
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise _damaged(path) from error
    if not isinstance(tree, dict):
        raise _damaged(path)
    return tree


def _rows(tree: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """The objects in one of a glTF's lists; an empty one for anything that is no object."""
    rows = tree.get(key)
    return [row if isinstance(row, dict) else {} for row in rows] if isinstance(rows, list) else []


def _extensions(row: dict[str, Any]) -> dict[str, Any]:
    found = row.get("extensions")
    return found if isinstance(found, dict) else {}


def _old(path: Path, version: str) -> InputError:
    return InputError(f"{path}: this is glTF {version}, which cannot be read; export it as glTF 2.0 (.glb)")


def _damaged(path: Path) -> InputError:
    return InputError(f"{path}: cannot be read as a mesh; the file is damaged or not what its name says")
