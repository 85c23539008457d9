"""Turns textured meshes into 3DGS scenes: flat Gaussians sampled on the surface, with the colours of the texture."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from engine.errors import InputError
from engine.io.files import open_file
from engine.io.formats import MESH_SUFFIXES
from engine.io.meshes.files import MeshFiles
from engine.io.meshes.gltf import buffer_files
from engine.io.meshes.obj import absolute_indices
from engine.io.meshes.surface_sampling import scatter
from engine.io.origin import origin_for
from engine.io.picture_file import PICTURES, check_size, decoding, restricted_decoders
from engine.io.ply_header import read_header
from engine.light import as_linear, as_srgb
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import facing
from engine.scene.sh import rgb_to_sh

__all__ = ["read_mesh"]

# trimesh logs broken textures; without a handler Python would print them with a traceback.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

IN_PLANE = 0.75
"""Standard deviation along the surface, in mean spacings sqrt(area / count). The kernels then add up to 1.3 or more in
the widest gaps of a smooth body, where 0.5 is opaque; a larger value would only blur the texture."""

FLATNESS = 0.2
"""Ratio of the standard deviation across the surface to that along it."""

OPACITY = 0.99
"""The highest opacity that 3DGS allows: its renderers cap alpha here."""

NO_COLOURS = "no texture and no colours"
NO_TEXTURE = f"no texture that can be read ({PICTURES})"

GREY = 0.6

MAX_FACES = 20_000_000
"""Twenty times a fine scan; two gigabytes in world space. A short file may instance one part any number of times."""

Colours = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]
"""RGB (K, 3) in [0, 1] at K points, given by face (K,) and barycentric coordinates (K, 3)."""


@dataclass(frozen=True)
class Part:
    """One part of a mesh with one kind of colours."""

    triangles: NDArray[np.float64]
    """(F, 3, 3). World units."""
    colours: Colours


def read_mesh(
    path: str | Path, count: int = 60_000, seed: int = 0, warn: Callable[[str], None] = lambda line: None
) -> Gaussians:
    """`count` flat Gaussians, SH degree 0, spread evenly over the surface of an .obj, .glb, .gltf, .ply or .stl.

    Their third axis is the face's normal; along the surface they are large enough to close the shell. Colours come from
    the texture (bilinear), the vertices, the faces or the material (`_colours`); otherwise they are grey, with a
    warning. Repeated faces count once, also with a warning; `warn` takes one line each. Raises InputError if there is
    no surface, or if a texture is missing or not a picture.
    """
    assert count > 0, count
    path = Path(path)
    parts = _parts(path, warn)
    triangles = np.concatenate([part.triangles for part in parts])
    area = float((_doubled_areas(triangles) / 2).sum())
    if not area > 0:
        raise InputError(f"{path}: none of the {len(triangles):,} faces has an area")
    origin, moved = origin_for(path, triangles.reshape(-1, 3), float(np.sqrt(area / count)))
    for line in moved:
        warn(line)
    triangles -= np.asarray(origin)
    face, weights = scatter(triangles, count, np.random.default_rng(seed))
    corners = triangles[face]
    rgb = np.empty((count, 3))
    first = 0
    for part in parts:
        in_part = (face >= first) & (face < first + len(part.triangles))
        rgb[in_part] = part.colours(face[in_part] - first, weights[in_part])
        first += len(part.triangles)
    sigma = IN_PLANE * float(np.sqrt(area / count))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Gaussians(
        np.einsum("nk,nkc->nc", weights, corners).astype(np.float32),
        np.tile(np.array([sigma, sigma, FLATNESS * sigma], np.float32), (count, 1)),
        facing(normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        np.full(count, OPACITY, np.float32),
        rgb_to_sh(rgb).astype(np.float32)[:, None],
        origin=origin,
    )


def _parts(path: Path, warn: Callable[[str], None]) -> list[Part]:
    """The triangles of all geometries of a file, placed by its scene graph."""
    kind = _kind(path)
    files = MeshFiles(path, buffer_files(path, warn) if kind in ("glb", "gltf") else frozenset())
    try:
        # trimesh opens pictures inside the file, or named as buffers, before any check of ours.
        with open_file(path) as opened, restricted_decoders():
            file = absolute_indices(opened) if kind == "obj" else opened
            scene = trimesh.load_scene(file, file_type=kind, resolver=files, process=False)
        placed = [(scene.geometry[name], matrix) for matrix, name in map(scene.graph.get, scene.graph.nodes_geometry)]
        meshes = [(mesh, matrix) for mesh, matrix in placed if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        many = sum(len(mesh.faces) for mesh, _ in meshes)
        if many > MAX_FACES:
            raise InputError(f"{path}: {many:,} faces; the most is {MAX_FACES:,}: simplify the mesh")
        triangle_lists = [trimesh.transform_points(mesh.vertices, matrix)[mesh.faces] for mesh, matrix in meshes]
    except InputError:
        raise
    except Exception as error:  # trimesh does not catch the errors of its many parsers
        files.check(warn)
        raise InputError(f"{path}: cannot be read as a mesh; the file is damaged or not what its name says") from error
    if not triangle_lists:
        raise InputError(f"{path}: there is no face in it; a mesh with faces is needed")
    files.check(warn)
    triangles = np.concatenate(triangle_lists).astype(np.float64)
    finite = np.logical_and.reduce(np.abs(triangles) <= np.finfo(np.float32).max, axis=(1, 2))  # false for NaN
    repeated = _repeated(triangles, finite)
    parts = []
    notes: set[str] = set()
    first = 0
    for mesh, _ in meshes:
        part = slice(first, first + len(mesh.faces))
        kept = np.flatnonzero((finite & ~repeated)[part])
        colours, note = _colours(path, mesh, kept, kind in ("glb", "gltf"))
        notes.add(note)
        parts.append(Part(triangles[part][kept], colours))
        first = part.stop
    if not finite.all():
        warn(f"{path}: {(~finite).sum():,} faces dropped: NaN or Inf")
    if repeated.any():
        warn(f"{path}: {repeated.sum():,} faces dropped: each lies on another that is the same")
    for note in sorted(notes - {""}):
        warn(f"{path}: {note}{' in a part of it' if len(notes) > 1 else ''}; it gets one plain colour")
    return parts


def _repeated(triangles: NDArray[np.float64], among: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F,). Faces with an area that repeat an earlier one, facing the same side; some exporters write all faces twice.

    They would count as additional area and take some of its points, which looks torn if the colours differ.
    """
    index = np.flatnonzero(among)
    corners = triangles[index]
    has_area = _doubled_areas(corners) > 0
    index, corners = index[has_area], corners[has_area]
    # Each face starts at its smallest corner; the winding, and so the side, stays.
    order = np.lexsort(corners.transpose(2, 0, 1)[::-1], axis=1)[:, :1] + np.arange(3)
    rows = np.take_along_axis(corners, order[..., None] % 3, axis=1).reshape(-1, 9)
    sorted_rows = np.lexsort(rows.T)  # stable: the earliest of equal faces comes first
    result = np.zeros(len(triangles), np.bool_)
    result[index[sorted_rows[1:][(rows[sorted_rows[1:]] == rows[sorted_rows[:-1]]).all(1)]]] = True
    return result


