"""Volumes and particles: read back by other readers they are the body, in place, with its colours and labels."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.export.colours import Colours
from engine.export.particles import DENSITY, particles_of, save_particles
from engine.export.voxels import Voxels, coarsened, voxels_of
from engine.light import as_linear
from engine.scene.grid import Body, Grid
from engine.scene.inside import KIND_NAMES, Kind
from engine.scene.plane import Plane
from tests.helpers.solids import Waves, ball, waves

RADIUS, CENTRE = 0.5, np.array([0.3, -0.2, 0.1])
HALF = Plane.of((0.3, 0.2, 1.0), -0.1)
UP, METRES = (0.0, 1.0, 0.0), 0.2
TO_RAS = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) * METRES * 1000
"""Turns y up into z up, in millimetres."""


@pytest.fixture(scope="module")
def body() -> Body:
    grid = Grid.around(np.stack([CENTRE - RADIUS, CENTRE + RADIUS]), 0.02, 4)
    return Body(grid, (RADIUS - np.linalg.norm(grid.centres() - CENTRE, axis=-1)).astype(np.float32))


@pytest.fixture(scope="module")
def voxels(body: Body) -> Voxels:
    return voxels_of(body, Colours(ball(1 / 4), Waves()), (HALF,), 0.025, "ball")


def true_volume() -> float:
    """Volume of the part that the plane keeps: a ball less a cap, or the cap."""
    h = RADIUS - abs(float(HALF.distance(CENTRE)))
    cap = np.pi * h**2 * (3 * RADIUS - h) / 3
    return cap if HALF.distance(CENTRE) > 0 else 4 / 3 * np.pi * RADIUS**3 - cap


def check(millimetres: NDArray[np.float64], rgb: NDArray[np.uint8], kind: NDArray[np.uint8]) -> None:
    """Asserts that colours and labels read from a file at places (N, 3) of its space are the true ones."""
    points = millimetres @ np.linalg.inv(TO_RAS).T
    depth = np.minimum(RADIUS - np.linalg.norm(points - CENTRE, axis=1), -HALF.distance(points))
    clear = np.abs(depth) > 0.002
    assert np.array_equal(kind[clear] > 0, depth[clear] > 0)
    inside = clear & (depth > 0)
    assert np.abs(rgb[inside] / 255 - waves(points[inside])).max() < 0.003
    assert np.array_equal(kind[inside], np.where(points[inside, 2] > 0, Kind.INSIDE, Kind.RIND))


def test_cells_add_up_to_the_volume_in_every_size(voxels: Voxels) -> None:
    assert voxels.share.sum() * voxels.grid.cell**3 == pytest.approx(true_volume(), rel=2e-3)
    small = coarsened(voxels)
    assert small.share.sum() * small.grid.cell**3 == pytest.approx(voxels.share.sum() * voxels.grid.cell**3, rel=1e-5)
    assert np.array_equal(small.grid.origin, voxels.grid.origin) and set(np.unique(small.kind)) == {0, 1, 2}


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd"])
def test_medical_formats_hold_colours_and_labels_in_place(suffix: str, voxels: Voxels, tmp_path: Path) -> None:
    nibabel = pytest.importorskip("nibabel", reason="the export extra is not installed")
    import nrrd

    from engine.export.volumes.files import save_volume

    files = save_volume(tmp_path / f"ball{suffix}", voxels, UP, METRES)
    assert [file.name for file in files] == [f"ball{suffix}", f"ball.labels{suffix}"]
    if suffix == ".nrrd":
        rgb, header = nrrd.read(str(files[0]))
        kind, of_labels = nrrd.read(str(files[1]))
        rgb = np.moveaxis(rgb, 0, -1)
        assert header["kinds"][0] == "RGB-color" and header["space"] == "right-anterior-superior"
        assert [of_labels[f"kind {n}"] for n in range(len(KIND_NAMES))] == list(KIND_NAMES)
        across, origin = header["space directions"][1:].T, header["space origin"]
    else:
        image, labels = nibabel.load(files[0]), nibabel.load(files[1])
        rgb = np.stack([np.asarray(image.dataobj)[c] for c in "RGB"], -1)
        kind = np.asarray(labels.dataobj)
        assert np.allclose(image.affine, labels.affine) and image.header.get_xyzt_units()[0] == "mm"
        across, origin = image.affine[:3, :3], image.affine[:3, 3]
    cells = np.argwhere(np.ones(kind.shape, bool))
    check(cells @ across.T + origin, rgb.reshape(-1, 3), kind.ravel())


def test_ome_zarr_has_smaller_versions_and_labels(voxels: Voxels, tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="the export extra is not installed")
    from engine.export.volumes.files import save_volume

    (path,) = save_volume(tmp_path / "ball.ome.zarr", voxels, UP, METRES)
    root = zarr.open_group(path, mode="r")
    described, labels = root.attrs["multiscales"][0], root["labels/kinds"]
    assert [axis["name"] for axis in described["axes"]] == ["c", "z", "y", "x"]
    assert root["labels"].attrs["labels"] == ["kinds"] and labels["0"].shape == voxels.kind.shape[::-1]
    for part in described["datasets"]:
        scale, shift = (list(step.values())[1] for step in part["coordinateTransformations"])
        rgb = np.asarray(root[part["path"]])
        assert rgb.shape == (3, *labels[part["path"]].shape)
        middle = np.array(rgb.shape[1:]) / 2 * scale[1:] + shift[1:] - np.array(scale[1:]) / 2
        assert np.allclose(middle[::-1] / (1000 * METRES), CENTRE, atol=scale[1] / (1000 * METRES))
    with pytest.raises(InputError, match="is there already"):
        save_volume(path, voxels, UP, METRES)


def test_a_printer_gets_pictures_of_the_stated_resolution(voxels: Voxels, tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the export extra is not installed")
    from engine.export.volumes.files import save_volume

    (path,) = save_volume(tmp_path / "ball.zip", voxels, UP, METRES)
    with zipfile.ZipFile(path) as archive:
        names = [name for name in archive.namelist() if name.endswith(".png")]
        note = json.loads(archive.read("stack.json"))
        layer = Image.open(io.BytesIO(archive.read(names[len(names) // 2])))
    assert len(names) == note["layers"] == voxels.grid.shape[2] and note["layer_millimetres"] == pytest.approx(5.0)
    assert layer.info["dpi"][0] == pytest.approx(25.4 / 5.0, rel=0.01)
    kept = voxels.kind[:, :, len(names) // 2].T[::-1] > 0
    assert np.array_equal(np.asarray(layer)[..., 3] > 0, kept)


def test_inks_add_up_to_the_colour() -> None:
    """In linear light, in every block and layer; where the inks cannot give a colour, the nearest that they can."""
    pytest.importorskip("zarr", reason="the export extra is not installed")
    from engine.export.volumes.inks import halftoned

    inks = [(0, 174, 239), (236, 0, 140), (255, 242, 0), (35, 31, 32), (255, 255, 255)]
    light = as_linear(np.array(inks) / 255)
    filled = np.ones((48, 48, 48), bool)
    filled[:8, :8] = False
    for colour in ((128, 128, 128), (230, 220, 180), (250, 250, 250)):
        rgb = np.broadcast_to(np.array(colour, np.uint8), (*filled.shape, 3))
        drops = halftoned(rgb, filled, inks)
        shown, wanted = light[drops], as_linear(np.array([colour]) / 255)[0]
        assert not drops[~filled].any()
        assert np.abs(shown[filled].mean(0) - wanted).max() < 0.008  # two steps of 255 in this light
        # Drops placed purely at random would spread by this much.
        chance = shown[filled].std(0) / np.sqrt(8**3)
        blocks = shown[8:, 8:].reshape(5, 8, 5, 8, 6, 8, 3).mean((1, 3, 5)).reshape(-1, 3)
        assert (blocks.std(0) < 0.7 * chance).all()
        for axis in range(3):
            others = tuple(other for other in range(3) if other != axis)
            assert shown[8:, 8:].mean(others).std(0).max() < 0.01
    red = halftoned(np.broadcast_to(np.array((255, 0, 0), np.uint8), (24, 24, 24, 3)), filled[8:32, 8:32, :24], inks)
    assert set(np.unique(red)) == {1, 2}
    nearest = min(np.linalg.norm(light[1] + t * (light[2] - light[1]) - [1, 0, 0]) for t in np.linspace(0, 1, 101))
    assert np.linalg.norm(light[red].mean((0, 1, 2)) - [1, 0, 0]) < nearest + 0.02


def test_particles_fill_the_body_to_its_ends(voxels: Voxels, tmp_path: Path) -> None:
    made = particles_of(voxels)
    assert made.volumes.sum() == pytest.approx(true_volume(), rel=2e-3)
    distance = np.minimum(RADIUS - np.linalg.norm(made.points - CENTRE, axis=1), -HALF.distance(made.points))
    assert distance.min() > -0.3 * made.spacing
    inside = CENTRE + np.random.default_rng(0).uniform(-RADIUS, RADIUS, (5000, 3))
    inside = inside[(np.linalg.norm(inside - CENTRE, axis=1) < RADIUS) & (HALF.distance(inside) < 0)]
    assert cKDTree(made.points).query(inside)[0].max() < made.spacing
    save_particles(tmp_path / "ball.npz", made, UP, METRES)
    with np.load(tmp_path / "ball.npz") as read:
        assert np.allclose(read["positions"], METRES * made.points, atol=1e-6)
        assert read["masses"].sum() == pytest.approx(DENSITY * true_volume() * METRES**3, rel=2e-3)
        assert list(read["label_names"]) == list(KIND_NAMES) and read["labels"].min() > 0
        assert read["colors"].shape == read["positions"].shape and read["spacing"] == pytest.approx(0.005)


def test_usd_points_have_mass_and_label(voxels: Voxels, tmp_path: Path) -> None:
    usd = pytest.importorskip("pxr.Usd", reason="the usd extra is not installed")
    from pxr import UsdGeom

    made = particles_of(voxels)
    save_particles(tmp_path / "ball.usdc", made, UP, METRES)
    stage = usd.Stage.Open(str(tmp_path / "ball.usdc"))
    points = UsdGeom.Points(stage.GetDefaultPrim())
    assert np.allclose(points.GetPointsAttr().Get(), METRES * made.points, atol=1e-6)
    values = UsdGeom.PrimvarsAPI(points)
    assert np.allclose(values.GetPrimvar("masses").Get(), DENSITY * made.volumes * METRES**3, rtol=1e-5)
    assert np.array_equal(values.GetPrimvar("labels").Get(), made.kind)


def test_too_fine_and_nothing_left_are_one_line(body: Body) -> None:
    colours = Colours(ball(1 / 4), Waves())
    with pytest.raises(InputError, match=r"^a\.nrrd: .* voxels are too many; give an edge of at least"):
        voxels_of(body, colours, (), 1e-5, "a.nrrd")
    with pytest.raises(InputError, match=r"^a\.nrrd: nothing to save"):
        voxels_of(body, colours, (Plane.of((0, 0, 1), 9.0),), 0.05, "a.nrrd")
