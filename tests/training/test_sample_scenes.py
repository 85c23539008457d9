"""The sample scenes: solids that keep their promises, and shipped files that match what the solids generate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from engine.io.splats.ply import read_ply
from engine.scene import sh
from engine.scene.camera import Camera, orbit, section, spread_directions
from engine.scene.plane import Plane
from sample_scenes import make
from sample_scenes.exemplars import SUPERSAMPLE, crop, photograph, planes, snapshot
from sample_scenes.shell import LOOKS, NEARLY_OPAQUE, Look, shell
from sample_scenes.solids import SOLIDS, Solid

SCENES = Path(make.__file__).parent


@pytest.fixture(scope="module", params=list(SOLIDS))
def solid(request: pytest.FixtureRequest) -> Solid:
    return SOLIDS[request.param](0)


def rays(count: int, seed: int = 5) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_depth_is_a_distance_at_the_skin(solid: Solid) -> None:
    """Zero on the skin, slope one, and a true distance to either side of it for two per cent of the size."""
    points = solid.skin_points(rays(2000))
    assert np.abs(solid.depth(points)).max() < 1e-5
    step = 1e-3 * np.eye(3)
    slope = np.stack([solid.depth(points + e) - solid.depth(points - e) for e in step], axis=-1) / 2e-3
    # In the creases of a body (an apple's hollows, a loaf's edge) no smooth depth has slope one everywhere.
    assert np.quantile(np.abs(np.linalg.norm(slope, axis=-1) - 1), 0.98) < 0.05
    normals = solid.normals(points)
    for t in (-0.01, 0.005, 0.02):
        assert np.quantile(np.abs(solid.depth(points - t * normals) - t), 0.98) < 0.1 * abs(t)


def test_body_fills_its_bounds(solid: Solid) -> None:
    low, high = solid.bounds
    assert 1.9 < (high - low).max() < 2.1
    assert np.abs((low + high) / 2).max() < 0.08
    beyond = np.concatenate([solid.skin_points(rays(500)) * 1.02, [[1.2, 0, 0], [0, 0, 1.3]]])
    assert (solid.depth(beyond) < 0).all()
    # The middle is deep everywhere: no rind or crust may appear there.
    column = np.linspace(-0.3, 0.3, 61)
    inner = np.stack(np.meshgrid(column[::10], [-0.02, 0.0, 0.01, 0.2], column, indexing="ij"), axis=-1)
    assert solid.depth(inner).min() > 0.18


def test_slice_shows_the_colours_at_its_points(solid: Solid) -> None:
    """Each pixel of a slice has exactly the solid's colour where its ray, computed here separately, meets the plane."""
    plane = Plane.of([0.4, -0.5, 0.77], 0.05)
    n = np.asarray(plane.normal)
    for camera in (section(plane, solid.up, solid.bounds, 40), orbit([0, 0, 0], solid.up, 250, 60, 4.0, 48, 36)):
        rgb, inside = solid.slice(plane, camera)
        assert rgb.shape == (camera.height, camera.width, 3)
        assert 100 < inside.sum() < inside.size
        world = np.linalg.inv(camera.viewmat)
        rows, columns = np.nonzero(inside)
        x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
        if camera.orthographic:
            starts, steps = np.stack([x, y, 0 * x], 1) @ world[:3, :3].T + world[:3, 3], camera.forward[None]
        else:
            starts, steps = camera.position[None], np.stack([x, y, 0 * x + 1], 1) @ world[:3, :3].T
        points = starts - ((starts @ n + plane.offset) / (steps @ n))[:, None] * steps
        # The points agree to rounding, which may still pick the other side where a colour jumps (a cell's tint).
        error = np.abs(rgb[inside] - solid.colour(points)).max(-1)
        assert np.quantile(error, 0.995) < 1e-4
        assert (solid.depth(points) > -1e-6).all()
        assert (rgb[~inside] == 1).all()


def test_colours_are_colours_and_seeds_make_other_solids(solid: Solid) -> None:
    points = np.random.default_rng(1).uniform(-0.55, 0.55, (4000, 3))
    colours = solid.colour(points)
    assert colours.min() >= 0
    assert colours.max() <= 1
    again, other = SOLIDS[solid.name](0), SOLIDS[solid.name](1)
    np.testing.assert_array_equal(again.colour(points), colours)
    assert np.abs(other.colour(points) - colours).mean() > 0.01
    # They are of the same kind: the mean colour of the inside barely changes.
    assert np.abs(other.colour(points).mean(0) - colours.mean(0)).max() < 0.06


