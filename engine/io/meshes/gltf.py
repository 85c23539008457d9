"""Checks a glTF file's JSON before its geometry is read, so that errors name what cannot be opened."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from engine.errors import InputError
from engine.io.gltf_tree import GAUSSIANS, extensions, read_tree, rows

__all__ = ["buffer_files"]

MOST_VALUES = 200_000_000
"""Most rows of all arrays together: those of ten times the faces of a fine scan."""

MOST_ZEROS = 5_000_000
"""Most rows that are not stored: zeros in a sparse accessor. A short file may claim any number."""

FACES = (4, 5)
"""Modes of primitives that are faces: triangles and strips of them. 4 is the default."""

SHAPES = {0: "points", 1: "lines", 2: "lines", 3: "lines", 6: "fans of triangles"}

DRACO = "KHR_draco_mesh_compression"
PACKED = {
    DRACO: "compressed with Draco",
    "EXT_meshopt_compression": "compressed with meshopt",
    "KHR_meshopt_compression": "compressed with meshopt",
    "KHR_mesh_quantization": "quantized",
}
"""Extensions that pack geometry, in the words of export dialogs."""

PLACED = "KHR_texture_transform"
"""Extension that moves, turns or scales a texture, which the reader of meshes does not apply."""

HARMLESS = ("KHR_materials_", "KHR_lights_", "KHR_xmp", "KHR_animation_", "EXT_texture_webp")
"""Prefixes of required extensions that change neither shape nor colours here, except WebP, which is supported."""


def buffer_files(path: Path, warn: Callable[[str], None]) -> frozenset[str]:
    """Names of the files with a glTF's geometry, as the glTF gives them; a .glb and data URIs hold theirs inside.

    Raises InputError if the file requires what cannot be read, has no faces, or is damaged. `warn` takes a line on
    Gaussians that are left out.
    """
    tree, _ = read_tree(path)
    primitives = [primitive for mesh in rows(tree, "meshes") for primitive in rows(mesh, "primitives")]
    modes = {mode for primitive in primitives if isinstance(mode := primitive.get("mode", 4), int)}
    gaussians = any(GAUSSIANS in extensions(primitive) for primitive in primitives)
    if modes and modes.isdisjoint(FACES):
        shapes = " and ".join(sorted({SHAPES.get(mode, "unknown shapes") for mode in modes}))
        raise InputError(f"{path}: there is no face in it, only {shapes}; a mesh with faces is needed")
    if len(modes & {6, *FACES}) > 1 and 6 in modes:
        warn(f"{path}: its {SHAPES[6]} are left out; the rest of its faces is opened")
    _check_extensions(path, tree, primitives)
    if any("sparse" in row for row in _used_arrays(tree, primitives)):
        raise InputError(f"{path}: its mesh is stored in sparse arrays, which cannot be read; export it without")
    counts = [(row, count) for row in rows(tree, "accessors") if isinstance(count := row.get("count"), int)]
    held = sum(max(count, 0) for row, count in counts if "bufferView" in row)
    zeros = sum(max(count, 0) for row, count in counts if "bufferView" not in row)
    if held > MOST_VALUES:
        raise InputError(f"{path}: {held:,} values in its arrays; the most is {MOST_VALUES:,}: simplify the mesh")
    if zeros > MOST_ZEROS:
        raise InputError(f"{path}: {zeros:,} values that it names are not in it; export it again")
    if gaussians:
        warn(f"{path}: the Gaussians in it ({GAUSSIANS}) are left out; only its mesh is opened")
    uris = (row.get("uri") for row in rows(tree, "buffers"))
    return frozenset(uri for uri in uris if isinstance(uri, str) and not uri.startswith("data:"))


def _check_extensions(path: Path, tree: dict[str, Any], primitives: list[dict[str, Any]]) -> None:
    """Raises InputError if the file requires an extension that is not supported."""
    names = tree.get("extensionsRequired")
    required = [name for name in names if isinstance(name, str)] if isinstance(names, list) else []
    accessors = rows(tree, "accessors")
    for primitive in primitives:  # some exporters forget to list it as required
        attributes = primitive.get("attributes")
        index = attributes.get("POSITION") if isinstance(attributes, dict) else None
        there = isinstance(index, int) and 0 <= index < len(accessors) and "bufferView" in accessors[index]
        if DRACO in extensions(primitive) and not there:
            required.append(DRACO)
    if any(_is_placed_anew(material) for material in _used_materials(tree, primitives)):
        raise InputError(
            f"{path}: its texture is placed by {PLACED} or a second set of coordinates, which cannot be read; apply it "
            "where the mesh was exported"
        )
    unknown = sorted({name for name in required if not name.startswith(HARMLESS)})
    for name in unknown:
        if name in PACKED:
            raise InputError(f"{path}: its mesh is {PACKED[name]} ({name}), which cannot be read; export it without")
    if unknown:
        raise InputError(f"{path}: it needs {', '.join(unknown)}, which cannot be read; export it without")


def _used_arrays(tree: dict[str, Any], primitives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The accessors of these primitives' corners and faces."""
    accessors = rows(tree, "accessors")
    numbers = [primitive.get("indices") for primitive in primitives]
    for primitive in primitives:
        attributes = primitive.get("attributes")
        numbers += attributes.values() if isinstance(attributes, dict) else []
    return [accessors[n] for n in numbers if isinstance(n, int) and 0 <= n < len(accessors)]


def _used_materials(tree: dict[str, Any], primitives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The materials of these primitives."""
    materials = rows(tree, "materials")
    numbers = {n for one in primitives if isinstance(n := one.get("material"), int)}
    return [materials[n] for n in sorted(numbers) if 0 <= n < len(materials)]


def _is_placed_anew(material: dict[str, Any]) -> bool:
    """Whether the picture of a material is read at other places than those of the first set of coordinates."""
    metallic = material.get("pbrMetallicRoughness")
    picture = metallic.get("baseColorTexture") if isinstance(metallic, dict) else None
    if not isinstance(picture, dict):
        return False
    placed = extensions(picture).get(PLACED)
    placed = placed if isinstance(placed, dict) else {}
    usual = {"offset": [0, 0], "rotation": 0, "scale": [1, 1]}
    moved = any(placed.get(name, same) != same for name, same in usual.items())
    return moved or placed.get("texCoord", picture.get("texCoord", 0)) != 0
