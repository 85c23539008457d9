"""Trained objects on disk: the round trip, what other viewers see, and files that do not belong together."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData

from engine.io import trained
from engine.io.trained import Meta, find_trained, is_trained, load_trained, save_trained, sidecar_path
from engine.scene.atoms import Atoms, InteriorAtoms, SurfaceAtoms
from engine.scene.sh import C0
from tests.helpers.refusal import refusal

META = Meta((0.0, -1.0, 0.0), ({"kind": "radial", "count": 30, "exemplars": ["b.png"]},), 7, "exemplar", "apple é.ply")


def some(surface: int, interior: int, degree: int, seed: int = 0) -> Atoms:
    r = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return r.normal(size=shape).astype(np.float32)

    quats = normal(surface, 4)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    return Atoms(
        SurfaceAtoms(normal(surface, 3), np.exp(normal(surface, 3) - 4), quats, normal(surface, (degree + 1) ** 2, 3)),
        InteriorAtoms(normal(interior, 3), np.exp(normal(interior) - 4), r.random((interior, 3), np.float32)),
        0.0123,
    )


@settings(max_examples=25, deadline=None)
@given(
    surface=st.integers(1, 30),
    interior=st.integers(0, 30),
    degree=st.integers(0, 3),
    seed=st.integers(0, 2**32),
)
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, surface: int, interior: int, degree: int, seed: int
) -> None:
    path = tmp_path_factory.mktemp("trained") / "apple.v2.ply"
    atoms = some(surface, interior, degree, seed)
    save_trained(path, atoms, META)
    back, meta = load_trained(path)
    assert meta == META
    assert back.pitch == atoms.pitch
    np.testing.assert_array_equal(back.surface.means, atoms.surface.means)
    np.testing.assert_array_equal(back.interior.means, atoms.interior.means)
    np.testing.assert_array_equal(back.surface.sh, atoms.surface.sh)
    np.testing.assert_allclose(back.surface.scales, atoms.surface.scales, rtol=1e-6)
    np.testing.assert_allclose(back.interior.sigmas, atoms.interior.sigmas, rtol=1e-6)
    np.testing.assert_allclose(back.surface.quats, atoms.surface.quats, atol=1e-6)
    np.testing.assert_allclose(back.interior.rgb, atoms.interior.rgb, atol=1e-6)
    assert 0 <= back.interior.rgb.min(initial=0) <= back.interior.rgb.max(initial=1) <= 1


def test_other_viewers_see_a_plain_scene(tmp_path: Path) -> None:
    """Read with plyfile alone: surface first, then opaque spheres of one colour each, padded to the surface's SH."""
    atoms = some(5, 4, degree=3)
    save_trained(tmp_path / "a.ply", atoms, META)
    rows = PlyData.read(str(tmp_path / "a.ply"))["vertex"].data
    assert len(rows) == 9
    assert len(rows.dtype.names) == 62
    assert all(np.isfinite(rows[name]).all() for name in rows.dtype.names)
    np.testing.assert_array_equal(rows["x"], np.concatenate([atoms.surface.means, atoms.interior.means])[:, 0])
    np.testing.assert_allclose(1 / (1 + np.exp(-rows["opacity"])), 0.999, atol=1e-6)
    inner = rows[5:]
    for axis in range(3):
        np.testing.assert_allclose(np.exp(inner[f"scale_{axis}"]), atoms.interior.sigmas, rtol=1e-6)
        np.testing.assert_allclose(
            0.5 + 0.28209479177387814 * inner[f"f_dc_{axis}"], atoms.interior.rgb[:, axis], atol=1e-6
        )
    assert all((inner[f"f_rest_{i}"] == 0).all() for i in range(45))
    assert [inner[f"rot_{i}"].tolist() for i in range(4)] == [[1] * 4, [0] * 4, [0] * 4, [0] * 4]


def test_a_pair_survives_renaming_together(tmp_path: Path) -> None:
    save_trained(tmp_path / "a.ply", some(3, 3, 0), META)
    shutil.move(tmp_path / "a.ply", tmp_path / "b.ply")
    assert "no a.fruitninja.json" not in refusal(lambda: load_trained(tmp_path / "b.ply"))
    shutil.move(tmp_path / "a.fruitninja.json", tmp_path / "b.fruitninja.json")
    assert len(load_trained(tmp_path / "b.ply")[0]) == 6


