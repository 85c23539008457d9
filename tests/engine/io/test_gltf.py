"""glTF files: those that cannot be opened are named for what they are; others are read with the files beside them."""

from __future__ import annotations

import base64
import io
import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from engine.io.load import load
from engine.io.meshes.mesh import read_mesh
from engine.scene.sh import sh_to_rgb
from tests.helpers.refusal import refusal
from tests.paths import SHARED

DATA = SHARED


def tree_of(**other: object) -> dict[str, object]:
    """A glTF of one triangle, its array in a.bin beside it."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": "a%20b.bin"}],
    } | other


def gltf(bin_name: str = "a b.bin", binary: bool = False, version: int = 2, **other: object) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        data = json.dumps(tree_of(**other)).encode()
        (folder / bin_name).write_bytes(np.array([0, 0, 0, 1, 0, 0, 0, 1, 0], "<f4").tobytes())
        path = folder / ("a.glb" if binary else "a.gltf")
        head = struct.pack("<4s4I", b"glTF", version, 20 + len(data), len(data), 0x4E4F534A) if binary else b""
        path.write_bytes(head + data)
        return path

    return make


def text(json_text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / "a.gltf").write_text(json_text)
        return folder / "a.gltf"

    return make


def primitive(**other: object) -> list[dict[str, object]]:
    return [{"primitives": [{"attributes": {"POSITION": 0}} | other]}]


@pytest.mark.parametrize("binary", [False, True])
def test_a_gltf_with_its_array_beside_it(tmp_path: Path, binary: bool) -> None:
    """The array's name has %20, as the format wants it; a required extension changes nothing here."""
    path = gltf(binary=binary, extensionsRequired=["KHR_materials_unlit"])(tmp_path)
    g = read_mesh(path, 50)
    assert g.means[:, :2].min() >= 0 and g.means[:, :2].sum(1).max() <= 1 + 1e-6


DRACO = "KHR_draco_mesh_compression"
PLACED = "KHR_texture_transform"


def painted(**texture: object) -> Callable[[Path], Path]:
    """A triangle with a texture."""
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | texture}}
    return gltf(meshes=primitive(material=0), materials=[material])


UNREAD = [{"componentType": 5126, "count": 3, "type": "VEC3"}]
GLTF: dict[str, tuple[Callable[[Path], Path], str]] = {
    "its array is missing": (gltf("b.bin"), "its file 'a%20b.bin' is missing; put it into the same folder"),
    "glTF 1.0": (gltf(asset={"version": "1.0"}, meshes={}), "this is glTF 1.0, which cannot be read"),
    "glb 1.0": (gltf(binary=True, version=1), "this is glTF 1.0, which cannot be read; export it as glTF 2.0 (.glb)"),
    "Draco": (gltf(extensionsRequired=[DRACO]), f"its mesh is compressed with Draco ({DRACO})"),
    "Draco, not said": (
        gltf(meshes=primitive(extensions={DRACO: {"bufferView": 0}}), accessors=UNREAD),
        "its mesh is compressed with Draco",
    ),
    "meshopt": (gltf(extensionsRequired=["EXT_meshopt_compression"]), "compressed with meshopt"),
    "meshopt, new": (gltf(extensionsRequired=["KHR_meshopt_compression"]), "cannot be read; export it without"),
    "quantized": (gltf(extensionsRequired=["KHR_mesh_quantization"]), "its mesh is quantized"),
    "unknown": (gltf(extensionsRequired=["A_b", "C_d"]), "it needs A_b, C_d, which cannot be read"),
    "a texture that is moved": (painted(extensions={PLACED: {"offset": [0.5, 0]}}), f"placed by {PLACED} or a second"),
    "a second set of places": (painted(texCoord=1), "a second set of coordinates"),
    "only lines": (gltf(meshes=primitive(mode=1)), "there is no face in it, only lines"),
    "points and lines": (gltf(meshes=primitive(mode=0) + primitive(mode=3)), "only lines and points"),
    "Gaussians": (
        gltf(meshes=primitive(mode=0, extensions={"KHR_gaussian_splatting": {}})),
        "no 'KHR_gaussian_splatting:ROTATION' of its Gaussians; export the capture again",
    ),
    "too many values": (gltf(accessors=[{"bufferView": 0, "count": 10**12}]), "1,000,000,000,000 values in its arrays"),
    "values that are not there": (gltf(accessors=[UNREAD[0] | {"count": 10**8}]), "100,000,000 values that it names"),
    "one part very often": (
        gltf(nodes=[{"children": list(range(1, 101))}, *[{"mesh": 0}] * 100]),
        "100 faces; the most is 99",
    ),
    "in a circle": (gltf(nodes=[{"children": [1]}, {"children": [0], "mesh": 0}]), "damaged"),
    "other types": (gltf(asset=[], meshes=[3], accessors={}, extensionsRequired=7), ""),
    "a list": (text("[]"), "damaged"),
    "nested": (text("[" * 100_000), "damaged"),
}


