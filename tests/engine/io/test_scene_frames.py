"""Scenes at any place, in any unit, with any share of rubbish: read whole or refused, never as a remnant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from engine.errors import InputError
from engine.io.load import load
from engine.io.origin import origin_for
from engine.solid.find_body import find_body

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]
MAP = np.array([4.5e5, 5.4e6, 0.0])
N = 12_000


def ball(scale: float = 1.0) -> NDArray[np.float64]:
    """(N, 14). A sphere's skin in the values of a file."""
    z = np.linspace(-1, 1, N)
    angle = np.pi * (1 + 5**0.5) * np.arange(N)
    rows = np.zeros((N, 14))
    rows[:, :3] = scale * np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    rows[:, 6] = 4.6
    rows[:, 7:10] = np.log(0.02 * scale)
    rows[:, 10] = 1
    return rows


def write(path: Path, rows: NDArray[np.float64], kind: str = "binary_little_endian", type: str = "double") -> Path:
    lines = ["ply", f"format {kind} 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {type} {name}" for name in NAMES] + ["end_header", ""]
    order = ">" if "big" in kind else "<"
    body = rows.astype(f"{order}f{8 if type == 'double' else 4}").tobytes()
    if kind == "ascii":
        body = "".join(" ".join(f"{v:.12g}" for v in row) + "\n" for row in rows).encode()
    path.write_bytes("\n".join(lines).encode() + body)
    return path


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_map_coordinates_keep_their_volume(tmp_path: Path, kind: str) -> None:
    rows = ball()
    here = load(write(tmp_path / "here.ply", rows, kind))
    assert here.warnings == () and here.gaussians.origin == (0, 0, 0)
    rows[:, :3] += MAP
    far = load(write(tmp_path / "far.ply", rows, kind))
    assert far.gaussians.origin == (450000, 5400000, 0)
    assert len(far.warnings) == 1 and "moved by (-450000, -5400000, 0)" in far.warnings[0]
    assert np.abs(far.gaussians.means - here.gaussians.means).max() < 2e-5  # twelve digits in ascii
    if kind == "binary_little_endian":
        assert find_body(far.gaussians, 48).body.volume == pytest.approx(4.19, rel=0.05)


def test_a_file_that_has_lost_its_digits_says_so(tmp_path: Path) -> None:
    rows = ball()
    rows[:, :3] += MAP
    loaded = load(write(tmp_path / "a.ply", rows, type="float"))
    assert len(loaded.warnings) == 2
    assert "holds places only to 0.5 units, and its details have 0.02; export it in double" in loaded.warnings[1]


def test_a_mesh_in_map_coordinates(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(3)
    mesh.export(tmp_path / "here.obj", digits=12)
    mesh.apply_translation(MAP)
    mesh.export(tmp_path / "far.obj", digits=12)
    here, far = load(tmp_path / "here.obj"), load(tmp_path / "far.obj")
    assert here.gaussians.origin == (0, 0, 0)
    assert far.gaussians.origin == (450000, 5400000, 0)
    assert any("moved by (-450000, -5400000, 0)" in line for line in far.warnings)
    assert np.abs(here.gaussians.means - far.gaussians.means).max() < 1e-5


@pytest.mark.parametrize("exponent", [-12, -9, -7, -5, -3, 0, 3, 5, 7, 9, 12])
@pytest.mark.parametrize("type", ["float", "double"])
def test_any_unit_is_read_whole_or_refused(tmp_path: Path, exponent: int, type: str) -> None:
    path = write(tmp_path / "a.ply", ball(10.0**exponent), type=type)
    if -7 <= exponent <= 7:
        loaded = load(path)
        assert len(loaded.gaussians) == N and not loaded.warnings
        return
    with pytest.raises(InputError, match=r"scale (it|the scene)|other units") as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("places", [10.0, 1e3, 1e5, 1e7])
def test_any_place_is_the_same_scene(tmp_path: Path, places: float) -> None:
    rows = ball()
    rows[:, :3] += places
    gaussians = load(write(tmp_path / "a.ply", rows)).gaussians
    moved = gaussians.means.astype(np.float64) + gaussians.origin - places
    assert len(gaussians) == N and np.abs(moved - ball()[:, :3]).max() < 1e-3
    assert any(gaussians.origin) == (places > 2e4)  # only where it gains precision


@pytest.mark.parametrize("share", [1 / N, 0.1, 0.45])
@pytest.mark.parametrize("far", [1e7, 1e38])
def test_outliers_are_dropped_and_the_scene_stays(tmp_path: Path, share: float, far: float) -> None:
    rows, count = ball(), max(1, round(share * N))
    rows[-count:, 0] = far * np.linspace(1, 2, count)
    loaded = load(write(tmp_path / "a.ply", rows))
    assert len(loaded.gaussians) == N - count
    assert loaded.warnings == (f"{tmp_path / 'a.ply'}: {count:,} of {N:,} Gaussians dropped: absurd positions",)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [(0, np.nan, "NaN or Inf; the file is damaged"), (7, 80.0, "absurd sizes; they should lie"),
     (1, 1e12, "absurd positions; export"), (10, 0.0, "zero quaternions; the file is damaged")],
)  # fmt: skip
def test_a_rest_is_no_capture(tmp_path: Path, column: int, value: float, said: str) -> None:
    rows = ball()
    rows[46:, column] = value
    path = write(tmp_path / "a.ply", rows)
    with pytest.raises(InputError) as caught:
        load(path)
    line = str(caught.value)
    assert line.startswith((f"{path}: only 46 of the", f"{path}: none of the")) and f" can be used: {said}" in line


def test_ordinary_points_stay_where_they_are() -> None:
    points = np.random.default_rng(0).normal(5, 1, (1000, 3))
    for kind in (np.float32, np.float64):
        assert origin_for(Path("a"), points.astype(kind), 1e-3) == ((0, 0, 0), [])
        assert origin_for(Path("a"), points[:0].astype(kind), 1e-3) == ((0, 0, 0), [])
    assert origin_for(Path("a"), np.full((9, 3), 1e300), 1.0) == ((0, 0, 0), [])
