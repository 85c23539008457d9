"""Pictures as exemplars and as textures: sound ones, mutated ones, and files that we do not take as pictures."""

from __future__ import annotations

import io
import json
import struct
import zlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from PIL import Image, ImageCms, PngImagePlugin, features

from benchmarks.readers.inputs import JUNK, broken
from benchmarks.readers.rules import result_or_refusal
from engine.io.meshes.mesh import read_mesh
from training.priors.exemplar.pictures import read_picture

__all__ = ["FOREIGN", "PICTURES", "TEXTURES", "check_foreign", "check_picture", "check_texture"]

WIDTH, HEIGHT = 44, 37
"""Size of the sound pictures: numbers that can be found in their bytes."""

SIZES = (0, 1, 23, 24, 38, 1000, 9000, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1)
"""Sizes claimed instead: zero, too small, larger than the data, impossible."""


def disk() -> Image.Image:
    """A cut face on a plain background."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inside = np.hypot(x - WIDTH / 2, y - HEIGHT / 2) < 15
    ground = np.full((HEIGHT, WIDTH, 3), 250, np.uint8)
    face = np.stack([200 + x % 9, 60 + 2 * y, 40 + x], axis=-1).astype(np.uint8)
    return Image.fromarray(np.where(inside[..., None], face, ground))


@cache
def sound() -> tuple[bytes, ...]:
    """The disk in every format and mode in use, with the metadata that cameras and editors write."""
    image = disk()
    alpha = image.convert("RGBA")
    alpha.putalpha(image.convert("L").point(lambda v: 0 if v > 245 else 255))
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "Camera"
    icc = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    xmp = b"<x:xmpmeta xmlns:x='adobe:ns:meta/'><a/></x:xmpmeta>"
    notes = PngImagePlugin.PngInfo()
    notes.add_text("Comment", "x" * 50, zip=True)
    notes.add_itxt("XML:com.adobe.xmp", xmp.decode(), zip=True)
    more: dict[str, Any] = {"exif": exif, "icc_profile": icc}
    shots: list[tuple[str, Image.Image, dict[str, Any]]] = [
        ("PNG", image, more | {"pnginfo": notes}),
        ("PNG", alpha, {}),
        ("PNG", image.convert("P"), {"transparency": 3}),
        ("PNG", image.convert("1"), {}),
        ("PNG", Image.fromarray(np.asarray(image.convert("L"), np.uint16) * 257), {}),
        ("PNG", image, {"save_all": True, "append_images": [image.rotate(90)]}),
        ("JPEG", image, more | {"xmp": xmp, "comment": b"c"}),
        ("JPEG", image.convert("CMYK"), {}),
        ("JPEG", image.convert("L"), {"progressive": True}),
        ("MPO", image, {"save_all": True, "append_images": [image.rotate(180)]}),
        ("WEBP", image, more | {"xmp": xmp}),
        ("WEBP", alpha, {"lossless": True}),
        ("WEBP", image, {"save_all": True, "append_images": [image.rotate(90)], "minimize_size": False}),
        ("TIFF", image, more),
        ("TIFF", image.convert("CMYK"), {"compression": "tiff_lzw"}),
        ("TIFF", image.convert("F"), {"compression": "tiff_deflate"}),
        ("TIFF", image, {"compression": "jpeg"}),
        ("TIFF", image.convert("1"), {"compression": "group4"}),
        ("GIF", image, {"save_all": True, "append_images": [image.rotate(90)], "comment": b"c"}),
        ("BMP", image, {}),
        ("BMP", image.convert("P"), {}),
    ]
    if features.check("avif"):
        shots += [("AVIF", image, more | {"xmp": xmp}), ("AVIF", alpha, {})]
    return tuple(encoded(picture, kind, extra) for kind, picture, extra in shots)


def encoded(image: Image.Image, kind: str, extra: dict[str, Any] | None = None) -> bytes:
    file = io.BytesIO()
    image.save(file, kind, **(extra or {}))
    return file.getvalue()


def places_of(data: bytes, number: int) -> list[tuple[int, str]]:
    """Where a number may stand in the bytes, and in which format."""
    found: list[tuple[int, str]] = []
    for code in ("<H", ">H", "<I", ">I"):
        for value in (number, number - 1):  # WebP stores sizes minus one
            at = data.find(struct.pack(code, value))
            while at >= 0 and len(found) < 200:
                found.append((at, code))
                at = data.find(struct.pack(code, value), at + 1)
    return found


def claimed(data: bytes, which: float, size: int) -> bytes:
    """The picture with another width or height claimed somewhere."""
    places = places_of(data, WIDTH) + places_of(data, HEIGHT)
    if not places:
        return data
    at, code = places[int(which * (len(places) - 1))]
    value = struct.pack(code, size & (0xFFFF if code[1] == "H" else 0xFFFFFFFF))
    return data[:at] + value + data[at + len(value) :]


def repaired(data: bytes) -> bytes:
    """A .png with chunk checksums recomputed as far as chunks can be found; without them no reader gets far."""
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data
    parts, at = [data[:8]], 8
    while at + 12 <= len(data):
        length = struct.unpack(">I", data[at : at + 4])[0]
        chunk = data[at + 4 : at + 8 + length]
        if len(chunk) < 4 + length:
            break
        parts.append(data[at : at + 4] + chunk + struct.pack(">I", zlib.crc32(chunk)))
        at += 12 + length
    return b"".join(parts) + data[at:]


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


PNG_CHUNKS = st.sampled_from(
    (
        chunk(b"zTXt", b"k\0\0" + zlib.compress(bytes(1 << 24))),
        chunk(b"iTXt", b"k\0\1\0\0\0" + zlib.compress(bytes(1 << 22))),
        chunk(b"iCCP", b"p\0\0" + zlib.compress(bytes(1 << 22))),
        chunk(b"eXIf", b"MM\0*\0\0\0\x08\xff\xff" + bytes(60)),
        chunk(b"acTL", struct.pack(">II", 2**31 - 1, 0)),
        chunk(b"IHDR", struct.pack(">IIBBBBB", 100_000, 100_000, 16, 6, 0, 0, 1)),
        *(chunk(name, bytes(size)) for name, size in (
            (b"fcTL", 26), (b"PLTE", 7), (b"tRNS", 1), (b"tRNS", 300), (b"gAMA", 4), (b"IDAT", 0), (b"IEND", 0),
            (b"pHYs", 0), (b"cHRM", 3),
        )),
    )
)  # fmt: skip
"""Chunks to insert into a .png: bombs, endless tag directories, animations, invalid palettes."""


def with_chunk(data: bytes, extra: bytes, where: int) -> bytes:
    """A .png with one more chunk after chunk number `where`; any other picture unchanged."""
    at = 8
    for _ in range(where + 1):
        if not data.startswith(b"\x89PNG") or at + 12 > len(data):
            return data
        at += 12 + struct.unpack(">I", data[at : at + 4])[0]
    return data[:at] + extra + data[at:]


SOUND = st.deferred(lambda: st.sampled_from(sound()))
PICTURES: st.SearchStrategy[bytes] = st.one_of(
    st.builds(lambda data, junk: repaired(broken(data, junk)), SOUND, JUNK),
    st.builds(broken, SOUND, JUNK),
    st.builds(lambda d, w, s: repaired(claimed(d, w, s)), SOUND, st.floats(0, 1), st.sampled_from(SIZES)),
    st.builds(with_chunk, SOUND, PNG_CHUNKS, st.integers(0, 3)),
    st.builds(lambda a, b, at: a[: int(at * len(a))] + b[int(at * len(b)) :], SOUND, SOUND, st.floats(0, 1)),
)


def check_picture(data: bytes, folder: Path) -> bool:
    """Reads the picture as an exemplar."""
    path = folder / "face.png"
    path.write_bytes(data)
    picture = result_or_refusal(lambda: read_picture(path, "horizontal"), folder)
    if picture is None:
        return False
    rgb = picture.rgb
    assert np.isfinite(rgb).all() and rgb.min() >= 0 and rgb.max() <= 1, "colours outside [0, 1]"
    assert picture.mask.any() and picture.mask.shape == picture.rgb.shape[:2], "no cut face"
    return True


# other people's formats


@cache
def foreign() -> tuple[bytes, ...]:
    """Other kinds of file under a picture's name; Pillow reads many of them, and starts programs for some."""
    image = disk()
    written = [encoded(image.convert(mode), kind) for kind, mode in (
        ("EPS", "RGB"), ("PDF", "RGB"), ("ICO", "RGBA"), ("PCX", "RGB"), ("PPM", "RGB"), ("TGA", "RGB"), ("SGI", "RGB"),
        ("XBM", "1"), ("DDS", "RGBA"), ("ICNS", "RGBA"), ("SPIDER", "F"), ("MSP", "1"),
    )]  # fmt: skip
    script = b"(fuzzed) (w) file dup (x) writestring closefile "
    head = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 30\n"
    eps = [
        head + b"%%EndComments\n" + code + b"\nshowpage\n%%EOF\n"
        for code in (script, b"{ } loop", b"(%pipe%id) (r) file")
    ]
    return (
        *written, *eps, b"%!PS\n" + script,
        struct.pack("<IIII", 0xC6D3D0C5, 32, len(eps[0]), 0) + bytes(16) + eps[0],  # EPS in its DOS wrapping
        b"%PDF-1.7\n1 0 obj<</Type/Catalog/OpenAction<</S/JavaScript/JS(x)>>>>endobj\n%%EOF",
        b"<?xml version='1.0'?><!DOCTYPE svg [<!ENTITY x SYSTEM 'file:///etc/hostname'>]>"
        b"<svg xmlns='http://www.w3.org/2000/svg'><image href='file:///etc/hostname'/><text>&x;</text></svg>",
        b"8BPS" + struct.pack(">H6xHIIHH", 1, 3, 37, 44, 8, 3) + bytes(12) + bytes(3 * 37 * 44 + 2),
        b"SIMPLE  =                    T".ljust(80) + b"BITPIX  =                    8".ljust(80)
        + b"NAXIS   =                    2".ljust(80) + b"NAXIS1  =                   44".ljust(80)
        + b"NAXIS2  =                   37".ljust(80) + b"END".ljust(2480) + bytes(44 * 37),
        b"\xd7\xcd\xc6\x9a\0\0\0\0\0\0\x2c\0\x25\0\x60\0\0\0\0\0\xb1\x57\x01\0\x09\0\0\x03" + bytes(40),  # WMF
        struct.pack("<II", 1, 108) + bytes(32) + b" EMF" + bytes(80),
        b"GRIB\0\0\0\x01" + bytes(40), b"\x89HDF\r\n\x1a\n" + bytes(40), b"BUFR" + bytes(40),
        b"\0\0\x01\xb3" + bytes(40), b"qoif" + struct.pack(">IIBB", 44, 37, 3, 0) + bytes(99) + b"\0" * 7 + b"\1",
        b"P3\n44 37\n255\n" + b"1 " * (44 * 37 * 3),
        b"/* XPM */\nstatic char *a[] = {\n\"44 37 1 1\",\n\"a c #fff\",\n",
        b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(40), b"\xff\x4f\xff\x51" + bytes(60), b"PK\x03\x04" + bytes(30),
        b"<!DOCTYPE html><html>404</html>", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", b"",
    )  # fmt: skip