@pytest.mark.parametrize("case", GLTF)
def test_a_gltf_that_cannot_be_opened_is_told_what_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.setattr("engine.io.meshes.mesh.MAX_FACES", 99)
    make, expected = GLTF[case]
    path = make(tmp_path)
    assert expected in refusal(lambda: load(path), f"{path}: ")


def test_gaussians_beside_a_mesh_are_left_out(tmp_path: Path) -> None:
    both = primitive() + primitive(mode=0, extensions={"KHR_gaussian_splatting": {}})
    loaded = load(gltf(meshes=both)(tmp_path))
    assert any("the Gaussians in it (KHR_gaussian_splatting) are left out" in line for line in loaded.warnings)


SRGB_OF_HALF = 0.7354
"""sRGB of linear light 0.5 (IEC 61966-2-1)."""

LIT = [[0.5, 0, 0]] * 3


@pytest.mark.parametrize("texture", [False, True])
@pytest.mark.parametrize(
    ("vertices", "factor", "shown"),
    [
        (LIT, None, (SRGB_OF_HALF, 0, 0)),
        ([[1, 0, 0]] * 3, [0.5, 0.5, 0.5, 1], (SRGB_OF_HALF, 0, 0)),
        (None, [0.5, 1, 0.5, 1], (SRGB_OF_HALF, 1, SRGB_OF_HALF)),
        (None, None, (1, 1, 1)),
    ],
)
def test_colours_of_a_gltf_are_linear_and_multiply(
    tmp_path: Path,
    vertices: list[list[float]] | None,
    factor: list[float] | None,
    shown: tuple[float, float, float],
    texture: bool,
) -> None:
    arrays = [np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4"), np.zeros((3, 2), "<f4")]
    attributes = {"POSITION": 0} | ({"TEXCOORD_0": 1} if texture else {}) | ({"COLOR_0": 2} if vertices else {})
    look: dict[str, object] = {} if factor is None else {"baseColorFactor": factor}
    other: dict[str, object] = {"materials": [{"pbrMetallicRoughness": look}]}
    if texture:
        white = io.BytesIO()
        Image.new("RGB", (2, 2), "white").save(white, "PNG")
        look["baseColorTexture"] = {"index": 0}
        uri = "data:image/png;base64," + base64.b64encode(white.getvalue()).decode()
        other |= {"textures": [{"source": 0}], "images": [{"uri": uri}]}
    if vertices:
        arrays.append(np.array(vertices, "<f4"))
    data = b"".join(array.tobytes() for array in arrays)
    starts = np.cumsum([0, *(array.nbytes for array in arrays)]).tolist()
    path = tmp_path / "a.gltf"
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": a.nbytes} for start, a in zip(starts, arrays, strict=False)
    ]
    accessors = [
        {"bufferView": n, "componentType": 5126, "count": 3, "type": f"VEC{a.shape[1]}"} for n, a in enumerate(arrays)
    ]
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    tree = tree_of(
        meshes=[{"primitives": [{"attributes": attributes, "material": 0}]}],
        accessors=accessors,
        bufferViews=views,
        buffers=[{"byteLength": len(data), "uri": uri}],
        **other,
    )
    path.write_text(json.dumps(tree))
    assert np.allclose(sh_to_rgb(load(path).gaussians.sh[:, 0]), shown, atol=0.003)


def test_a_mesh_in_sparse_arrays_is_refused(tmp_path: Path) -> None:
    sparse = {"count": 1, "indices": {"bufferView": 0, "componentType": 5123}, "values": {"bufferView": 0}}
    array = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}
    path = gltf(accessors=[array])(tmp_path)
    assert "sparse arrays" in refusal(lambda: load(path))
