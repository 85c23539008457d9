"""3DGS .ply files: every dialect is read, every broken one refused in one line, INRIA's layout written."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine.errors import InputError
from engine.io.ply_header import read_header
from engine.io.splats.ply import read_ply, write_ply
from engine.scene.gaussians import Gaussians
from tests.helpers.refusal import refusal
from tests.paths import SHARED

DATA = SHARED

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
NAMES += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
# One row as stored in the file: opacity sigmoid(0) = 1/2, scales e^0, e^-1, e^-2, a quaternion of length 2.
ROW = [1.0, 2.0, 3.0, 0.25, -0.5, 0.75, 0.0, 0.0, -1.0, -2.0, 0.0, 0.0, 2.0, 0.0]


def header(
    names: list[str], count: int, kind: str = "binary_little_endian", before: str = "", type: str = "float"
) -> bytes:
    properties = "".join(f"property {type} {name}\n" for name in names)
    return f"ply\nformat {kind} 1.0\n{before}element vertex {count}\n{properties}end_header\n".encode()


def little(*rows: list[float], names: list[str] = NAMES) -> bytes:
    """A binary little-endian file of these rows, made without the code under test."""
    return header(names, len(rows)) + b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows)


def changed(**values: float) -> list[float]:
    return [values.get(name, value) for name, value in zip(NAMES, ROW, strict=True)]


def some(n: int, degree: int, seed: int = 0) -> Gaussians:
    r = np.random.default_rng(seed)
    quats = r.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    arrays = (
        r.normal(size=(n, 3)),
        np.exp(r.uniform(-12, 3, (n, 3))),
        quats,
        r.uniform(0.001, 0.999, n),
        r.normal(size=(n, (degree + 1) ** 2, 3)),
    )
    return Gaussians(*(a.astype(np.float32) for a in arrays))


def assert_row(g: Gaussians) -> None:
    """Asserts that a Gaussian is the one that ROW stands for."""
    np.testing.assert_array_equal(g.means, [[1, 2, 3]])
    np.testing.assert_allclose(g.scales, np.exp([[0, -1, -2]]), rtol=1e-6)
    np.testing.assert_array_equal(g.quats, [[0, 0, 1, 0]])
    np.testing.assert_array_equal(g.opacities, [0.5])
    np.testing.assert_array_equal(g.sh, [[[0.25, -0.5, 0.75]]])
    assert all(a.dtype == np.float32 for a in vars(g).values() if isinstance(a, np.ndarray))


@pytest.mark.parametrize("type", ["float", "double"])
@pytest.mark.parametrize(
    ("kind", "newline"),
    [
        ("ascii", "\n"),
        ("ascii", "\r\n"),
        ("binary_little_endian", "\n"),
        ("binary_little_endian", "\r\n"),
        ("binary_big_endian", "\n"),
        ("binary_big_endian", "\r"),
    ],
)
def test_reads_every_dialect(tmp_path: Path, kind: str, type: str, newline: str) -> None:
    """Extra properties, extra elements around the vertices, any order, comments that are not ASCII."""
    lines = ["ply", f"format {kind} 1.0", "comment caf\xe9 end_header", "obj_info x"]
    lines += ["element camera 2", "property uchar a", "property short b", "element vertex 1"]
    lines += [f"property {type} {name}" for name in ["label", *reversed(NAMES), "nx"]]
    lines += ["element extra 1", "property list uchar int i", "end_header", ""]
    top = newline.join(lines).encode("latin-1")
    row = [7.0, *reversed(ROW), 1.0]
    if kind == "ascii":
        body = newline.join(["1 2", "", "3 4", " ".join(map(str, row)), "1 5", ""]).encode()
    else:
        order = "<" if "little" in kind else ">"
        code = "d" if type == "double" else "f"
        body = struct.pack(f"{order}BhBh{len(row)}{code}Bi", 1, 2, 3, 4, *row, 1, 5)
    (tmp_path / "a.ply").write_bytes(top + body)
    gaussians, warnings = read_ply(tmp_path / "a.ply")
    assert warnings == []
    assert_row(gaussians)


def test_reads_vertices_behind_lists(tmp_path: Path) -> None:
    before = "element strip 2\nproperty list uchar int i\n"
    body = struct.pack("<BiiBi", 2, 5, 6, 1, 7) + struct.pack("<14f", *ROW)
    (tmp_path / "a.ply").write_bytes(header(NAMES, 1, before=before) + body)
    assert_row(read_ply(tmp_path / "a.ply")[0])


@pytest.mark.parametrize("most", [None, 1])
def test_discs_without_a_third_scale_are_thin_gaussians(tmp_path: Path, most: int | None) -> None:
    names = [name for name in NAMES if name != "scale_2"]
    (tmp_path / "a.ply").write_bytes(little([v for n, v in zip(NAMES, ROW, strict=True) if n in names], names=names))
    gaussians, _ = read_ply(tmp_path / "a.ply", most)
    np.testing.assert_allclose(gaussians.scales, [[1, np.exp(-1), 0.01 * np.exp(-1)]], rtol=1e-6)
    np.testing.assert_array_equal(gaussians.quats, [[0, 0, 1, 0]])
    (tmp_path / "b.ply").write_bytes(little(ROW[:9] + ROW[10:13], names=[n for n in names if n != "rot_3"]))
    assert "no 'scale_2'" in refusal(lambda: read_ply(tmp_path / "b.ply"))


@pytest.mark.parametrize("width", [0.0, 0.01, 0.5, 30.0])
def test_the_filter_of_mip_splatting_is_applied(tmp_path: Path, width: float) -> None:
    """A Gaussian convolved with one of this width has the sum of both covariances, and as much of it is there."""
    (tmp_path / "a.ply").write_bytes(little([*ROW, width], names=[*NAMES, "filter_3D"]))
    found, _ = read_ply(tmp_path / "a.ply")
    scales = np.exp([0.0, -1, -2])
    np.testing.assert_allclose(found.scales[0] ** 2, scales**2 + width**2, rtol=1e-5)
    np.testing.assert_allclose(found.opacities[0] * found.scales[0].prod(), 0.5 * scales.prod(), rtol=1e-5)


@settings(max_examples=25, deadline=None)
@given(n=st.integers(1, 40), degree=st.integers(0, 3), seed=st.integers(0, 2**32))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, n: int, degree: int, seed: int) -> None:
    path = tmp_path_factory.mktemp("round") / "a.ply"
    g = some(n, degree, seed)
    write_ply(path, g, ["made by\na test \xe9"])
    h, warnings = read_ply(path)
    assert warnings == []
    np.testing.assert_array_equal(h.means, g.means)
    np.testing.assert_array_equal(h.sh, g.sh)
    np.testing.assert_allclose(h.scales, g.scales, rtol=1e-6)
    np.testing.assert_allclose(h.quats, g.quats, atol=2e-7)
    np.testing.assert_allclose(h.opacities, g.opacities, atol=2e-7)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_written_bytes(tmp_path: Path, degree: int) -> None:
    """Against INRIA's layout, spelled out: order of names, f_rest channel-major, logits and logs."""
    g = some(3, degree)
    write_ply(tmp_path / "a.ply", g, ["one"])
    top, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    k = (degree + 1) ** 2 - 1
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(3 * k))]
    names += NAMES[6:]
    lines = ["ply", "format binary_little_endian 1.0", "comment one", "element vertex 3"]
    assert top.decode().splitlines() == lines + [f"property float {name}" for name in names]
    assert len(body) == 3 * 4 * len(names)
    row = dict(zip(names, struct.unpack_from(f"<{len(names)}f", body, 4 * len(names)), strict=True))
    assert [row["x"], row["y"], row["z"]] == g.means[1].tolist()
    assert [row[f"f_dc_{c}"] for c in range(3)] == g.sh[1, 0].tolist()
    for c in range(3):
        for i in range(k):
            assert row[f"f_rest_{c * k + i}"] == g.sh[1, 1 + i, c]
    p = float(g.opacities[1])
    assert row["opacity"] == pytest.approx(np.log(p / (1 - p)), abs=1e-5)
    assert row["scale_2"] == pytest.approx(np.log(g.scales[1, 2]), rel=1e-6)
    assert [row[f"rot_{i}"] for i in range(4)] == g.quats[1].tolist()
    assert [row[name] for name in ("nx", "ny", "nz")] == [0, 0, 0]


