"""Samples of captures, and the memory that reading large ones takes."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from engine.io.load import load, load_sample
from engine.io.mapped import map_arrays
from engine.io.splats.ply import ply_data, read_ply, write_ply
from tests.engine.io.test_splat_formats import N, compressed, scene, splat, spz
from tests.helpers.solids import round_gaussians

MOST = 70
STRIDE = 9
"""The smallest step that leaves at most MOST of the 600 Gaussians."""


def written(path: Path, kind: str) -> Path:
    true = scene(0 if kind == "splat" else 2)
    if kind in ("ply", "ascii"):
        data = ply_data(true)
        data.text = kind == "ascii"
        data.write(str(path))
    else:
        path.write_bytes({"compressed": compressed, "splat": splat, "spz": spz}[kind](true))
    return path


@pytest.mark.parametrize(
    ("kind", "suffix"),
    [("ply", ".ply"), ("ascii", ".ply"), ("compressed", ".ply"), ("splat", ".splat"), ("spz", ".spz")],
)
def test_a_sample_has_every_so_many_of_all(tmp_path: Path, kind: str, suffix: str) -> None:
    path = written(tmp_path / f"a{suffix}", kind)
    whole, sample = load(path).gaussians, load_sample(path, MOST)
    assert sample is not None and len(whole) == N
    found = sample.gaussians
    assert len(found) == -(-N // STRIDE) <= MOST and found.sh_degree == 0
    for name in ("means", "scales", "quats", "opacities"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)[::STRIDE]), name
    assert np.array_equal(found.sh, whole.sh[::STRIDE, :1])
    assert sample.file_axes == load(path).file_axes
    again = load_sample(path, 2 * N)
    assert again is not None and np.array_equal(again.gaussians.means, whole.means)


def test_what_cannot_be_sampled_is_left_to_the_whole_reading(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "broken.ply").write_bytes(b"ply\n")
    far = scene()
    far.means[:] += 1e6
    write_ply(tmp_path / "far.ply", far)
    for name in ("a.obj", "broken.ply", "far.ply", "nowhere.ply"):
        assert load_sample(tmp_path / name, MOST) is None, name


def test_a_capture_is_read_in_little_more_memory_than_it_takes(tmp_path: Path) -> None:
    count = 200_000
    r = np.random.default_rng(2)
    g = round_gaussians(r.normal(size=(count, 3)), 0.01, 0.5, bands=16)
    g.scales[7] = np.nan  # dropping a row must not copy the rest
    path = tmp_path / "large.ply"
    write_ply(path, g)
    size = sum(a.nbytes for a in (g.means, g.scales, g.quats, g.opacities, g.sh))
    tracemalloc.start()
    found, warnings = read_ply(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == count - 1 and warnings
    assert peak < 1.4 * size, f"{peak / size:.2f} times the capture"
    assert np.array_equal(found.means, np.delete(g.means, 7, 0))


def test_mapped_arrays_are_those_that_were_saved(tmp_path: Path) -> None:
    arrays = {
        "means": np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32),
        "removed": np.array([True, False, True]),
        "none": np.zeros((0, 3), np.float32),
    }
    save_file(arrays, tmp_path / "a.safetensors")
    found = map_arrays(tmp_path / "a.safetensors")
    assert found.keys() == arrays.keys()
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)
    found["means"][0] = 7.0
    assert np.array_equal(map_arrays(tmp_path / "a.safetensors")["means"], arrays["means"])
