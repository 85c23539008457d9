"""Meshes as scenes: the shell is even and closed, its colours are the texture's, and broken files get one line."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from engine.io.load import load
from engine.io.meshes.mesh import read_mesh
from engine.io.picture_file import PICTURES
from engine.scene.gaussians import Gaussians
from engine.scene.sh import sh_to_rgb
from tests.helpers.refusal import refusal
from tests.paths import SHARED

DATA = SHARED
REAL = pytest.mark.skipif(not DATA.exists(), reason="the folder of real scans is absent")

# A square of side 2 in the plane z = 3, texture upright on it.
SQUARE = "mtllib s.mtl\nusemtl m\n" + "".join(f"v {x} {y} 3\n" for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)])
SQUARE += "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def square(folder: Path, texture: NDArray[np.uint8] | None = None) -> Path:
    (folder / "s.obj").write_text(SQUARE + FACES)
    (folder / "s.mtl").write_text("newmtl m\nmap_Kd s.png\n")
    if texture is not None:
        Image.fromarray(texture).save(folder / "s.png")
    return folder / "s.obj"


def ramp() -> NDArray[np.uint8]:
    """(100, 50, 3). Red grows to the right by 5 per texel, green downwards by 2; blue is 51."""
    y, x = np.mgrid[:100, :50]
    return np.stack([5 * x, 2 * y, np.full_like(x, 51)], axis=-1).astype(np.uint8)


def rgb(g: Gaussians) -> NDArray[np.float32]:
    return sh_to_rgb(g.sh[:, 0])


def axes(g: Gaussians) -> NDArray[np.float64]:
    """(N, 3, 3). Principal axes as columns."""
    return Rotation.from_quat(g.quats[:, [1, 2, 3, 0]]).as_matrix()


def kernel_sums(g: Gaussians, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums of exp(-q/2) over the 24 nearest Gaussians at points (K, 3); nothing farther matters."""
    turn = axes(g)
    total = np.zeros(len(points))
    for j in cKDTree(g.means).query(points, k=24)[1].T:
        local = np.einsum("nij,ni->nj", turn[j], points - g.means[j]) / g.scales[j]
        total += np.exp(-0.5 * (local**2).sum(1))
    return total


def test_texture_colours_in_closed_form(tmp_path: Path) -> None:
    g = read_mesh(square(tmp_path, ramp()), 4000)
    inner = (np.abs(g.means[:, :2]) < 0.95).all(1)  # in the outer half texel the texture wraps around
    x, y = g.means[inner, 0].astype(float), g.means[inner, 1].astype(float)
    red = 5 * ((x + 1) / 2 * 50 - 0.5)
    green = 2 * ((1 - y) / 2 * 100 - 0.5)
    expected = np.stack([red, green, np.full_like(red, 51)], axis=1) / 255
    np.testing.assert_allclose(rgb(g)[inner], expected, atol=2e-6)


def test_flat_gaussians_lie_in_the_surface(tmp_path: Path) -> None:
    g = read_mesh(square(tmp_path, ramp()), 1000)
    assert len(g) == 1000
    assert g.sh_degree == 0
    np.testing.assert_array_equal(g.means[:, 2], 3)
    np.testing.assert_allclose(np.abs(axes(g)[:, 2, 2]), 1, atol=1e-6)
    np.testing.assert_allclose(
        g.scales, np.tile(np.sqrt(4 / 1000) * np.array([0.75, 0.75, 0.15]), (1000, 1)), rtol=1e-5
    )
    np.testing.assert_allclose(g.opacities, 0.99)
    np.testing.assert_allclose(np.linalg.norm(g.quats, axis=1), 1, atol=1e-6)


def test_points_are_even(tmp_path: Path) -> None:
    """Against independent random points: less than a fifth of their variance of the count in cells of 40 points."""
    g = read_mesh(square(tmp_path, ramp()), 4000)
    counts = np.histogram2d(g.means[:, 0], g.means[:, 1], bins=10, range=[[-1, 1], [-1, 1]])[0]
    assert counts.var() < 0.2 * 40
    nearest = cKDTree(g.means).query(g.means, k=2)[0][:, 1] / np.sqrt(4 / 4000)
    assert nearest.min() > 0.6  # spacings; random points come down to 0.01


def test_a_seed_is_a_scan(tmp_path: Path) -> None:
    path = square(tmp_path, ramp())
    a, b, c = read_mesh(path, 500, 1), read_mesh(path, 500, 1), read_mesh(path, 500, 2)
    np.testing.assert_array_equal(a.means, b.means)
    np.testing.assert_array_equal(a.sh, b.sh)
    assert not np.array_equal(a.means, c.means)


