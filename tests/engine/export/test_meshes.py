"""Pieces as meshes: read back by other programs' readers they are closed, flat, and show the inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from trimesh.visual import TextureVisuals

pytest.importorskip("manifold3d", reason="the export extra is not installed")

import lib3mf

from engine.errors import InputError
from engine.export.body import body_of
from engine.export.colours import Colours
from engine.export.kinds import KINDS
from engine.export.meshes.cutting import MeshOptions
from engine.export.meshes.files import save_mesh
from engine.export.meshes.textured import TexturedPieces, textured_pieces
from engine.scene.grid import Body
from engine.scene.plane import Plane
from engine.solid.skin_cover import project_onto_skin
from tests.helpers.solids import Waves, filled_ball, waves

METRES, RADIUS = 0.1, 0.5
PLANES = (Plane.of((0.2, -0.3, 1.0), 0.03), Plane.of((1.0, 0.0, 0.0), -0.05))
ATOMS = filled_ball(1 / 16)


@pytest.fixture(scope="module")
def body() -> Body:
    return body_of(ATOMS, "ball")


@pytest.fixture(scope="module")
def made(body: Body) -> TexturedPieces:
    return textured_pieces(body, Colours(ATOMS, Waves()), PLANES, 0.004, "ball")


def reread(path: Path) -> dict[str, trimesh.Trimesh]:
    """The objects of a file by name, with merged points, in world units and the axes of the ball."""
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    if path.suffix != ".3mf":
        scene = trimesh.load_scene(path, split_objects=True) if path.suffix == ".obj" else trimesh.load_scene(path)
        found = {name: (mesh.vertices @ turn.T / METRES, mesh.faces) for name, mesh in scene.geometry.items()}
    else:
        model = lib3mf.get_wrapper().CreateModel()
        model.QueryReader("3mf").ReadFromFile(str(path))
        assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
        found, objects = {}, model.GetMeshObjects()
        while objects.MoveNext():
            mesh = objects.GetCurrentMeshObject()
            points = np.array([p.Coordinates[:] for p in mesh.GetVertices()]) / (1000 * METRES)
            found[mesh.GetName()] = points, np.array([t.Indices[:] for t in mesh.GetTriangleIndices()])
            first = mesh.GetTriangleProperties(0)
            assert model.GetTexture2DGroupByID(first.ResourceID).GetCount() > 0
    return {name: trimesh.Trimesh(points, faces, process=True) for name, (points, faces) in found.items()}


def test_the_body_of_a_ball_is_the_ball(body: Body) -> None:
    rays = np.random.default_rng(0).normal(size=(1000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    skin = np.linalg.norm(project_onto_skin(body, RADIUS * rays), axis=1)
    assert np.abs(skin - RADIUS).max() < 0.1 * ATOMS.pitch
    assert body.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)  # volume of lattice cells


@pytest.mark.parametrize("suffix", KINDS["mesh"].suffixes)
def test_pieces_are_closed_and_add_up_and_their_faces_are_flat(
    suffix: str, body: Body, made: TexturedPieces, tmp_path: Path
) -> None:
    path = tmp_path / f"ball{suffix}"
    save_mesh(path, made, (0.0, 0.0, 1.0), METRES)
    pieces = reread(path)
    assert sorted(pieces) == [f"piece_{n}" for n in (1, 2, 3, 4)]
    assert all(mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0 for mesh in pieces.values())
    assert sum(mesh.volume for mesh in pieces.values()) == pytest.approx(body.volume, rel=1e-3)
    whole = textured_pieces(body, Colours(ATOMS, None), [MeshOptions("whole")], 0.05, "ball").pieces[0].volume
    assert sum(mesh.volume for mesh in pieces.values()) == pytest.approx(whole, rel=1e-6)
    for mesh in pieces.values():
        for plane in PLANES:
            on = np.abs(plane.distance(mesh.triangles)).max(1) < 1e-5
            assert on.any() and (np.abs(mesh.face_normals[on] @ plane.normal) > 1 - 1e-6).all()
            assert np.abs(plane.distance(mesh.triangles[on])).max() < 2e-7


def test_a_face_shows_the_inside_right_up_to_its_edge_and_the_skin_its_atoms(
    made: TexturedPieces, tmp_path: Path
) -> None:
    path = tmp_path / "ball.glb"
    save_mesh(path, made, (0.0, 0.0, 1.0), 1.0)
    mesh = trimesh.load_scene(path).geometry["piece_2"]
    picture = np.asarray(mesh.visual.material.baseColorTexture, np.float64) / 255
    shares = np.random.default_rng(1).dirichlet((0.5, 0.5, 0.5), (len(mesh.faces), 8))
    points = np.einsum("tnk,tkc->tnc", shares, mesh.triangles) @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
    places = np.einsum("tnk,tkc->tnc", shares, mesh.visual.uv[mesh.faces])
    shown = bilinear(picture, places.reshape(-1, 2)).reshape(*points.shape)
    face = np.minimum.reduce([np.abs(plane.distance(points)).max(1) for plane in PLANES]) < 1e-5
    assert face.sum() > 50
    off = np.abs(shown[face] - waves(points[face].reshape(-1, 3)).reshape(-1, 8, 3))
    assert off.max() < 0.03  # bilinear between texels of waves, and 8 bits
    stripes = ATOMS.surface.sh[:, 0] @ np.ones(3)
    near = np.abs(shown[~face][:, 0] - np.array([0.125, 0.45, 0.15])).max(1)
    assert stripes.size and np.median(near) < 0.2 and near.max() < 0.4  # green stripes, no waves
    outward = np.einsum("nc,nc->n", mesh.vertex_normals, mesh.vertices - mesh.vertices.mean(0))
    assert (outward > 0).mean() > 0.95


def bilinear(picture: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reads a picture as a graphics card does, at places from its lower left corner."""
    height, width = picture.shape[:2]
    at = [(1 - places[:, 1]) * height - 0.5, places[:, 0] * width - 0.5]
    return np.stack([ndimage.map_coordinates(picture[..., c], at, order=1, mode="nearest") for c in range(3)], -1)