def _doubled_areas(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(F,). Twice the area of each triangle."""
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)


def _kind(path: Path) -> str:
    """The format by trimesh's name. Raises InputError for an unsupported one."""
    with open_file(path) as file:
        start = file.read(4)
    if start == b"glTF":
        return "glb"
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{path}: not a mesh that can be opened; these can: {', '.join(MESH_SUFFIXES)}")
    if suffix == ".ply" and not read_header(path).faces:
        raise InputError(f"{path}: there is no face in it; a mesh with faces is needed")
    return suffix[1:]


def _colours(path: Path, mesh: Any, faces: NDArray[np.int64], is_gltf: bool) -> tuple[Colours, str]:
    """The colours of these faces (F,) of a trimesh mesh, and a note for the user, empty if there is none.

    In a glTF, the colours of a material and of vertices are linear light and multiply the texture, which is sRGB
    (glTF 2.0, 3.9.2). In other files, the first that there is of texture, vertices, faces and material is taken.
    """
    visual = mesh.visual
    corners = np.asarray(mesh.faces)[faces]
    if is_gltf:
        return _gltf_colours(path, visual, corners)
    if visual.kind == "vertex":
        table = np.asarray(visual.vertex_colors)[:, :3] / 255
        return lambda face, weights: _between(weights, table[corners[face]]), ""
    if visual.kind == "face":
        table = np.asarray(visual.face_colors)[faces, :3] / 255
        return lambda face, weights: table[face], ""
    if visual.kind != "texture" or visual.material is None:
        return lambda face, weights: np.full((len(face), 3), GREY), NO_COLOURS
    material = visual.material
    image = getattr(material, "image", None)
    if image is not None and visual.uv is not None:
        texture, uv = _pixels(path, image), np.asarray(visual.uv, np.float64)
        return lambda face, weights: _bilinear(texture, _between(weights, uv[corners[face]])), ""
    flat = np.asarray(trimesh.visual.to_rgba(material.main_color), np.float64)[:3] / 255
    # Texture coordinates without a texture: its format may be unsupported.
    note = "" if visual.uv is None or not np.ptp(visual.uv) else NO_TEXTURE
    return lambda face, weights: np.tile(flat, (len(face), 1)), note


def _gltf_colours(path: Path, visual: Any, corners: NDArray[np.int64]) -> tuple[Colours, str]:
    """`_colours` of a glTF's faces with these corners (F, 3)."""
    material = getattr(visual, "material", None) if visual.kind == "texture" else None
    vertices = visual.vertex_attributes.get("color") if material is not None else None
    if visual.kind == "vertex":
        vertices = visual.vertex_colors
    if material is None and vertices is None:
        return lambda face, weights: np.full((len(face), 3), GREY), NO_COLOURS
    factor = getattr(material, "baseColorFactor", None)
    tint = np.ones(3) if factor is None else np.asarray(trimesh.visual.to_rgba(factor), np.float64)[:3] / 255
    table = None if vertices is None else _as_parts(np.asarray(vertices)[:, :3])
    image, uv = getattr(material, "baseColorTexture", None), getattr(visual, "uv", None)
    texture = None if image is None or uv is None else _pixels(path, image)
    places = None if uv is None else np.asarray(uv, np.float64)

    def colours(face: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        rgb = np.ones((len(face), 3))
        if texture is not None and places is not None:
            rgb = _bilinear(texture, _between(weights, places[corners[face]]))
            if table is None and (tint == 1).all():
                return rgb
        light = as_linear(rgb) * tint
        return as_srgb(light if table is None else light * _between(weights, table[corners[face]]))

    is_lost = texture is None and table is None and uv is not None and bool(np.ptp(uv))
    return colours, NO_TEXTURE if is_lost else ""


def _between(weights: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(K, C). Values between those at the corners (K, 3, C) of faces, by barycentric weights (K, 3)."""
    return np.einsum("nk,nkc->nc", weights, corners)


def _as_parts(values: NDArray[Any]) -> NDArray[np.float64]:
    """Colours in [0, 1], of which integers are parts of the largest of their type."""
    whole = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1.0
    return np.clip(values / whole, 0, 1)


def _pixels(path: Path, image: Image.Image) -> NDArray[np.uint8]:
    """(H, W, 3). Raises InputError if the picture is damaged or too large."""
    with decoding(f"{path}: its texture"):
        return np.asarray(check_size(image).convert("RGB"))


def _bilinear(texture: NDArray[np.uint8], uv: NDArray[np.float64]) -> NDArray[np.float64]:
    """RGB (K, 3) at texture coordinates (K, 2): v upwards, repeated beyond [0, 1], texel centres at half-integers."""
    height, width = texture.shape[:2]
    u, v = np.nan_to_num(uv, posinf=0, neginf=0).T
    x, y = (u % 1) * width - 0.5, (1 - v % 1) * height - 0.5
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    x0, x1, y0, y1 = x0 % width, (x0 + 1) % width, y0 % height, (y0 + 1) % height
    upper = texture[y0, x0] * (1 - fx) + texture[y0, x1] * fx
    lower = texture[y1, x0] * (1 - fx) + texture[y1, x1] * fx
    return (upper * (1 - fy) + lower * fy) / 255