def test_opacity_zero_and_one_have_finite_logits(tmp_path: Path) -> None:
    g = some(2, 0)
    g.opacities[:] = [0, 1]
    write_ply(tmp_path / "a.ply", g)
    body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)[1]
    assert np.isfinite(np.frombuffer(body, "<f4")).all()
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply")[0].opacities, [0, 1], atol=1e-7)


def test_extreme_logits(tmp_path: Path) -> None:
    """The warnings filter of this suite turns any overflow into an error."""
    logits = [-3e38, -1e3, -89, 0, 89, 1e3, 3e38, float("inf"), -float("inf")]
    (tmp_path / "a.ply").write_bytes(little(*(changed(opacity=v) for v in logits)))
    gaussians, warnings = read_ply(tmp_path / "a.ply")
    assert warnings == []
    np.testing.assert_allclose(gaussians.opacities, [0, 0, 0, 0.5, 1, 1, 1, 1, 0], atol=1e-6)


BAD_ROWS = {
    "NaN or Inf": [
        {"y": np.nan},
        {"z": np.inf},
        {"scale_1": -np.inf},
        {"rot_0": np.nan},
        {"f_dc_2": np.inf},
        {"opacity": np.nan},
    ],
    "zero quaternions": [{"rot_2": 0.0}],
    "absurd sizes": [{"scale_0": 40.0}, {"scale_2": -40.0}],
    "absurd positions": [{"x": 1e30}],
    "absurd colours": [{"f_dc_0": -1e20}],
}


