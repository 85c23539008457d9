"""Textured meshes as 3DGS scenes: the surface sampled into flat Gaussians that carry the texture's colours."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from engine.errors import InputError
from engine.files import open_file
from engine.gaussians import Gaussians
from engine.origin import origin_for
from engine.ply_header import read_header
from engine.scatter import scatter
from engine.sh import rgb_to_sh
from engine.suffixes import MESH_SUFFIXES

__all__ = ["read_mesh"]

# trimesh reports broken textures to its log; without a handler Python would print them with a traceback.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

IN_PLANE = 0.75
"""Standard deviation along the surface, in mean spacings sqrt(area / count). At this the kernels add up to 1.3 or more
in the widest gaps of a smooth body, where 0.5 is opaque; more would only blur the texture."""

FLATNESS = 0.2
"""Standard deviation across the surface, as a part of the one along it."""

OPACITY = 0.99
"""Opaque as far as 3DGS goes; its renderers cap alpha there."""

GREY = 0.6

Colours = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]
"""RGB (K, 3) in [0, 1] at K points, given by face (K,) and barycentric coordinates (K, 3)."""


@dataclass(frozen=True)
class Part:
    """One piece of a mesh with one way of being coloured."""

    triangles: NDArray[np.float64]
    """(F, 3, 3). World units."""
    colours: Colours


def read_mesh(
    path: str | Path, count: int = 60_000, seed: int = 0, warn: Callable[[str], None] = lambda line: None
) -> Gaussians:
    """`count` flat Gaussians, SH degree 0, spread evenly over the surface of an .obj, .glb, .gltf, .ply or .stl.

    Their third axis is the face's normal; along the surface they reach as far as closes the shell. The colour is the
    texture's (bilinear), else the vertices', the faces' or the material's, else grey, and then `warn` is told in one
    line. Colours are taken as they stand, without conversion. Raises InputError where there is no surface, or a
    texture is missing.
    """
    assert count > 0, count
    path = Path(path)
    parts = _parts(path, warn)
    triangles = np.concatenate([part.triangles for part in parts])
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    area = float(areas.sum())
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
        mine = (face >= first) & (face < first + len(part.triangles))
        rgb[mine] = part.colours(face[mine] - first, weights[mine])
        first += len(part.triangles)
    sigma = IN_PLANE * float(np.sqrt(area / count))
    return Gaussians(
        np.einsum("nk,nkc->nc", weights, corners).astype(np.float32),
        np.tile(np.array([sigma, sigma, FLATNESS * sigma], np.float32), (count, 1)),
        _towards(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])),
        np.full(count, OPACITY, np.float32),
        rgb_to_sh(rgb).astype(np.float32)[:, None],
        origin=origin,
    )


def _towards(normals: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, 4). Shortest rotations of the z axis onto normals (N, 3) of any non-zero length, wxyz."""
    n = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    # The half-way quaternion (1 + z.n, z x n); where n is -z any half turn across z will do.
    quats = np.stack([1 + n[:, 2], -n[:, 1], n[:, 0], np.zeros(len(n))], axis=1)
    quats[quats[:, 0] < 1e-12] = [0, 1, 0, 0]
    return (quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32)


