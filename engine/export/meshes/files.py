"""Writes textured pieces as glTF, Wavefront OBJ and 3MF."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import lib3mf
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.exchange.gltf import export_glb
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from engine.errors import InputError
from engine.export.meshes.textured import TexturedPieces
from engine.export.units import MILLIMETRES
from engine.io.files import atomic, atomic_together
from engine.scene.moved import Z_UP, upright

__all__ = ["save_mesh"]


def save_mesh(path: Path, made: TexturedPieces, up: Sequence[float], metres: float) -> list[Path]:
    """Writes pieces by the path's suffix, each as an object of its own, and returns the files written.

    `up` (3,) is the object's up axis in the pieces' coordinates, `metres` the length of a world unit. glTF and OBJ have
    y up and lengths in metres, 3MF has z up and millimetres. Raises InputError for any other suffix and if writing
    fails.
    """
    writers: dict[str, Callable[[Path, TexturedPieces, NDArray[np.float64]], list[Path]]] = {
        ".glb": _save_glb,
        ".obj": _save_obj,
        ".3mf": _save_3mf,
    }
    suffix = path.suffix.lower()
    if suffix not in writers:
        raise InputError(f"{path}: meshes are written as {', '.join(writers)}; give a name that ends in one of them")
    matrix = metres * upright(up)
    return writers[suffix](path, made, MILLIMETRES * Z_UP @ matrix if suffix == ".3mf" else matrix)


def _save_glb(path: Path, made: TexturedPieces, matrix: NDArray[np.float64]) -> list[Path]:
    # The capture's colours have its light in them: no gloss on top.
    material = PBRMaterial(
        name="solid",
        baseColorTexture=Image.fromarray(made.texture),
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=False,
    )
    scene = trimesh.Scene()
    for piece in made.pieces:
        mesh = trimesh.Trimesh(
            piece.points @ matrix.T,
            piece.triangles,
            vertex_normals=piece.normals @ _rotation(matrix).T,
            visual=TextureVisuals(uv=piece.places, material=material),
            process=False,
        )
        scene.add_geometry(mesh, node_name=piece.name, geom_name=piece.name)
    data = export_glb(scene, include_normals=True)
    with atomic(path) as temporary:
        temporary.write_bytes(data)
    return [path]


def _save_obj(path: Path, made: TexturedPieces, matrix: NDArray[np.float64]) -> list[Path]:
    # By its whole name, as a picture of the same stem is likely to be the photograph of a cut.
    material, picture = (path.with_name(path.name + suffix) for suffix in (".mtl", ".png"))
    out = io.StringIO()
    out.write(f"# FruitNinja\nmtllib {material.name}\nusemtl solid\n")
    first = 1
    for piece in made.pieces:
        out.write(f"o {piece.name}\n")
        np.savetxt(out, piece.points @ matrix.T, "v %.9g %.9g %.9g")
        np.savetxt(out, piece.places, "vt %.7f %.7f")
        np.savetxt(out, piece.normals @ _rotation(matrix).T, "vn %.5f %.5f %.5f")
        np.savetxt(out, np.repeat(piece.triangles + first, 3, axis=1), "f %d/%d/%d %d/%d/%d %d/%d/%d")
        first += len(piece.points)
    with atomic_together(path, material, picture) as (shape, look, texture):
        shape.write_text(out.getvalue(), encoding="utf-8")
        look.write_text(f"newmtl solid\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {picture.name}\n", encoding="utf-8")
        texture.write_bytes(_png(made.texture))
    return [path, material, picture]


def _save_3mf(path: Path, made: TexturedPieces, matrix: NDArray[np.float64]) -> list[Path]:
    model = lib3mf.get_wrapper().CreateModel()
    model.SetUnit(lib3mf.ModelUnit.MilliMeter)
    attachment = model.AddAttachment(
        "/3D/Texture/solid.png", "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dtexture"
    )
    attachment.ReadFromBuffer(_png(made.texture))
    texture = model.AddTexture2DFromAttachment(attachment)
    texture.SetContentType(lib3mf.TextureType.PNG)
    for piece in made.pieces:
        # In 3MF a point occurs once, and its texture coordinates belong to the triangles.
        points, own = np.unique((piece.points @ matrix.T).astype(np.float32), axis=0, return_inverse=True)
        group = model.AddTexture2DGroup(texture)
        places = [group.AddTex2Coord(lib3mf.Tex2Coord(u, v)) for u, v in piece.places.tolist()]
        mesh = model.AddMeshObject()
        mesh.SetName(piece.name)
        corners = own.reshape(-1)[piece.triangles].tolist()
        real = [n for n, (a, b, c) in enumerate(corners) if a != b != c != a]
        mesh.SetGeometry(
            [lib3mf.Position((lib3mf.ctypes.c_float * 3)(*point)) for point in points.tolist()],
            [lib3mf.Triangle((lib3mf.ctypes.c_uint32 * 3)(*corners[n])) for n in real],
        )
        number = group.GetResourceID()
        properties = [
            lib3mf.TriangleProperties(number, (lib3mf.ctypes.c_uint32 * 3)(*(places[i] for i in piece.triangles[n])))
            for n in real
        ]
        mesh.SetAllTriangleProperties(properties)
        mesh.SetObjectLevelProperty(number, places[0])
        model.AddBuildItem(mesh, lib3mf.get_wrapper().GetIdentityTransform())
    # Not into the file: where a disk is full, the library ends the process.
    data = bytes(model.QueryWriter("3mf").WriteToBuffer())
    with atomic(path) as temporary:
        temporary.write_bytes(data)
    return [path]


def _rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3). The rotation of a matrix that also scales."""
    return matrix / np.cbrt(np.linalg.det(matrix))


def _png(rgb: NDArray[np.uint8]) -> bytes:
    """A picture (H, W, 3) as a file."""
    out = io.BytesIO()
    Image.fromarray(rgb).save(out, format="PNG")
    return out.getvalue()