def test_shell_is_repeatable_and_closed(solid: Solid) -> None:
    look = Look(400, LOOKS[solid.name].degree, 0.2)
    first, second = (shell(solid, look, np.random.default_rng(3)) for _ in range(2))
    for name in ("means", "scales", "quats", "opacities", "sh"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert_closed(solid, first)


@pytest.mark.parametrize("name", make.SHIPPED)
def test_shipped_shell_is_the_solids_skin(name: str) -> None:
    solid, look = SOLIDS[name](0), LOOKS[name]
    gaussians, warnings = read_ply(SCENES / name / f"{name}.ply")
    assert not warnings
    assert gaussians.sh_degree == look.degree
    assert look.count < len(gaussians) < 1.06 * look.count
    assert_closed(solid, gaussians)
    firm = gaussians[gaussians.opacities > 0.9]
    firm = firm[np.abs(solid.depth(firm.means)) < 1e-3]
    assert len(firm) > 0.8 * look.count
    error = sh.sh_to_rgb(firm.sh[:, 0]) - solid.colour(firm.means)
    assert np.abs(error).mean() < 0.05  # a disc shows the mean of the skin around its centre
    assert np.linalg.norm(gaussians.means, axis=1).max() < 1.7  # floaters
    assert ((gaussians.opacities > 0.015) & (gaussians.opacities < 0.12)).sum() > 0.02 * look.count  # haze


@pytest.mark.parametrize("name", make.SHIPPED)
def test_shipped_pictures_are_slices(name: str) -> None:
    """Windows of every shipped picture, rendered again: the middle of the face and its left rim."""
    solid = SOLIDS[name](0)
    for kind in solid.families:
        files = sorted((SCENES / name).glob(f"{kind}_*.png"))
        assert 2 <= len(files) <= 4
        assert len(files) == len(planes(solid, kind))
        for file, plane in zip(files, planes(solid, kind), strict=True):
            picture = np.asarray(Image.open(file))
            assert picture.shape == (make.SIZE, make.SIZE, 3)
            face = np.argwhere((picture < 250).any(-1))
            assert (np.abs(face.mean(0) - make.SIZE / 2) < 0.05 * make.SIZE).all()
            assert abs(np.ptp(face, axis=0).max() / make.SIZE - 0.85) < 0.02
            c = crop(solid, plane, make.SIZE)
            for x, y in ((240, 250), (30, 240)):
                window = Camera(c.viewmat, c.fx, c.fy, c.cx - x, c.cy - y, 40, 40, orthographic=True)
                truth = solid.slice(plane, window, supersample=SUPERSAMPLE)[0] * 255
                assert np.abs(picture[y : y + 40, x : x + 40] - truth).max() < 1.5


def test_shipped_files_stay_small() -> None:
    files = [path for name in make.SHIPPED for path in (SCENES / name).iterdir()]
    assert sum(path.stat().st_size for path in files) < 8e6


def test_command_writes_the_same_bytes_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(make, "SIZE", 32)
    monkeypatch.setitem(LOOKS, "cake", Look(300, 0, 0.0))
    for folder in ("a", "b"):
        assert make.main(["--only", "cake", "--out", str(tmp_path / folder), "--seed", "4"]) == 0
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert [file.name for file in files] == ["cake.ply", "radial_1.png", "radial_2.png"]
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    (tmp_path / "file").write_text("")
    assert make.main(["--only", "cake", "--out", str(tmp_path / "file")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_photograph_is_white_around_the_face(solid: Solid) -> None:
    picture = photograph(solid, planes(solid, solid.families[0])[0], 48)
    assert picture.dtype == np.uint8
    assert (picture[[0, 0, -1, -1], [0, -1, 0, -1]] == 255).all()


def assert_closed(solid: Solid, gaussians) -> None:
    """No skin point is farther than the core of a splat, 1.18 standard deviations, from a nearly opaque Gaussian."""
    firm = gaussians[gaussians.opacities >= NEARLY_OPAQUE]
    firm = firm[np.abs(solid.depth(firm.means)) < 1e-3]
    points = solid.skin_points(spread_directions(6007))
    near = cKDTree(firm.means).query(points, 16)[1]
    axes = Rotation.from_quat(firm.quats, scalar_first=True).as_matrix()
    in_plane = np.einsum("mki,mkij->mkj", points[:, None] - firm.means[near], axes[near])[..., :2]
    distance = np.linalg.norm(in_plane / firm.scales[near][..., :2], axis=-1).min(axis=1)
    assert np.quantile(distance, 0.999) < 1.18
    assert distance.max() < 1.6


def test_a_snapshot_is_squashed_in_lamplight_and_has_a_shadow() -> None:
    solid = SOLIDS["orange"](3)
    plane = planes(solid, "radial")[0]
    day, lamp = (take(solid, plane, 64) / 255 for take in (photograph, snapshot))
    middle = np.s_[22:42, 22:42]
    gain = lamp[middle].mean((0, 1)) / day[middle].mean((0, 1))
    assert gain[2] / gain[0] == pytest.approx(0.82, abs=0.08)  # red is clipped
    tall = [np.ptp(np.nonzero((face.std(-1) > 0.05).any(1))[0]) for face in (day, lamp)]
    assert tall[1] / tall[0] == pytest.approx(0.9, abs=0.04)
    below = lamp[-10:].min()
    assert 0.6 < below < 0.9 and day[-4:].min() == 1
