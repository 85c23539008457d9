"""Pictures from files: a few formats are decoded, in one place; nothing runs or hangs, and errors are one line."""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import struct
import subprocess
import threading
import warnings
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import EpsImagePlugin, Image, UnidentifiedImageError

from engine.errors import InputError
from engine.io.meshes.mesh import read_mesh
from engine.io.picture_file import (
    KINDS,
    PICTURE_SUFFIXES,
    decoding,
    in_srgb,
    open_picture,
    read_pixels,
    restricted_decoders,
)
from tests.helpers.refusal import refusal
from tests.paths import HELPERS, ROOT, SHARED
from training.priors.exemplar.pictures import read_picture

POSTSCRIPT = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 64 64\n%%EndComments\n{ } loop\n%%EOF\n"


PHONE = HELPERS / "phone.heic"
"""Four quarters of one colour each, taken with the camera turned by a quarter."""


def encoded(kind: str, size: tuple[int, int] = (40, 30)) -> bytes:
    if kind == "HEIF":  # read, but not written
        return PHONE.read_bytes()
    target = io.BytesIO()
    y, x = np.mgrid[: size[1], : size[0]]
    rgb = np.stack([x * 5 % 256, y * 7 % 256, (x + y) % 256], axis=-1).astype(np.uint8)
    Image.fromarray(rgb).save(target, format=kind)
    return target.getvalue()


def test_pictures_are_opened_in_one_place() -> None:
    """No `Image.open` elsewhere, nor another library's."""
    found = []
    for folder in ("app", "benchmarks", "engine", "sample_scenes", "shaders", "tools", "training"):
        for path in (ROOT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Attribute):
                    opens = node.attr == "open" and ast.unparse(node.value).endswith("Image")
                    other = (
                        node.attr in ("imread", "imopen", "decode_image", "read_image") or "_from_asset" in node.attr
                    )
                    if opens or other:
                        found.append(f"{path.relative_to(ROOT)}: {ast.unparse(node)}")
                if isinstance(node, ast.ImportFrom) and node.module == "PIL.Image":
                    found.append(f"{path.relative_to(ROOT)}: {ast.unparse(node)}")
    assert found == ["engine/io/picture_file.py: Image.open"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_usual_kinds_are_read_whatever_the_name(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "picture.xyz"
    path.write_bytes(encoded(kind))
    assert read_pixels(path).shape == ((30, 40, 3) if kind != "HEIF" else (64, 48, 3))
    with open_picture(path.read_bytes(), "here") as image:
        assert image.format == kind


def test_a_phone_s_picture_is_upright(tmp_path: Path) -> None:
    rgb = read_pixels(PHONE).astype(int)
    corners = rgb[8, 8], rgb[8, -8], rgb[-8, 8], rgb[-8, -8]
    for colour, wanted in zip(corners, [(40, 180, 60), (220, 40, 40), (230, 220, 60), (40, 60, 200)], strict=True):
        np.testing.assert_allclose(colour, wanted, atol=8)
    half = tmp_path / "half.heic"
    half.write_bytes(PHONE.read_bytes()[:300])
    assert refusal(lambda: read_pixels(half)).startswith(f"{half}: this ")


def test_a_damaged_phone_s_picture_is_read_or_refused() -> None:
    """Its decoder is native code, where a fault would end the process; claimed sizes are bounded."""
    whole, rng = np.frombuffer(PHONE.read_bytes(), np.uint8), np.random.default_rng(0)
    for _ in range(300):
        data = whole[: rng.integers(12, len(whole) + 1)].copy() if rng.uniform() < 0.3 else whole.copy()
        data[rng.integers(12, max(len(data), 13), rng.integers(1, 6)) % len(data)] = rng.choice([0, 1, 127, 128, 255])
        with suppress(InputError), open_picture(data.tobytes(), "phone") as image:
            assert np.asarray(image.convert("RGB")).shape[2] == 3
    size = whole.tobytes().index(b"ispe") + 8  # the picture's size, big-endian
    for claimed in (0, 2**20, 2**31 - 1, 2**32 - 1):
        data = whole.copy()
        data[size : size + 8] = np.frombuffer(struct.pack(">II", claimed, claimed), np.uint8)
        with suppress(InputError), open_picture(data.tobytes(), "phone") as image:
            assert image.convert("RGB").width <= 64


def test_colours_are_those_of_the_profile() -> None:
    """A photograph in Adobe RGB (1998): curve and primaries of that standard, converted to those of sRGB."""
    path = SHARED / "photos/fruit/watermelon_v1.png"
    if not path.exists():
        pytest.skip("the photographs are not beside the repository")
    with open_picture(path) as image:
        pixels, shown = np.asarray(image.convert("RGB")), np.asarray(in_srgb(image))
    adobe = np.array([[0.57667, 0.18556, 0.18823], [0.29734, 0.62736, 0.07529], [0.02703, 0.07069, 0.99134]])
    srgb = np.array([[0.41239, 0.35758, 0.18048], [0.21264, 0.71517, 0.07219], [0.01933, 0.11919, 0.95053]])
    linear = np.clip((pixels / 255) ** 2.19921875 @ (np.linalg.inv(srgb) @ adobe).T, 0, 1)
    wanted = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(shown / 255 - wanted).max() < 2.5 / 255
    assert np.abs(shown / 255 - pixels / 255).mean() > 4 / 255


@pytest.mark.parametrize(
    ("mode", "kept"), [("RGB", "RGB"), ("RGBA", "RGBA"), ("L", "RGB"), ("LA", "RGBA"), ("P", "RGB")]
)
def test_a_profile_that_cannot_be_used_is_left_out(mode: str, kept: str) -> None:
    image = Image.fromarray(np.arange(48, dtype=np.uint8).reshape(4, 4, 3)).convert(mode)
    image.info["icc_profile"] = b"no profile"
    shown = in_srgb(image)
    assert shown.mode == kept
    np.testing.assert_array_equal(np.asarray(shown), np.asarray(image.convert(kept)))


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (POSTSCRIPT, "a PostScript file"),
        (b"\xc5\xd0\xd3\xc6" + b"\0" * 40 + POSTSCRIPT, "a PostScript file"),
        (b"%PDF-1.7\n", "a PDF document"),
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "a damaged HEIC picture"),
        (b'\n<svg xmlns="x"/>', "an SVG drawing"),
        (b"8BPS\0\1", "a Photoshop document"),
        (b"", "an empty file"),
        (b"hello", "no picture that can be read"),
        (encoded("PPM"), "no picture that can be read"),
        (encoded("ICO"), "no picture that can be read"),
        (encoded("JPEG2000"), "a JPEG 2000 picture"),
    ],
)
def test_what_is_no_such_picture_is_called_by_its_name(tmp_path: Path, data: bytes, what: str) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(data)
    line = f"{path}: this is {what}; give a PNG, JPEG, WEBP, BMP, GIF, TIFF, AVIF or HEIF picture"
    assert refusal(lambda: read_pixels(path)) == line
    assert refusal(lambda: read_picture(path, "horizontal")) == line


