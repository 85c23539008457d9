"""Files written for other programs, read back by readers of other origin, and by ours."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.io.load import load
from engine.io.writers.provenance import Provenance
from engine.io.writers.solid_gaussians import ATOM_OPACITY
from engine.io.writers.splats import SPLAT_WRITERS, write_splats
from engine.io.writers.usd import write_stage
from engine.scene.gaussians import Gaussians
from engine.scene.moved import moved, upright
from tests.engine.io.test_splat_formats import N, scene
from tests.engine.io.test_splat_gltf import NAME, arrays, covariances

UP = (0.0, -1.0, 0.0)
"""Up axis of captures from photographs."""


def solid(degree: int = 2) -> Gaussians:
    """Opaque Gaussians; the second half has no spherical harmonics above degree 0, like an inside."""
    g = scene(degree)
    sh = g.sh.copy()
    sh[N // 2 :, 1:] = 0
    return replace(g, opacities=np.full(N, ATOM_OPACITY, np.float32), sh=sh)


def written(path: Path, g: Gaussians, up: tuple[float, float, float] = UP) -> Path:
    write_splats(path, g, Provenance(up, ("made from apple.splat",)))
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    return path


@pytest.mark.parametrize(
    ("suffix", "place", "size", "colour", "rest"),
    [
        (".ply", 0, 1e-6, 0, 0),
        (".spz", 3e-4, 1 / 31, 0.014, 1 / 250),  # steps of 6 % in sizes, of 1 / 255 / 0.15 in colours
        (".sog", 2e-4, 0.02, 0.01, 0.01),  # positions as 16-bit logarithms, the rest from codebooks of 256
        (".glb", 0, 1e-6, 0, 1e-6),
    ],
)
def test_each_file_is_the_object_to_its_steps(
    suffix: str, place: float, size: float, colour: float, rest: float, tmp_path: Path
) -> None:
    true = solid()
    found = load(written(tmp_path / f"a{suffix}", true)).gaussians
    if suffix == ".glb":
        true = moved(true, upright(UP))  # y is up
    rows = cKDTree(found.means).query(true.means)[1]
    found = found[rows]
    assert len(np.unique(rows)) == N
    np.testing.assert_allclose(found.means, true.means, atol=place)
    np.testing.assert_allclose(np.log(found.scales / true.scales), 0, atol=size)
    assert np.abs((found.quats * true.quats).sum(1)).min() > 1 - 1e-4
    np.testing.assert_allclose(found.sh[:, 0], true.sh[:, 0], atol=colour)
    np.testing.assert_allclose(found.sh[:, 1:], true.sh[:, 1:], atol=rest)
    assert not found.sh[N // 2 :, 1:].any() and found.opacities.min() > 0.995
    before = (tmp_path / f"a{suffix}").read_bytes()
    assert written(tmp_path / f"a{suffix}", solid()).read_bytes() == before  # bit for bit


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".sog"])
def test_gaussforge_reads_what_was_meant(suffix: str, tmp_path: Path) -> None:
    """It keeps the file's axes (right, up, back in an .spz) and logarithms of sizes."""
    gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")
    true = solid()
    content = written(tmp_path / f"a{suffix}", true).read_bytes()
    read = gaussforge.GaussForge().read(content, suffix[1:])["data"]
    assert read["numPoints"] == N and read["meta"]["shDegree"] == 2
    quats = true.quats
    if suffix == ".spz":
        # Flipping also flips the principal axes, where `moved` rotates them with the object: the same ellipsoid.
        true, quats = moved(true, np.diag([1.0, -1.0, -1.0])), quats * np.array([1, 1, -1, -1], np.float32)
    widths = {"positions": (3,), "scales": (3,), "rotations": (4,), "colors": (3,), "sh": (8, 3)}
    columns = {name: np.frombuffer(read[name], np.float32).reshape(N, *width) for name, width in widths.items()}
    near, rows = cKDTree(columns["positions"]).query(true.means)
    assert near.max() < 6e-4 and len(np.unique(rows)) == N
    np.testing.assert_allclose(columns["scales"][rows], np.log(true.scales), atol=1 / 31)
    turns = columns["rotations"][rows]
    assert np.abs((turns * quats).sum(1)).min() > 1 - 1e-4
    np.testing.assert_allclose(columns["colors"][rows], true.sh[:, 0], atol=0.014)
    np.testing.assert_allclose(columns["sh"][rows], true.sh[:, 1:], atol=0.01)
    logits = np.frombuffer(read["alphas"], np.float32)
    assert logits.min() > 5 and np.isfinite(logits).all()