def _parts(path: Path, warn: Callable[[str], None]) -> list[Part]:
    """The triangles of all geometries of a file, where its scene graph puts them."""
    kind = _kind(path)
    files = _Neighbours(str(path))
    try:
        with open_file(path) as file:
            scene = trimesh.load_scene(file, file_type=kind, resolver=files, process=False)
        placed = [(scene.geometry[name], matrix) for matrix, name in map(scene.graph.get, scene.graph.nodes_geometry)]
        meshes = [(mesh, matrix) for mesh, matrix in placed if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
        soups = [trimesh.transform_points(mesh.vertices, matrix)[mesh.faces] for mesh, matrix in meshes]
    except InputError:
        raise
    except Exception as error:  # trimesh lets through whatever its many parsers stumble over
        raise InputError(f"{path}: cannot be read as a mesh; the file is damaged or not what its name says") from error
    if not soups:
        raise InputError(f"{path}: there is no face in it; a mesh with faces is needed")
    if files.missing:
        name = files.missing[0]
        if not name.lower().endswith(".mtl"):
            raise InputError(f"{path}: its file '{name}' is missing; put it into the same folder")
        warn(f"{path}: its material file '{name}' is missing")
    if files.broken:
        raise InputError(f"{path}: its texture '{files.broken[0]}' is no picture that can be read")
    parts = []
    notes: set[str] = set()
    dropped = 0
    for (mesh, _), soup in zip(meshes, soups, strict=True):
        sound = np.isfinite(soup).all((1, 2))
        dropped += int((~sound).sum())
        colours, note = _colours(path, mesh, np.flatnonzero(sound))
        notes.add(note)
        parts.append(Part(soup[sound].astype(np.float64), colours))
    if dropped:
        warn(f"{path}: {dropped:,} faces dropped: NaN or Inf")
    for note in sorted(notes - {""}):
        warn(f"{path}: {note}{' in a part of it' if len(notes) > 1 else ''}; it gets one plain colour")
    return parts


def _kind(path: Path) -> str:
    """The format as trimesh calls it. Raises InputError where it is none of ours."""
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


class _Neighbours(trimesh.resolvers.FilePathResolver):
    """Files that a mesh refers to, from its own folder only. Remembers what is wrong with them; trimesh is silent."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.missing: list[str] = []
        self.broken: list[str] = []

    def get(self, name: str) -> bytes:
        # Exporters write other systems' paths; then the file usually lies right beside the mesh.
        for candidate in (name, name.replace("\\", "/").rsplit("/", 1)[-1]):
            try:
                data = super().get(candidate)
            except (OSError, ValueError):
                continue
            if not name.lower().endswith((".mtl", ".bin")) and not _is_picture(data):
                self.broken.append(_short(name))
            return data
        self.missing.append(_short(name))
        raise FileNotFoundError(name)


def _is_picture(data: bytes) -> bool:
    """Whether Pillow knows these bytes for a picture, from their header."""
    try:
        Image.open(BytesIO(data)).close()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False
    return True


def _short(name: str) -> str:
    """A file's name as a mesh gives it, fit for one line."""
    return " ".join(name.split())[:80]


def _colours(path: Path, mesh: Any, faces: NDArray[np.int64]) -> tuple[Colours, str]:
    """How these faces (F,) of a trimesh mesh are coloured, and what the user should know about it."""
    visual = mesh.visual
    corners = np.asarray(mesh.faces)[faces]
    if visual.kind == "vertex":
        table = np.asarray(visual.vertex_colors)[:, :3] / 255
        return lambda face, weights: np.einsum("nk,nkc->nc", weights, table[corners[face]]), ""
    if visual.kind == "face":
        table = np.asarray(visual.face_colors)[faces, :3] / 255
        return lambda face, weights: table[face], ""
    if visual.kind != "texture" or visual.material is None:
        return lambda face, weights: np.full((len(face), 3), GREY), "no texture and no colours"
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if image is not None and visual.uv is not None:
        texture = _pixels(path, image)
        factor = getattr(material, "baseColorFactor", None)
        tint = np.ones(3) if factor is None else trimesh.visual.to_rgba(factor)[:3] / 255
        uv = np.asarray(visual.uv, np.float64)
        return (
            lambda face, weights: tint * _bilinear(texture, np.einsum("nk,nkc->nc", weights, uv[corners[face]])),
            "",
        )
    flat = np.asarray(trimesh.visual.to_rgba(material.main_color), np.float64)[:3] / 255
    # Texture coordinates without a texture: its format may be one that cannot be read.
    note = "" if visual.uv is None or not np.ptp(visual.uv) else "no texture that can be read"
    return lambda face, weights: np.tile(flat, (len(face), 1)), note


def _pixels(path: Path, image: Image.Image) -> NDArray[np.uint8]:
    """(H, W, 3). Raises InputError where the picture is damaged."""
    try:
        return np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError, MemoryError) as error:  # what Pillow raises for broken pictures
        raise InputError(f"{path}: its texture is damaged; export it again") from error


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