def test_foreign_and_missing_halves(tmp_path: Path) -> None:
    save_trained(tmp_path / "a.ply", some(3, 3, 0, seed=1), META)
    save_trained(tmp_path / "b.ply", some(3, 3, 0, seed=2), META)
    shutil.copy(sidecar_path(tmp_path / "a.ply"), sidecar_path(tmp_path / "b.ply"))
    assert "belongs to another file" in refusal(lambda: load_trained(tmp_path / "b.ply"))
    sidecar_path(tmp_path / "b.ply").unlink()
    assert "no b.fruitninja.json beside it" in refusal(lambda: load_trained(tmp_path / "b.ply"))
    (tmp_path / "a.ply").unlink()
    assert "no such file" in refusal(lambda: load_trained(tmp_path / "a.ply"))


def test_an_object_remembers_where_its_capture_lay(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    save_trained(path, some(3, 3, 0), META)
    assert "origin" not in json.loads(sidecar_path(path).read_text())  # as before, byte by byte
    far = dataclasses.replace(META, origin=(450000.0, 5400000.0, 0.0))
    save_trained(path, some(3, 3, 0), far)
    assert load_trained(path)[1] == far
    assert b"comment FruitNinja: add 450000 5400000 0 to be back" in path.read_bytes()
    good = json.loads(sidecar_path(path).read_text())
    for value in (None, [1, 2], [1, 2, float("nan")], "x"):
        sidecar_path(path).write_text(json.dumps({**good, "origin": value}))
        refusal(lambda: load_trained(path))


def test_damaged_scene(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    save_trained(path, some(3, 3, 0), META)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    assert "belongs to another file" in refusal(lambda: load_trained(path))


@pytest.mark.parametrize("killed_in", ["write", "dumps", "replace 1", "replace 2"])
def test_an_end_in_the_middle_leaves_the_old_pair(
    tmp_path: Path, killed_in: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ply"
    old = some(3, 4, 0, seed=1)
    save_trained(path, old, META)
    calls = 0

    def die(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    def replace(self: Path, target: Path) -> Path:
        nonlocal calls
        calls += 1
        if calls == int(killed_in[-1]):
            raise KeyboardInterrupt
        return Path(shutil.move(str(self), str(target)))

    if killed_in == "write":
        monkeypatch.setattr("plyfile.PlyData.write", die)
    elif killed_in == "dumps":
        monkeypatch.setattr(trained.json, "dumps", die)
    else:
        monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        save_trained(path, some(4, 3, 0, seed=2), META)
    monkeypatch.undo()
    np.testing.assert_array_equal(load_trained(path)[0].surface.means, old.surface.means)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.fruitninja.json", "a.ply"]


MALFORMED: dict[str, Any] = {
    "format": [None, 2, "1", [1]],
    "surface": [None, -1, 2, 3.0, True, "3", 10**30],
    "interior": [None, 5],
    "pitch": [None, 0, -1.0, "x", float("nan"), float("inf"), 10**400],
    "up": [None, [0, 1], [0, 0, 0], [0, "1", 0], [0, float("nan"), 0], 3],
    "families": [None, {}, [3]],
    "seed": [None, -1, 0.5],
    "prior": [None, 3],
    "source": [None, 3],
    "ply_bytes": [None, 3.5],
    "ply_crc32": [None, "x", 0],
}


@pytest.mark.parametrize("key", MALFORMED)
def test_malformed_fields(tmp_path: Path, key: str) -> None:
    path = tmp_path / "a.ply"
    save_trained(path, some(3, 3, 0), META)
    good = json.loads(sidecar_path(path).read_text())
    for value in MALFORMED[key]:
        sidecar_path(path).write_text(json.dumps({**good, key: value}))
        refusal(lambda: load_trained(path))
    sidecar_path(path).write_text(json.dumps({k: v for k, v in good.items() if k != key}))
    refusal(lambda: load_trained(path))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b"3",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"format": 1' + b" " * (1 << 25),
        b'{"format": 1, "format": 1}',
        b'{"format": ' + b"1" * 5000 + b"}",
        b'{"a":' * 50_000,
    ],
)
def test_malformed_json(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "a.ply"
    save_trained(path, some(3, 3, 0), META)
    sidecar_path(path).write_bytes(text)
    assert "sidecar" in refusal(lambda: load_trained(path))


def test_atoms_that_no_reader_takes_are_not_saved(tmp_path: Path) -> None:
    atoms = some(3, 3, 0)
    atoms.interior.rgb[1, 2] = np.nan
    with pytest.raises(AssertionError, match="sh"):
        save_trained(tmp_path / "a.ply", atoms, META)
    flat = dataclasses.replace(atoms.surface, scales=np.zeros((3, 3), np.float32))
    with pytest.raises(AssertionError, match="scales"):
        save_trained(tmp_path / "a.ply", Atoms(flat, some(0, 3, 0).interior, 0.1), META)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e7])  # sizes within and beyond the range of an .spz
def test_a_compact_object_is_the_object_to_its_steps(tmp_path: Path, unit: float) -> None:
    plain = some(40, 60, 2)
    surface = dataclasses.replace(
        plain.surface,
        means=plain.surface.means * np.float32(unit),
        scales=plain.surface.scales * np.float32(unit),
        sh=np.clip(plain.surface.sh, -1, 0.99),
    )
    interior = dataclasses.replace(
        plain.interior,
        means=plain.interior.means * np.float32(unit),
        sigmas=plain.interior.sigmas * np.float32(unit),
    )
    atoms = Atoms(surface, interior, plain.pitch * unit)
    path = tmp_path / "apple.spz"
    save_trained(path, atoms, META)
    back, meta = load_trained(path)
    assert meta == META and back.pitch == atoms.pitch
    for one, other in ((back.surface, surface), (back.interior, interior)):
        np.testing.assert_allclose(one.means, other.means, atol=2e-4 * unit)
    np.testing.assert_allclose(back.surface.scales, surface.scales, rtol=3e-4)
    np.testing.assert_allclose(back.interior.sigmas, interior.sigmas, rtol=3e-4)
    assert np.abs((back.surface.quats * surface.quats).sum(1)).min() > 1 - 1e-5
    np.testing.assert_allclose(back.surface.sh[:, 1:], surface.sh[:, 1:], atol=1 / 127)
    np.testing.assert_allclose(back.interior.rgb, interior.rgb, atol=0.004)


def test_what_an_older_object_shows_through_holes_belongs_to_its_skin(tmp_path: Path) -> None:
    atoms, path = some(5, 8, 1), tmp_path / "a.ply"
    save_trained(path, atoms, META)
    record = json.loads(sidecar_path(path).read_text())
    sidecar_path(path).write_text(json.dumps({**record, "exposed": 3}))
    back, _ = load_trained(path)
    assert (len(back.surface), len(back.interior)) == (8, 5)
    np.testing.assert_array_equal(back.surface.means[5:], atoms.interior.means[:3])
    np.testing.assert_allclose(back.surface.scales[5:], atoms.interior.sigmas[:3, None].repeat(3, 1), rtol=1e-6)
    np.testing.assert_allclose(0.5 + C0 * back.surface.sh[5:, 0], atoms.interior.rgb[:3], atol=1e-6)
    assert not back.surface.sh[5:, 1:].any()


@pytest.mark.parametrize("value", [None, -1, 9, "1"])
def test_an_older_object_has_no_more_of_these_than_atoms(tmp_path: Path, value: Any) -> None:
    path = tmp_path / "a.ply"
    save_trained(path, some(5, 8, 1), META)
    record = json.loads(sidecar_path(path).read_text())
    sidecar_path(path).write_text(json.dumps({**record, "exposed": value}))
    refusal(lambda: load_trained(path))


@pytest.mark.parametrize("sizes", ["", "!", "AAAA", "é", 3, None, [1]])
def test_damaged_sizes_of_a_compact_object_are_told(tmp_path: Path, sizes: Any) -> None:
    path = tmp_path / "a.spz"
    save_trained(path, some(3, 3, 0), META)
    good = json.loads(sidecar_path(path).read_text())
    sidecar_path(path).write_text(json.dumps({**good, "sizes": sizes}))
    assert "sizes" in refusal(lambda: load_trained(path))


def test_an_object_has_one_form_and_no_other_file_is_taken_for_it(tmp_path: Path) -> None:
    ply, spz = tmp_path / "a.ply", tmp_path / "a.spz"
    save_trained(ply, some(3, 3, 0), META)
    spz.write_bytes(b"NGSP of somebody else")  # for instance the capture
    assert is_trained(ply) and not is_trained(spz) and find_trained(tmp_path, "a") == ply
    save_trained(ply, some(3, 3, 0, seed=1), META)
    assert spz.exists()
    save_trained(spz, some(3, 3, 0), META)
    assert is_trained(spz) and not ply.exists() and find_trained(tmp_path, "a") == spz
    data = bytearray(spz.read_bytes())
    data[-1] ^= 1
    spz.write_bytes(data)
    assert "belongs to another file" in refusal(lambda: load_trained(spz))
    save_trained(ply, some(3, 3, 0), META)
    assert spz.exists() and find_trained(tmp_path, "a") == ply and find_trained(tmp_path, "b") is None