def test_a_piece_of_several_cells_is_one_closed_mesh_where_it_lies(body: Body) -> None:
    wall, low, high = Plane.of((0, 1, 0), 0.0), Plane.of((0, 0.4, 1), 0.0), Plane.of((0, -0.4, 1), 0.0)
    turn = np.array([[0.0, -1, 0, 2], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    bent = MeshOptions("bent", ((low, wall), (high, wall.flipped())), turn)
    piece = textured_pieces(body, Colours(ATOMS, None), [bent], 0.05, "ball").pieces[0]
    mesh = trimesh.Trimesh(piece.points, piece.triangles).copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    assert mesh.is_watertight and mesh.volume == pytest.approx(piece.volume, rel=1e-5)
    assert len(mesh.split()) == 1 and mesh.bounds.mean(0)[0] == pytest.approx(2.0, abs=0.02)
    inner = np.abs(piece.points[piece.triangles][..., 0] - 2).max(1) < 1e-5  # no wall remains between the cells
    assert not inner.any()


def test_an_obj_with_any_name_leaves_the_photograph_beside_it(made: TexturedPieces, tmp_path: Path) -> None:
    (tmp_path / "äpfel.png").write_bytes(b"a photograph")
    files = save_mesh(tmp_path / "äpfel.obj", made, (0, 0, 1), METRES)
    assert {path.name for path in files} == {"äpfel.obj", "äpfel.obj.mtl", "äpfel.obj.png"}
    assert (tmp_path / "äpfel.png").read_bytes() == b"a photograph"
    visual = trimesh.load_mesh(files[0]).visual
    assert isinstance(visual, TextureVisuals)
    assert np.asarray(visual.material.image).shape == made.texture.shape


def test_nothing_left_is_one_line(body: Body) -> None:
    with pytest.raises(InputError, match=r"^a\.glb: nothing to save"):
        textured_pieces(
            body, Colours(ATOMS, None), [MeshOptions("none", ((Plane.of((0, 0, 1), 9.0),),))], None, "a.glb"
        )