OBJ = "mtllib s.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
PLY = "ply\nformat ascii 1.0\ncomment TextureFile x.bin\nelement vertex 3\n"
PLY += "".join(f"property float {c}\n" for c in "xyzst") + "element face 1\nproperty list uchar int vertex_indices\n"
PLY += "end_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"


def gltf_with(folder: Path, picture: bytes, way: str) -> Path:
    """A textured triangle, its picture in a buffer view, in a data URI, or in a file that is also a buffer."""
    image = Image.fromarray(np.zeros((9, 9, 3), np.uint8))
    visual = trimesh.visual.TextureVisuals(uv=[[0, 0], [1, 0], [0, 1]], image=image)
    triangle = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], visual=visual, process=False)
    files: Any = triangle.export(file_type="gltf")
    (name,) = (name for name in files if name.endswith(".gltf"))
    tree = json.loads(files[name])
    for other, data in files.items():
        if other != name:
            (folder / other).write_bytes(data)
    tree["buffers"].append({"uri": "x.bin", "byteLength": len(picture)})
    (folder / "x.bin").write_bytes(picture)
    if way == "view":
        tree["bufferViews"].append({"buffer": len(tree["buffers"]) - 1, "byteLength": len(picture)})
        tree["images"] = [{"bufferView": len(tree["bufferViews"]) - 1, "mimeType": "image/png"}]
    elif way == "data":
        tree["images"] = [{"uri": f"data:image/png;base64,{base64.b64encode(picture).decode()}"}]
    else:
        tree["images"] = [{"uri": "x.bin"}]
    (folder / "s.gltf").write_text(json.dumps(tree))
    return folder / "s.gltf"