def test_bad_rows_are_dropped_and_counted(tmp_path: Path) -> None:
    bad = [changed(**values) for rows in BAD_ROWS.values() for values in rows]
    (tmp_path / "a.ply").write_bytes(little(*bad, *[ROW] * len(bad)))
    gaussians, warnings = read_ply(tmp_path / "a.ply")
    assert len(gaussians) == len(bad)
    assert_row(gaussians[:1])
    assert warnings == [
        f"{tmp_path / 'a.ply'}: {len(rows)} of {2 * len(bad)} Gaussians dropped: {reason}"
        for reason, rows in BAD_ROWS.items()
    ]


def test_rows_far_beyond_the_scene_are_dropped(tmp_path: Path) -> None:
    r = np.random.default_rng(0)
    scene = [changed(x=x, y=y, z=z, scale_0=-4.0) for x, y, z in r.normal(size=(200, 3))]
    (tmp_path / "a.ply").write_bytes(little(*scene, changed(x=1e6), changed(scale_0=14.0), changed(x=1e3)))
    gaussians, warnings = read_ply(tmp_path / "a.ply")
    assert len(gaussians) == 201  # a sky at a thousand widths stays
    assert [w.split(": ", 1)[1] for w in warnings] == [
        "1 of 203 Gaussians dropped: absurd sizes",
        "1 of 203 Gaussians dropped: absurd positions",
    ]


REST = [f"f_rest_{i}" for i in range(9)]
CLOUD = ["x", "y", "z", "red", "green", "blue"]
ASCII_ROW = b" ".join(b"%g" % v for v in ROW) + b"\n"
COMPRESSED = header(["packed_position", "packed_rotation", "packed_scale", "packed_color"], 1, type="uint") + b"\0" * 16
LISTED = header(NAMES, 1).replace(b"end_header", b"property list uchar int i\nend_header") + b"\0" * 57
MESH = header(["x", "y", "z"], 1).replace(b"end_header", b"element face 1\nproperty list uchar int i\nend_header")

