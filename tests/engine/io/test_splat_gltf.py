"""Captures in glTF: encoded here array by array, and the conformance file of the extension."""

from __future__ import annotations

import base64
import json
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from engine.errors import InputError
from engine.io.load import load, load_sample
from engine.scene.gaussians import Gaussians
from engine.scene.rotations import rotation_matrices
from engine.scene.sh import colours
from tests.engine.io.test_splat_formats import FORMATS, N, scene

NAME = "KHR_gaussian_splatting"
FLOAT, BYTE, UNSIGNED_SHORT = 5126, 5120, 5123


def arrays(g: Gaussians) -> dict[str, np.ndarray]:
    """The attributes of the format, as floats."""
    found = {
        "POSITION": g.means,
        f"{NAME}:ROTATION": g.quats[:, [1, 2, 3, 0]],
        f"{NAME}:SCALE": g.scales,
        f"{NAME}:OPACITY": g.opacities[:, None],
    }
    for degree in range(g.sh_degree + 1):
        for k in range(2 * degree + 1):
            found[f"{NAME}:SH_DEGREE_{degree}_COEF_{k}"] = g.sh[:, degree * degree + k]
    return {name: np.ascontiguousarray(values, np.float32) for name, values in found.items()}


def tree(attributes: dict[str, np.ndarray], changes: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """The JSON and the bytes of one primitive; integer arrays are normalised, all are interleaved in pairs."""
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    data = b""
    for values in attributes.values():
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[values.shape[1]]
        component = {"f": FLOAT, "i": BYTE, "u": UNSIGNED_SHORT}[values.dtype.kind]
        pad = 12  # unrelated bytes before each row
        rows = np.zeros((len(values), pad + values.shape[1] * values.itemsize), np.uint8)
        rows[:, pad:] = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), -1)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": rows.size, "byteStride": rows.shape[1]})
        accessors.append(
            {
                "bufferView": len(accessors),
                "byteOffset": pad,
                "componentType": component,
                "count": len(values),
                "type": kind,
                "normalized": values.dtype.kind != "f",
            }
        )
        data += rows.tobytes()
    look = {"kernel": "ellipse", "colorSpace": changes.pop("space", "srgb_rec709_display")}
    primitive = {"attributes": {n: k for k, n in enumerate(attributes)}, "mode": 0, "extensions": {NAME: look}}
    result = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [NAME],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    } | changes
    return result, data


def glb(attributes: dict[str, np.ndarray], **changes: Any) -> bytes:
    return packed(*tree(attributes, changes))