@pytest.mark.parametrize("suffix", ["obj", "glb", "ply"])
def test_formats_agree(tmp_path: Path, suffix: str) -> None:
    """The same square, written by trimesh; texture coordinates must not be upside down in any format."""
    mesh = trimesh.load_mesh(square(tmp_path, ramp()))
    assert isinstance(mesh.visual, trimesh.visual.TextureVisuals)
    # In a .glb a material of another colour would tint the texture, as the format demands.
    mesh.visual.material.diffuse = np.full(4, 255, np.uint8)
    if suffix == "ply":
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=mesh.visual.to_color().vertex_colors)
    (tmp_path / "out").mkdir()
    mesh.export(tmp_path / f"out/s.{suffix}")
    g = read_mesh(tmp_path / f"out/s.{suffix}", 500)
    inner = (np.abs(g.means[:, :2]) < 0.9).all(1)
    x, y = g.means[inner, 0], g.means[inner, 1]
    if suffix == "ply":  # four corner colours, interpolated over two triangles
        corner = np.corrcoef(rgb(g)[inner, 0], x)[0, 1], np.corrcoef(rgb(g)[inner, 1], -y)[0, 1]
        assert min(corner) > 0.95
    else:
        np.testing.assert_allclose(rgb(g)[inner, 0], 5 * ((x + 1) * 25 - 0.5) / 255, atol=1e-5)
        np.testing.assert_allclose(rgb(g)[inner, 1], 2 * ((1 - y) * 50 - 0.5) / 255, atol=1e-5)


def test_a_scene_of_parts(tmp_path: Path) -> None:
    """A red ball, doubled by its node's transform, and a blue box: points by share of area, in place."""
    ball, box = trimesh.creation.icosphere(subdivisions=3), trimesh.creation.box((2, 2, 2))
    for mesh, colour in ((ball, [255, 0, 0, 255]), (box, [0, 0, 255, 255])):
        material = trimesh.visual.material.PBRMaterial(baseColorFactor=colour)
        mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), material=material)
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=trimesh.transformations.scale_and_translate(2, [10, 0, 0]))
    scene.add_geometry(box)
    scene.export(tmp_path / "s.glb")
    g = read_mesh(tmp_path / "s.glb", 20_000)
    red = rgb(g)[:, 0] > 0.5
    np.testing.assert_allclose(rgb(g)[red], [[1, 0, 0]] * red.sum(), atol=1e-6)
    np.testing.assert_allclose(rgb(g)[~red], [[0, 0, 1]] * (~red).sum(), atol=1e-6)
    assert red.mean() == pytest.approx(4 * ball.area / (4 * ball.area + 24), abs=0.002)
    radii = np.linalg.norm(g.means[red] - [10, 0, 0], axis=1)
    assert 1.97 < radii.min() <= radii.max() < 2.0001
    np.testing.assert_allclose(np.abs(g.means[~red]).max(1), 1, atol=1e-6)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n%s"
PLY += "element face 1\nproperty list uchar int vertex_indices\n%send_header\n"


def test_vertex_and_face_colours(tmp_path: Path) -> None:
    colour = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    (tmp_path / "v.ply").write_text(PLY % (colour, "") + "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n")
    g = read_mesh(tmp_path / "v.ply", 500)
    x, y = g.means[:, 0], g.means[:, 1]
    np.testing.assert_allclose(rgb(g), np.stack([1 - x - y, x, y], axis=1), atol=1e-6)
    (tmp_path / "f.ply").write_text(PLY % ("", colour) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 51 102 153\n")
    np.testing.assert_allclose(rgb(read_mesh(tmp_path / "f.ply", 10)), [[0.2, 0.4, 0.6]] * 10, atol=1e-6)


def test_grey_with_a_warning(tmp_path: Path) -> None:
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "box.stl")
    loaded = load(tmp_path / "box.stl")
    assert loaded.warnings == (f"{tmp_path / 'box.stl'}: no texture and no colours; it gets one plain colour",)
    assert np.ptp(rgb(loaded.gaussians)) < 1e-6
    (tmp_path / "s.obj").write_text(SQUARE + FACES)  # its material file was left behind
    warnings: list[str] = []
    read_mesh(tmp_path / "s.obj", 10, warn=warnings.append)
    assert "s.mtl" in warnings[0]


def test_a_texture_that_cannot_be_read_is_told(tmp_path: Path) -> None:
    data = trimesh.load_mesh(square(tmp_path, ramp())).export(file_type="glb")
    assert isinstance(data, bytes)
    (tmp_path / "s.glb").write_bytes(data.replace(b"\x89PNG", b"\0PNG"))
    warnings: list[str] = []
    read_mesh(tmp_path / "s.glb", 10, warn=warnings.append)
    assert warnings == [f"{tmp_path / 's.glb'}: no texture that can be read ({PICTURES}); it gets one plain colour"]