BAD_FILES: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "empty"),
    "not a ply": (b"\x89PNG\r\n\x1a\n" + b"\0" * 50, "not a .ply file"),
    "plying": (b"plying\nformat ascii 1.0\n", "not a .ply file"),
    "point cloud": (header(CLOUD, 1) + b"\0" * 24, "no 'scale_0' property; this is a point cloud, not a 3DGS scene"),
    "mesh": (MESH + b"\0" * 13, "no 'scale_0' property; this is a mesh, not a 3DGS scene"),
    "no opacity": (
        header([n for n in NAMES if n != "opacity"], 1) + b"\0" * 52,
        "no 'opacity' property; this is an inc",
    ),
    "no vertices": (b"ply\nformat ascii 1.0\nend_header\n", "no 'vertex' element"),
    "compressed": (COMPRESSED, "not whole"),
    "zero": (header(NAMES, 0), "0 Gaussians"),
    "short by a byte": (little(ROW, ROW)[:-1], "promises 2 rows of 'vertex', the file has room for 1"),
    "no data": (header(NAMES, 5), "truncated"),
    "ascii, half a row": (header(NAMES, 2, "ascii") + ASCII_ROW + ASCII_ROW[:20] + b" " * 30, "truncated"),
    "ascii, a row less": (header(NAMES, 2, "ascii") + ASCII_ROW + b" " * 30, "promises 2 Gaussians, 1 are there"),
    "ascii, words": (header(NAMES, 1, "ascii") + ASCII_ROW.replace(b"0.25", b"oops"), "damaged"),
    "10^12 rows": (header(NAMES, 10**12) + b"\0" * 56, "1,000,000,000,000"),
    "10^12 ascii rows": (header(NAMES, 10**12, "ascii") + ASCII_ROW, "1,000,000,000,000"),
    "10^12 cameras": (header(NAMES, 1, before=f"element camera {10**12}\nproperty int i\n") + b"\0" * 99, "camera"),
    "10^12 lists": (header(NAMES, 1, before=f"element a {10**12}\nproperty list int int i\n") + b"\0" * 99, "'a'"),
    "negative list": (header(NAMES, 1, before="element a 1\nproperty list int int i\n") + b"\xff" * 99, "damaged"),
    "long list": (
        header(NAMES, 1, before="element a 1\nproperty list int int i\n") + b"\x7f" * 99,
        "promises 1 Gaussians, 0 are there",
    ),
    "10^30 rows": (header(NAMES, 10**30), "broken .ply header"),
    "negative": (header(NAMES, -1), "broken .ply header"),
    "list in vertex": (LISTED, "list"),
    "twice": (header([*NAMES, "x"], 1) + b"\0" * 60, "'x' appears twice"),
    "two vertex elements": (header(NAMES, 1, before="element vertex 1\nproperty int a\n") + b"\0" * 99, "two elements"),
    "odd f_rest": (header([*NAMES, *REST[:5]], 1) + b"\0" * 99, "5 'f_rest' properties"),
    "gap in f_rest": (header([*NAMES, *REST[:8], "f_rest_9"], 1) + b"\0" * 99, "9 'f_rest' properties"),
    "all rows bad": (little(changed(x=np.nan), changed(rot_2=0), changed(y=np.nan)), "none of the 3 Gaussians"),
    "no end": (header(NAMES, 1).replace(b"end_header\n", b""), "broken .ply header: it does not end"),
    "endless": (b"ply\ncomment " + b"x" * (2 << 20), "broken .ply header: it does not end"),
    "unknown type": (header(NAMES, 1, type="quad"), "broken .ply header"),
    "unknown format": (header(NAMES, 1, "binary_middle_endian"), "broken .ply header"),
    "no format": (b"ply\nelement vertex 1\nproperty float x\nend_header\n1\n", "broken .ply header"),
    "no name": (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty\nend_header\n1\n", "broken .ply header"),
    "not ascii": (header([*NAMES, "caf\xe9"], 1) + b"\0" * 60, "not ASCII"),
    "zeros": (b"ply\n" + b"\0" * 100, "broken .ply header"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files_get_one_line_and_no_memory(tmp_path: Path, case: str) -> None:
    content, expected = BAD_FILES[case]
    path = tmp_path / "orange.ply"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        assert expected in refusal(lambda: read_ply(path), f"{path}: ")
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


def test_what_is_no_file(tmp_path: Path) -> None:
    assert "no such file" in refusal(lambda: read_ply(tmp_path / "a.ply"), str(tmp_path / "a.ply"))
    assert "folder" in refusal(lambda: read_ply(tmp_path), str(tmp_path))
    assert "regular" in refusal(lambda: read_ply("/dev/zero"), "/dev/zero")
    assert "cannot be opened" in refusal(lambda: read_ply(tmp_path / ("x" * 300)), str(tmp_path / ("x" * 300)))


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damage_never_leaks_an_error(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Any bytes changed or cut off give a scene or one line, nothing else."""
    content = bytearray(little(ROW, changed(x=4.0)))
    for _ in range(data.draw(st.integers(0, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "fuzz.ply"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        gaussians, _ = read_ply(path)
    except InputError:
        refusal(lambda: read_ply(path), f"{path}: ")
        return
    assert all(np.isfinite(a).all() for a in vars(gaussians).values())


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    (tmp_path / "blocked").write_bytes(b"")
    refusal(lambda: write_ply(tmp_path / "blocked" / "a.ply", some(1, 0)), str(tmp_path / "blocked"))


@pytest.mark.skipif(not DATA.exists(), reason="the folder of real captures is absent")
@pytest.mark.parametrize(
    ("name", "count"),
    [("donut_mipsplatting", 45_624), ("tarot_box_capture", 114_865), ("meshgs_apple_30k", 30_000)],
)
def test_real_captures(name: str, count: int) -> None:
    path = DATA / f"splats/{name}.ply"
    gaussians, warnings = read_ply(path)
    assert (len(gaussians), gaussians.sh_degree, warnings) == (count, 0, [])
    body = path.read_bytes()[read_header(path).data :]
    first = struct.unpack_from("<17f", body)  # x y z, normal, f_dc, opacity, scale, rot
    np.testing.assert_array_equal(gaussians.means[0], np.array(first[:3], np.float32))
    np.testing.assert_allclose(gaussians.opacities[0], 1 / (1 + np.exp(-first[9])), rtol=1e-6)
    np.testing.assert_allclose(gaussians.scales[0], np.exp(first[10:13]), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(gaussians.quats, axis=1), 1, atol=1e-6)


@pytest.mark.skipif(not DATA.exists(), reason="the folder of real captures is absent")
def test_a_real_mesh_is_no_scene() -> None:
    mesh = DATA / "meshes/trimesh_bunny.ply"
    assert "mesh" in refusal(lambda: read_ply(mesh), str(mesh))