FOREIGN: st.SearchStrategy[bytes] = st.builds(
    lambda data, junk: data + bytes(junk), st.deferred(lambda: st.sampled_from(foreign())), st.integers(0, 3)
)


def check_foreign(data: bytes, folder: Path) -> bool:
    """Reads the file as an exemplar and as a texture, under a picture's name: refused, and nothing started."""
    assert not check_picture(data, folder), f"read as a picture: {data[:20]!r}"
    for name in ("a.obj", "a.glb"):
        # A mesh may report that its texture cannot be used, and load in grey.
        check_texture((name, data), folder)
    return False


# textures

TEXTURES: st.SearchStrategy[tuple[str, bytes]] = st.tuples(st.sampled_from(("a.obj", "a.glb", "a.gltf")), PICTURES)

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


def check_texture(value: tuple[str, bytes], folder: Path) -> bool:
    """Reads the picture as the texture of a triangle."""
    name, data = value
    path = folder / name
    if name == "a.obj":
        (folder / "skin.png").write_bytes(data)
        (folder / "a.mtl").write_text("newmtl m\nmap_Kd skin.png\n")
        path.write_text("mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    else:
        path.write_bytes(gltf(data, folder if name == "a.gltf" else None))
    loaded = result_or_refusal(lambda: read_mesh(path, count=200), folder)
    if loaded is None:
        return False
    for key, values in vars(loaded).items():
        assert np.isfinite(values).all(), key
    return True


def gltf(picture: bytes, folder: Path | None) -> bytes:
    """A triangle with the picture embedded, as a .glb; or beside it in a folder, as a .gltf."""
    corners = TRIANGLE.tobytes() + TRIANGLE[:, :2].tobytes()
    body = corners + picture + bytes(-len(picture) % 4)
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 24}]
    image: dict[str, Any] = {"uri": "skin.png"}
    buffer: dict[str, Any] = {"byteLength": len(body)}
    if folder is None:
        views.append({"buffer": 0, "byteOffset": 60, "byteLength": len(picture)})
        image = {"bufferView": 2, "mimeType": "image/png"}
    else:
        (folder / "skin.png").write_bytes(picture)
        (folder / "a.bin").write_bytes(body)
        buffer["uri"] = "a.bin"
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [image],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
        ],
        "bufferViews": views,
        "buffers": [buffer],
    }
    if folder is not None:
        return json.dumps(document).encode()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