def obj_with(folder: Path, picture: bytes, name: str) -> Path:
    (folder / "s.obj").write_text(OBJ)
    (folder / "s.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    (folder / name).write_bytes(picture)
    return folder / "s.obj"


def ply_with(folder: Path, picture: bytes, _: str) -> Path:
    (folder / "s.ply").write_text(PLY)
    (folder / "x.bin").write_bytes(picture)
    return folder / "s.ply"


TEXTURED = [
    (obj_with, "skin.png"),
    (obj_with, "x.bin"),
    (obj_with, "x.mtl"),
    (ply_with, ""),
    (gltf_with, "view"),
    (gltf_with, "data"),
    (gltf_with, "buffer"),
]


@pytest.mark.parametrize(("make", "way"), TEXTURED)
def test_no_texture_starts_a_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: Callable[[Path, bytes, str], Path], way: str
) -> None:
    """In no way of reaching a mesh: it is refused or gets one plain colour; a sound texture is read the same way."""
    started: list[str] = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: started.append("Ghostscript"))
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: started.append("program"))
    told: list[str] = []
    try:
        read_mesh(make(tmp_path, POSTSCRIPT, way), 10, warn=told.append)
    except InputError as error:
        told.append(str(error))
    assert started == []
    assert len(told) == 1
    assert "this is a PostScript file" in told[0] or "no texture that can be read (PNG" in told[0]
    told.clear()
    assert len(read_mesh(make(tmp_path, encoded("PNG"), way), 10, warn=told.append)) == 10
    assert told == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_folders_and_devices_do_not_make_it_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "folder.png").mkdir()
    assert "this is not a regular file" in refusal(lambda: read_pixels(tmp_path / "pipe.png"))
    assert "this is not a regular file" in refusal(lambda: read_picture(tmp_path / "pipe.png", "radial"))
    assert "this is a folder" in refusal(lambda: read_pixels(tmp_path / "folder.png"))
    assert "there is no such file" in refusal(lambda: read_pixels(tmp_path / "missing.png"))
    if Path("/dev/zero").exists():
        assert "this is not a regular file" in refusal(lambda: read_pixels("/dev/zero"))
    path = obj_with(tmp_path, b"", "skin.png")
    (tmp_path / "skin.png").unlink()
    os.mkfifo(tmp_path / "skin.png")
    assert "this is not a regular file" in refusal(lambda: read_mesh(path, 10))


def huge_png(width: int, height: int) -> bytes:
    """A PNG that claims this size."""
    data = encoded("PNG")
    header = b"IHDR" + struct.pack(">2I", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


@pytest.mark.parametrize("side", [9_460, 20_000])
def test_more_than_89_megapixels_are_not_decoded(tmp_path: Path, side: int, recwarn: pytest.WarningsRecorder) -> None:
    (tmp_path / "a.png").write_bytes(huge_png(side, side))
    line = f"{tmp_path / 'a.png'}: larger than 89 megapixels; scale it down"
    assert refusal(lambda: read_picture(tmp_path / "a.png", "radial")) == line
    path = obj_with(tmp_path, huge_png(side, side), "skin.png")
    assert refusal(lambda: read_mesh(path, 10)).endswith("'skin.png': larger than 89 megapixels; scale it down")
    if side < 10_000:
        path = gltf_with(tmp_path, huge_png(side, side), "view")
        assert refusal(lambda: read_mesh(path, 10)) == f"{path}: its texture: larger than 89 megapixels; scale it down"
    assert not recwarn.list


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_pictures_get_one_line(kind: str) -> None:
    """Cut short anywhere, or with some bytes changed: they give a picture or one line."""
    data = encoded(kind)
    rng = np.random.default_rng(0)
    for n in range(40):
        broken = bytearray(data[: int(rng.integers(1, len(data)))] if n % 2 else data)
        broken[int(rng.integers(0, len(broken)))] ^= 1 << int(rng.integers(0, 8))
        broken[int(rng.integers(0, min(len(broken), 100)))] = int(rng.integers(0, 256))
        with suppress(InputError), open_picture(bytes(broken), "here") as image:
            image.load()


@pytest.mark.parametrize("error", [struct.error, KeyError, EOFError, SyntaxError, IndexError, MemoryError, OSError])
def test_whatever_a_decoder_raises_becomes_one_line(error: type[Exception]) -> None:
    def read() -> None:
        with open_picture(encoded("PNG"), "here"):
            raise error

    assert refusal(read).startswith("here: ")


def test_of_two_readers_the_last_to_leave_lets_warnings_through_again() -> None:
    filters = list(warnings.filters)
    first, second = decoding("first"), decoding("second")
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    with warnings.catch_warnings(record=True) as heard:
        warnings.warn("oddity", stacklevel=1)
    assert not heard
    second.__exit__(None, None, None)
    assert list(warnings.filters) == filters


def test_pictures_are_picked_by_the_names_of_what_is_read() -> None:
    formats = Image.registered_extensions()
    assert {formats[suffix] for suffix in PICTURE_SUFFIXES} == set(KINDS)


def test_a_library_of_its_own_gets_the_same_decoders() -> None:
    """While it reads, other readers wait; afterwards all decoders are back."""
    other = encoded("PPM")
    entered = threading.Event()

    def enter() -> None:
        with restricted_decoders():
            entered.set()

    thread = threading.Thread(target=enter)
    with restricted_decoders(), Image.open(io.BytesIO(encoded("AVIF"))):
        for data in (other, POSTSCRIPT):
            with pytest.raises(UnidentifiedImageError):
                Image.open(io.BytesIO(data))
        thread.start()
        assert not entered.wait(0.05)
    thread.join()
    assert entered.is_set()
    with Image.open(io.BytesIO(other)) as image:
        assert image.format == "PPM"