def packed(content: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(data)
    return (
        b"glTF"
        + struct.pack("<4I", 2, size, len(text), 0x4E4F534A)
        + text
        + struct.pack("<2I", len(data), 0x4E4942)
        + data
    )


def opened(tmp_path: Path, content: bytes, name: str = "a.glb") -> Gaussians:
    (tmp_path / name).write_bytes(content)
    return load(tmp_path / name).gaussians


def covariances(g: Gaussians) -> np.ndarray:
    axes = rotation_matrices(g.quats.astype(np.float64)) * g.scales[:, None, :].astype(np.float64)
    return axes @ axes.transpose(0, 2, 1)


def test_floats_are_read_as_they_are(tmp_path: Path) -> None:
    true = scene(3)
    found = opened(tmp_path, glb(arrays(true)))
    np.testing.assert_array_equal(found.means, true.means)
    np.testing.assert_array_equal(found.sh, true.sh)
    np.testing.assert_allclose(found.scales, true.scales, rtol=1e-6)
    np.testing.assert_allclose(found.quats, true.quats, atol=1e-6)
    np.testing.assert_allclose(found.opacities, true.opacities, atol=1e-6)
    sample = load_sample(tmp_path / "a.glb", 100)
    assert sample is not None and sample.gaussians.sh.shape == (100, 1, 3)
    np.testing.assert_array_equal(sample.gaussians.means, true.means[::6])


def test_its_json_may_hold_the_arrays(tmp_path: Path) -> None:
    true = scene()
    content, data = tree(arrays(true), {})
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    for name, buffer in (("a.gltf", uri), ("b.gltf", "b.bin")):
        (tmp_path / "b.bin").write_bytes(data)
        text = json.dumps(content | {"buffers": [{"byteLength": len(data), "uri": buffer}]})
        np.testing.assert_array_equal(opened(tmp_path, text.encode(), name).means, true.means)


def test_integers_are_read_to_their_steps(tmp_path: Path) -> None:
    true = scene()
    rough = arrays(true)
    rough[f"{NAME}:ROTATION"] = np.rint(127 * rough[f"{NAME}:ROTATION"]).astype(np.int8)
    rough[f"{NAME}:SCALE"] = np.rint(65535 * rough[f"{NAME}:SCALE"]).astype(np.uint16)
    rough[f"{NAME}:OPACITY"] = np.rint(65535 * rough[f"{NAME}:OPACITY"]).astype(np.uint16)
    found = opened(tmp_path, glb(rough))
    assert np.abs((found.quats * true.quats).sum(1)).min() > 1 - 1e-4
    np.testing.assert_allclose(found.scales, true.scales, atol=1 / 65535)
    np.testing.assert_allclose(found.opacities, true.opacities, atol=1 / 65535)


@pytest.mark.parametrize("nan", [0x7FC00000, 0x7FA00000], ids=["quiet", "signalling"])
def test_a_size_that_is_no_number_is_left_out(tmp_path: Path, nan: int) -> None:
    damaged = arrays(scene())
    damaged[f"{NAME}:SCALE"].view(np.uint32)[3, 0] = nan
    assert len(opened(tmp_path, glb(damaged))) == N - 1


def test_one_size_below_zero_is_damage(tmp_path: Path) -> None:
    true = scene()
    damaged = arrays(true)
    damaged[f"{NAME}:SCALE"][3, 0] = -1e-6
    found = opened(tmp_path, glb(damaged))
    assert len(found) == N - 1
    np.testing.assert_allclose(found.scales, np.delete(true.scales, 3, 0), rtol=1e-5)


def test_drafts_had_logarithms_of_sizes(tmp_path: Path) -> None:
    true = scene()
    old = arrays(true) | {f"{NAME}:SCALE": np.log(true.scales)}
    found = opened(tmp_path, glb(old))
    np.testing.assert_allclose(found.scales, true.scales, rtol=1e-5)
    assert "read as logarithms" in load(tmp_path / "a.glb").warnings[0]


def test_nodes_move_turn_and_scale_what_is_seen(tmp_path: Path) -> None:
    """The Gaussians, and their colours from any side, follow the matrices of two nested nodes."""
    true = scene(3)
    first, second = Rotation.from_euler("xyz", (20, 130, -50), degrees=True), Rotation.from_rotvec((0.3, 1.1, -0.7))
    outer = np.eye(4)
    outer[:3, :3], outer[:3, 3] = 2.5 * first.as_matrix(), (1, -2, 3)
    inner = {"rotation": second.as_quat().tolist(), "scale": [0.5] * 3, "translation": [0.1, 0.2, 0.3], "mesh": 0}
    nodes = [{"matrix": outer.T.ravel().tolist(), "children": [1]}, inner, {"mesh": 0}]
    found = opened(tmp_path, glb(arrays(true), nodes=nodes))
    assert len(found) == N  # the third node is not in the scene
    turn = first.as_matrix() @ second.as_matrix()
    places = 2.5 * (0.5 * true.means @ second.as_matrix().T + (0.1, 0.2, 0.3)) @ first.as_matrix().T + (1, -2, 3)
    np.testing.assert_allclose(found.means, places, atol=1e-5)
    np.testing.assert_allclose(covariances(found), 1.25**2 * turn @ covariances(true) @ turn.T, rtol=1e-3, atol=1e-6)
    directions = np.random.default_rng(1).normal(size=(N, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = colours(true.sh, directions), colours(found.sh, directions @ turn.T)
    np.testing.assert_allclose(after, before, atol=2e-5)


def test_linear_colours_become_srgb(tmp_path: Path) -> None:
    true = scene()
    linear = np.clip(0.5 + 0.28209479177387814 * true.sh[:, 0], 0, None)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    found = opened(tmp_path, glb(arrays(true), space="lin_rec709_display"))
    np.testing.assert_allclose(colours(found.sh, np.tile([0, 0, 1.0], (N, 1))), shown, atol=1e-5)
    assert "turned into sRGB" in load(tmp_path / "a.glb").warnings[0]


@pytest.mark.skipif(not FORMATS.exists(), reason="the folder of other programs' files is absent")
def test_the_conformance_file() -> None:
    """One Gaussian for each number type and each degree, from a draft: sizes are logarithms."""
    loaded = load(FORMATS / "khr_conformance_matrix.glb")
    g = loaded.gaussians
    assert len(g) == 15 and g.sh_degree == 3 and len(loaded.warnings) == 2
    np.testing.assert_array_equal(g.means, np.tile([1, 2, 3], (15, 1)).astype(np.float32))
    np.testing.assert_allclose(g.quats, np.tile([0, 1, 0, 0], (15, 1)), atol=1e-6)
    sizes = {0: (0, 0.5, -0.5), 3: (0.2, -0.1, 0.7), 4: (1, -2, 3), 5: (1, 0, -1), 6: (2, -3, 4), 7: (1, 0, -1)}
    for row, logs in sizes.items():
        np.testing.assert_allclose(np.log(g.scales[row]), logs, atol=1e-5)
    np.testing.assert_allclose(g.opacities[8:11], (0.75, 64 / 255, 16384 / 65535), atol=1e-5)
    assert [bool(g.sh[row, 4:9].any()) for row in (11, 12, 13, 14)] == [False, False, True, True]


WHOLE = arrays(scene(1))
CONTENT, DATA = tree(WHOLE, {})
STRETCHED = [{"mesh": 0, "scale": [1, 1, 2], "name": "fruit"}]


def changed(part: str, **values: Any) -> dict[str, Any]:
    """The first element of a list with some values replaced."""
    first, *others = CONTENT[part]
    return {part: [first | values, *others]}


def without(name: str) -> dict[str, np.ndarray]:
    return {key: values for key, values in WHOLE.items() if not key.endswith(name)}


BROKEN: dict[str, tuple[bytes, str]] = {
    "stretched": (glb(WHOLE, nodes=STRETCHED), "its node 'fruit' mirrors or stretches its Gaussians"),
    "mirrored": (glb(WHOLE, nodes=[{"mesh": 0, "scale": [-1, 1, 1]}]), "mirrors or stretches"),
    "flat": (glb(WHOLE, nodes=[{"mesh": 0, "scale": [0, 0, 0]}]), "mirrors or stretches"),
    "no number": (glb(WHOLE, nodes=[{"mesh": 0, "matrix": [float("nan")] * 16}]), "mirrors or stretches"),
    "huge": (glb(WHOLE, nodes=[{"mesh": 0, "scale": [10**400] * 3}]), "no transform that makes sense"),
    "a short matrix": (glb(WHOLE, nodes=[{"mesh": 0, "matrix": [1, 2]}]), "no transform that makes sense"),
    "a circle": (glb(WHOLE, nodes=[{"mesh": 0, "children": [0]}]), "its nodes are no tree"),
    "many times": (
        glb(WHOLE, nodes=[{"children": [1, 2, 3]}, *[{"mesh": 0}] * 3]),
        "1,800 Gaussians where its nodes place them; the most is 999",
    ),
    "no opacity": (glb(without("OPACITY")), f"no '{NAME}:OPACITY' of its Gaussians"),
    "half a degree": (glb(without("DEGREE_1_COEF_2")), f"no '{NAME}:SH_DEGREE_1_COEF_2' of its Gaussians"),
    "sparse": (glb(WHOLE, **changed("accessors", sparse={})), "sparse or empty arrays"),
    "promised": (glb(WHOLE, **changed("accessors", count=10**9)), "1,000,000,000 Gaussians are promised"),
    "fewer": (glb(WHOLE, **changed("accessors", count=5)), "its arrays are of different lengths"),
    "far": (glb(WHOLE, **changed("bufferViews", byteOffset=10**12)), "truncated or damaged"),
    "negative": (glb(WHOLE, **changed("bufferViews", byteStride=-4)), "cannot be found in it"),
    "other type": (glb(WHOLE, **changed("accessors", type="MAT4")), "cannot be found in it"),
    "nowhere": (glb(WHOLE, **changed("bufferViews", buffer=7)), "cannot be found in it"),
    "elsewhere": (glb(WHOLE, buffers=[{"uri": "../a.bin", "byteLength": 9}]), "names a file in another folder"),
    "absent": (glb(WHOLE, buffers=[{"uri": "a.bin", "byteLength": 9}]), "its file 'a.bin' is missing"),
    "truncated": (glb(WHOLE)[:-400], "truncated or damaged"),
    "packed": (glb(WHOLE, extensionsUsed=[NAME, NAME + "_compression_spz_2"]), "need KHR_gaussian_splatting_comp"),
    "meshopt": (glb(WHOLE, **changed("bufferViews", extensions={"EXT_meshopt_compression": {}})), "packed by EXT_mesh"),
    "no nodes shown": (glb(WHOLE, scenes=[{"nodes": []}]), "0 Gaussians"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_cannot_be_opened_is_told_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.setattr("engine.io.splats.gltf.MOST", 999)
    content, expected = BROKEN[case]
    path = tmp_path / "a.glb"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load(path)
    line = str(caught.value)
    assert expected in line and line.startswith(str(tmp_path)) and "\n" not in line and "Error" not in line


@pytest.mark.parametrize(
    "content",
    [b"\0", b"{}", struct.pack("<4s4I", b"glTF", 2, 2**31, 2**30, 0x4E4F534A)],
    ids=["byte", "json", "promise"],
)
def test_no_more_memory_is_set_aside_than_the_file_is_large(tmp_path: Path, content: bytes) -> None:
    """A gigabyte of JSON is allowed; where address space is limited, asking for all of it ended in a MemoryError."""
    (tmp_path / "a.glb").write_bytes(content)
    with pytest.raises(InputError):
        load(tmp_path / "a.glb")  # imports what it needs
    tracemalloc.start()
    try:
        with pytest.raises(InputError):
            load(tmp_path / "a.glb")
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_no_change_of_its_json_makes_more_than_a_refusal(tmp_path_factory: pytest.TempPathFactory, data: Any) -> None:
    content = json.loads(json.dumps(CONTENT))
    part = data.draw(st.sampled_from(sorted(content)))
    junk: st.SearchStrategy[Any] = st.sampled_from(
        [None, -1, 0, 3, 2**40, 10**400, 1.5, "x", [], [[]], {}, [0], {"mesh": 0}, True]
    )
    place: Any = content[part]
    while isinstance(place, (list, dict)) and place and data.draw(st.booleans()):
        keys = sorted(place) if isinstance(place, dict) else range(len(place))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(place[key], (list, dict)) or data.draw(st.booleans()):
            place[key] = data.draw(junk)
            break
        place = place[key]
    else:
        content[part] = data.draw(junk)
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    file = (
        b"glTF"
        + struct.pack("<4I", 2, 0, len(text), 0x4E4F534A)
        + text
        + struct.pack("<2I", len(DATA), 0x4E4942)
        + DATA
    )
    path = tmp_path_factory.mktemp("gltf") / "a.glb"
    path.write_bytes(file)
    try:
        g = load(path).gaussians
    except InputError:
        return
    assert all(np.isfinite(values).all() for values in (g.means, g.scales, g.quats, g.opacities, g.sh)) and len(g)