def test_faces_without_area_take_no_points(tmp_path: Path) -> None:
    path = square(tmp_path, ramp())
    path.write_text(SQUARE + "f 1/1 1/1 2/2\n" + FACES + "v 5 5 nan\nf 1/1 2/2 5/1\nf 4/4 4/4 4/4\n")
    warnings: list[str] = []
    g = read_mesh(path, 300, warn=warnings.append)
    assert all(np.isfinite(a).all() for a in vars(g).values())
    assert np.abs(g.means[:, :2]).max() <= 1
    assert warnings == [f"{path}: 1 faces dropped: NaN or Inf"]


def test_faces_that_are_given_twice_count_once(tmp_path: Path) -> None:
    """Faces with the same corners in the same cyclic order count once; a face and its back are two."""
    once = read_mesh(square(tmp_path, ramp()), 300)
    path = square(tmp_path)
    path.write_text(SQUARE + FACES + "f 2/2 3/3 1/1\nf 4/4 1/1 3/3\nf 1/1 2/2 3/3\n")
    warnings: list[str] = []
    g = read_mesh(path, 300, warn=warnings.append)
    assert all(np.array_equal(a, b) for a, b in zip(vars(g).values(), vars(once).values(), strict=True))
    assert warnings == [f"{path}: 3 faces dropped: each lies on another that is the same"]
    warnings.clear()
    path.write_text(SQUARE + FACES + "f 3/3 2/2 1/1\nf 4/4 3/3 1/1\n" + "f 1/1 1/1 2/2\n" * 3)
    assert 0.4 < (axes(read_mesh(path, 300, warn=warnings.append))[:, 2, 2] > 0).mean() < 0.6
    assert warnings == []