def test_pygltflib_reads_what_was_meant(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed")
    path = written(tmp_path / "a.glb", solid())
    tree = pygltflib.GLTF2().load(str(path))
    (primitive,) = tree.meshes[0].primitives
    assert tree.extensionsUsed == [NAME] and primitive.mode == 0 and tree.scenes[tree.scene].nodes == [0]
    assert primitive.extensions[NAME]["colorSpace"] == "srgb_rec709_display"
    for name, true in arrays(moved(solid(), upright(UP))).items():
        accessor = tree.accessors[getattr(primitive.attributes, name)]
        view = tree.bufferViews[accessor.bufferView]
        data = tree.binary_blob()[view.byteOffset :][: view.byteLength]
        assert (accessor.componentType, accessor.count) == (5126, N)
        np.testing.assert_allclose(np.frombuffer(data, np.float32).reshape(true.shape), true, atol=1e-6)
    place = tree.accessors[primitive.attributes.POSITION]
    np.testing.assert_allclose(
        [place.min, place.max], [f(moved(solid(), upright(UP)).means, 0) for f in (np.min, np.max)]
    )


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_reads_what_was_meant(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    from pxr import Usd, UsdGeom, UsdVol

    stage = Usd.Stage.Open(str(written(tmp_path / f"a{suffix}", solid())))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    prim = stage.GetDefaultPrim()
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat)
    true = moved(solid(), upright(UP))

    def value(name: str) -> np.ndarray:
        return np.array(prim.GetAttribute(name).Get())

    np.testing.assert_allclose(value("positions"), true.means, atol=1e-6)
    np.testing.assert_allclose(value("scales"), true.scales, rtol=1e-5)
    np.testing.assert_allclose(value("opacities"), true.opacities, atol=1e-6)
    turns = [(q.GetReal(), *q.GetImaginary()) for q in prim.GetAttribute("orientations").Get()]
    np.testing.assert_allclose(turns, true.quats, atol=1e-6)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 2
    coefficients = value("radiance:sphericalHarmonicsCoefficients").reshape(N, 9, 3)
    np.testing.assert_allclose(coefficients, true.sh, atol=1e-6)
    low, high = value("extent")
    assert (low <= true.means.min(0)).all() and (high >= true.means.max(0)).all()


@pytest.mark.parametrize("up", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (1, 0, 0), (0.6, 0, -0.8), (0, -1 + 1e-7, 1e-4)])
def test_formats_with_fixed_axes_have_the_object_upright(up: tuple[float, float, float]) -> None:
    turn = upright(up)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) > 0.999
    np.testing.assert_allclose(turn @ up, (0, 1, 0), atol=2e-4)


def test_a_moved_object_has_its_shape() -> None:
    true, turn = scene(1), upright((0.6, 0, -0.8))
    result = moved(true, turn, (1, 2, 3), 0.5)
    np.testing.assert_allclose(covariances(result), 0.25 * turn @ covariances(true) @ turn.T, rtol=1e-3, atol=1e-7)


def test_a_palette_takes_more_than_it_has_entries_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 15 of 16 entries for 300 sets of coefficients, each Gaussian gets one that is nearer than zero."""
    monkeypatch.setattr("engine.io.writers.sog.PALETTE_LEVELS", 4)
    true = solid(1)
    found = load(written(tmp_path / "a.sog", true)).gaussians
    found = found[cKDTree(found.means).query(true.means)[1]]
    kinds = np.unique(found.sh[:, 1:], axis=0)
    assert 8 < len(kinds) <= 16 and not found.sh[N // 2 :, 1:].any()
    left = ((found.sh - true.sh)[: N // 2, 1:] ** 2).mean() / (true.sh[: N // 2, 1:] ** 2).mean()
    assert left < 0.75  # 15 entries for 300 evenly spread ones in nine dimensions


def test_what_cannot_be_written_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    g = solid()
    with pytest.raises(InputError, match=r"Gaussians are saved as .ply, .spz, .sog, .glb, .usda, .usdc"):
        write_splats(tmp_path / "a.obj", g, Provenance())
    with pytest.raises(InputError, match="nothing to save"):
        write_splats(tmp_path / "a.spz", g[:0], Provenance())
    with pytest.raises(InputError, match=r"details of .* units; an .spz holds"):
        write_splats(tmp_path / "a.spz", moved(g, np.eye(3), factor=1e-6), Provenance())
    with pytest.raises(InputError, match=r"places as far as 9.66e\+06 units; an .spz holds 8,388,607"):
        write_splats(tmp_path / "a.spz", moved(g, np.eye(3), (9_660_000, 0, 0), 120.0), Provenance())

    def fail(_: str) -> bool:
        raise RuntimeError("no space\nleft")

    stage = SimpleNamespace(GetRootLayer=lambda: SimpleNamespace(Export=fail))
    with pytest.raises(InputError, match="no space left"):
        write_stage(tmp_path / "a.usdc", stage)
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match="USD needs usd-core"):
        write_splats(tmp_path / "a.usdc", g, Provenance())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", SPLAT_WRITERS)
def test_one_atom_is_enough(suffix: str, tmp_path: Path) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr", reason="usd-core is not installed")
    written(tmp_path / f"a{suffix}", solid()[:1])