def test_a_mesh_reads_only_its_own_folder(tmp_path: Path) -> None:
    """However a name leads out of it, the texture counts as missing, even though there is a picture."""
    (tmp_path / "in").mkdir()
    path = square(tmp_path / "in")
    Image.fromarray(ramp()).save(tmp_path / "secret.png")
    (tmp_path / "in/link.png").symlink_to(tmp_path / "secret.png")
    (tmp_path / "in/loop.png").symlink_to(tmp_path / "in/loop.png")
    (tmp_path / "in/up").symlink_to(tmp_path)
    outside = ("../secret.png", "..\\secret.png", f"{tmp_path}/secret.png", "link.png", "up/secret.png", "loop.png")
    for name in (*outside, "~/secret.png", "http://127.0.0.1/secret.png", "x" * 5000, "a\0.png"):
        (tmp_path / "in/s.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
        assert "is missing" in refusal(lambda: read_mesh(path, 10), f"{path}: "), name
    (tmp_path / "in/my textures").mkdir()
    Image.fromarray(ramp()).save(tmp_path / "in/my textures/s.png")
    (tmp_path / "in/s.mtl").write_text("newmtl m\nmap_Kd my textures/s.png\n")
    assert len(read_mesh(path, 10)) == 10


def test_a_texture_that_is_named_often_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = square(tmp_path, ramp())
    (tmp_path / "s.mtl").write_text("".join(f"newmtl m{i}\nmap_Kd s.png\n" for i in range(50)) + "newmtl m\n")
    read: list[Path] = []
    kept = lambda path, limit: [read.append(path), path.read_bytes()][1]  # noqa: E731
    monkeypatch.setattr("engine.io.meshes.files.read_file", kept)
    read_mesh(path, 10)
    assert sorted(p.name for p in read) == ["s.mtl", "s.png"]


def test_textures_with_foreign_paths_are_found(tmp_path: Path) -> None:
    path = square(tmp_path, ramp())
    (tmp_path / "s.mtl").write_text("newmtl m\nmap_Kd C:\\scans\\today\\s.png\n")
    assert np.ptp(rgb(read_mesh(path, 100))[:, 0]) > 0.5


def no_texture(folder: Path) -> Path:
    return square(folder)


def broken_texture(folder: Path) -> Path:
    path = square(folder, ramp())
    whole = (folder / "s.png").read_bytes()
    (folder / "s.png").write_bytes(whole[: len(whole) // 2])
    return path


def no_picture(folder: Path) -> Path:
    path = square(folder)
    (folder / "s.png").write_bytes(b"hello")
    return path


def content(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


GLB = b"glTF\x02\0\0\0" + (1000).to_bytes(4, "little")
HUGE = (PLY % ("", "")).replace("face 1", f"face {10**12}").encode() + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no texture": (no_texture, "its file 's.png' is missing"),
    "broken texture": (broken_texture, "texture"),
    "no picture": (no_picture, "its texture 's.png': this is no picture"),
    "empty obj": (content("a.obj", b""), ""),
    "only points": (content("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no face"),
    "no area": (content("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), "none of the 1 faces has an area"),
    "all nan": (content("a.obj", b"v nan 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"), "has an area"),
    "index beyond": (content("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"), ""),
    "not an obj": (content("a.obj", bytes(range(256)) * 20), ""),
    "broken glb": (content("a.glb", GLB), "damaged"),
    "glb in name": (content("a.glb", b"hello"), "damaged"),
    "broken gltf": (content("a.gltf", b"{"), "damaged"),
    "gltf from the net": (
        content("a.gltf", b'{"asset":{"version":"2.0"},"buffers":[{"uri":"http://localhost/a.bin","byteLength":9}]}'),
        "",
    ),
    "empty stl": (content("a.stl", b""), ""),
    "10^12 faces": (content("a.ply", HUGE), "1,000,000,000,000 rows of 'face'"),
    "cloud": (content("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"), "cloud"),
    "splat": (content("a.splat", b"\0" * 64), "none of the 2"),
    "picture": (content("a.png", b"\x89PNG"), "a picture, not a capture"),
    "nothing": (content("a.ply", b""), ""),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_opened_gets_one_line(tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]) -> None:
    make, expected = BAD[case]
    path = make(tmp_path)
    assert expected in refusal(lambda: load(path), f"{path}: ")
    assert capfd.readouterr() == ("", "")


@REAL
def test_a_scanned_apple_is_closed_and_has_its_colours() -> None:
    path = DATA / "meshes/ycb_013_apple/textured.obj"
    g = read_mesh(path)
    mesh = trimesh.load_mesh(path, process=False)
    points, _, colours = trimesh.sample.sample_surface(mesh, 20_000, sample_color=True, seed=5)
    sums = kernel_sums(g, points)
    assert sums.min() > 1  # twice the sum that an opaque image takes for solid
    ours, theirs = rgb(g), colours[:, :3] / 255
    np.testing.assert_allclose(ours.mean(0), theirs.mean(0), atol=0.005)
    np.testing.assert_allclose(ours.std(0), theirs.std(0), atol=0.005)
    nearest = cKDTree(points).query(g.means)[1]
    assert np.abs(ours - theirs[nearest]).mean() < 0.04  # points a third of a millimetre apart
    octant = lambda p: np.bincount((p > mesh.centroid) @ [1, 2, 4], minlength=8) / len(p)  # noqa: E731
    areas = np.bincount((mesh.triangles_center > mesh.centroid) @ [1, 2, 4], mesh.area_faces, 8) / mesh.area
    np.testing.assert_allclose(octant(g.means), areas, atol=0.003)


@REAL
@pytest.mark.parametrize("name", ["unit_sphere.STL", "torus.STL"])
def test_shapes_of_known_truth(name: str) -> None:
    path = DATA / f"meshes/trimesh_{name}"
    mesh = trimesh.load_mesh(path)
    g = read_mesh(path, 20_000)
    points, face = trimesh.sample.sample_surface(mesh, 5000, seed=1)
    assert kernel_sums(g, points).min() > 1
    nearest = cKDTree(points).query(g.means)[1]
    along = np.abs(np.einsum("ni,ni->n", axes(g)[:, :, 2], mesh.face_normals[face[nearest]]))
    assert np.quantile(along, 0.01) > 0.9
    # The divergence theorem: the flux of x/3 through the shell is the volume.
    tree = cKDTree(mesh.triangles_center)
    normals = mesh.face_normals[tree.query(g.means)[1]]
    flux = np.einsum("ni,ni->n", g.means, normals).mean() / 3 * mesh.area
    assert flux == pytest.approx(mesh.volume, rel=0.01)


@REAL
def test_real_files_open_by_what_they_are() -> None:
    assert load(DATA / "splats/donut_mipsplatting.ply").warnings == ()
    assert len(load(DATA / "meshes/trimesh_bunny.ply").gaussians) == 60_000
    for name in ("photos/opencv_fruits.jpg", "volumes/vhm_thigh_rgba.npz"):
        refusal(partial(load, DATA / name), f"{DATA / name}: ")


def test_an_obj_may_count_its_points_back(tmp_path: Path) -> None:
    """Each of two triangles by the last three points; the same with all indices from the beginning."""
    relative = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\n"
    (tmp_path / "relative.obj").write_text(relative)
    first, second, _ = relative.split("-3 -2 -1")
    (tmp_path / "absolute.obj").write_text(f"{first}1 2 3{second}4 5 6\n")
    one, other = (read_mesh(tmp_path / name, 500) for name in ("relative.obj", "absolute.obj"))
    assert np.array_equal(one.means, other.means) and one.means[:, 0].min() < 1 and one.means[:, 0].max() > 5
