"""Valid files and their mutations: structure changed with values chosen to hurt, then some bytes."""

from __future__ import annotations

import copy
import gzip
import json
import math
import struct
from typing import Any

from hypothesis import strategies as st

__all__ = ["CAPTURES", "CHANGES", "JUNK", "NUMBERS", "POISON", "broken", "documents", "plys", "poisoned"]

POISON: tuple[Any, ...] = (
    None, True, False, 0, -0.0, 1, -1, 2, 3, 255, 1e-320, 1e-30, 1e12, 1e38, 3.5e38, 1e308, -1e308, math.nan,
    math.inf, -math.inf, 2**31, 2**53, 2**63, -(2**63), 10**30, 10**400, "", "x", "\0", "NaN", "../..", "/etc/passwd",
    "²", "٣", "\ud800", "a" * 20_000, [], {}, [[]], [0, 0, 0], [1, 0, 0], [1e308] * 4, [math.nan] * 3, {"kind": 3},
)  # fmt: skip

NUMBERS = ("nan", "inf", "-inf", "1e38", "3.5e38", "1e39", "-1e38", "1e-45", "0", "-0", "1", "88", "-104", "1e308",
           "1e400", "30", "-30", "40", "1e9", "1e4", "9" * 22, "²", "", "x", "0x1p3", "1_0", "\0")  # fmt: skip

JUNK = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), st.integers(0, 255)), max_size=3)
"""Where, how, and with what value the bytes of a file are changed."""


def broken(data: bytes, junk: list[tuple[float, int, int]]) -> bytes:
    """The bytes with a few overwritten, cut, repeated, or moved."""
    for where, how, value in junk:
        at = int(where * max(len(data) - 1, 0))
        if how < 4:
            data = data[:at] + bytes([value]) + data[at + 1 :]
        elif how == 4:
            data = data[:at]
        elif how == 5:
            data = data[:at] + data[at + 1 + value :]
        elif how == 6:
            data = data[: at + value] + data[at:]
        elif how == 7:
            data = data[:at] + struct.pack("<f", (math.nan, math.inf, 1e38, -1e38, 1e-45)[value % 5]) + data[at + 4 :]
        elif how == 8:
            data = data[:at] + b"\xff" * (value % 9) + data[at + value % 9 :]
        else:
            data = data[:at] + data[at:] * 2 if len(data) < 1 << 16 else data
    return data


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all values in a JSON document, except the document itself."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [found for key, item in items for found in ((*path, key), *places(item, (*path, key)))]


def poisoned(value: Any, changes: list[tuple[float, int, int]]) -> Any:
    """The document with a few values replaced by poison, removed, or duplicated."""
    value = copy.deepcopy(value)
    for where, how, which in changes:
        found = places(value)
        if not found:
            return value
        *way, last = found[int(where * (len(found) - 1))]
        holder = value
        for key in way:
            holder = holder[key]
        if how < 7:
            holder[last] = copy.deepcopy(POISON[which % len(POISON)])
        elif how == 7:
            del holder[last]
        elif how == 8 and isinstance(holder, list):
            holder.insert(last, copy.deepcopy(holder[last]))
        elif isinstance(holder, dict):
            holder[str(last) + "x"] = holder[last]
    return value


CHANGES = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 9), st.integers(0, 255)), max_size=3)


def documents(record: Any) -> st.SearchStrategy[bytes]:
    """Poisoned JSON, sometimes nested too deep, sometimes with broken bytes."""

    def text(changes: list[tuple[float, int, int]], junk: list[tuple[float, int, int]], deep: int) -> bytes:
        if deep == 0:
            return b"[" * 100_000
        return broken(json.dumps(poisoned(record, changes)).encode("utf-8", "surrogatepass"), junk)

    return st.builds(text, CHANGES, st.just([]) | JUNK, st.integers(0, 200))


# .ply

NAMES = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1",
         "rot_2", "rot_3")  # fmt: skip
TYPES = {"float": "f", "double": "d", "uchar": "B", "int": "i", "short": "h"}
COUNTS = ("-1", "0", "1", "2", "3", "4", "1000000000000", "18446744073709551616", "4294967296", "1e3", "", "x")


@st.composite
def plys(draw: st.DrawFn) -> bytes:
    """A small scene in some dialect, with poison in its rows and its header."""
    kind = draw(st.sampled_from(("ascii", "binary_little_endian", "binary_big_endian")))
    rest = draw(st.sampled_from((0, 0, 9, 24, 45, 8)))
    names = [*NAMES, *(f"f_rest_{i}" for i in range(rest))]
    rows = draw(st.integers(0, 4))
    type_ = draw(st.sampled_from(("float", "float", "float", "double", "int", "uchar", "quad")))
    table = [[0.1 * (i + j) for j in range(len(names))] for i in range(rows)]
    texts = [[f"{value:.6g}" for value in row] for row in table]
    for _ in range(draw(st.integers(0, 3)) if rows else 0):
        texts[draw(st.integers(0, rows - 1))][draw(st.integers(0, len(names) - 1))] = draw(st.sampled_from(NUMBERS))
    lines = ["ply", f"format {kind} 1.0", f"element vertex {rows}", *(f"property {type_} {name}" for name in names)]
    extra = draw(st.sampled_from(("", "list", "face", "camera")))
    body = b""
    if extra:
        lines[2:2] = [f"element {extra} 1", "property list uchar int i" if extra != "camera" else "property float f"]
        body = b"1 7\n" if kind == "ascii" else struct.pack("<Bi" if extra != "camera" else "<f", *((1, 7, 1.0)[:2] if extra != "camera" else (1.0,)))  # fmt: skip  # noqa: E501
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.integers(0, len(lines) - 1))
        how = draw(st.integers(0, 5))
        if how == 0:
            lines[at] = f"element vertex {draw(st.sampled_from(COUNTS))}"
        elif how == 1:
            del lines[at]
        elif how == 2:
            lines.insert(at, lines[at])
        elif how == 3:
            lines.insert(
                at, draw(st.sampled_from(("comment \xe9", "end_header", "", "property", "element", "obj_info")))
            )
        elif how == 4:
            lines[at] += draw(st.sampled_from((" ", "\t", "\r", " x", "\0")))
        else:
            lines.insert(at, "property list int int " + draw(st.sampled_from(NAMES)))
        if not lines:
            break
    head = draw(st.sampled_from(("\n", "\n", "\r\n", "\r"))).join([*lines, "end_header", ""]).encode("latin-1")
    if kind == "ascii":
        body += b"".join(" ".join(row).encode("latin-1", "replace") + b"\n" for row in texts)
    else:
        order, code = "<" if "little" in kind else ">", TYPES.get(type_, "f")
        body += b"".join(number(order + code, value) for row in texts for value in row)
    return broken(head + body, draw(st.just([]) | JUNK))


def number(code: str, text: str) -> bytes:
    """A number as bytes, as closely as the type allows."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    try:
        return struct.pack(code, value if code[1] in "fd" else int(value))
    except (struct.error, OverflowError, ValueError):
        return b"\xff" * struct.calcsize(code)


def compressed() -> bytes:
    """Two Gaussians in SuperSplat's packing."""
    ends = [f"{end}_{what}" for end in ("min", "max") for what in ("x", "y", "z", "scale_x", "scale_y", "scale_z")]
    packed = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
    head = ["ply", "format binary_little_endian 1.0", "element chunk 1", *(f"property float {name}" for name in ends)]
    head += ["element vertex 2", *(f"property uint {name}" for name in packed), "end_header", ""]
    bounds = struct.pack("<12f", -1, -1, -1, -5, -5, -5, 1, 1, 1, -2, -2, -2)
    return "\n".join(head).encode() + bounds + struct.pack("<8I", *([0x3FE7F9FF, 0x20080200, 77, 0x80FF40C0] * 2))


def spz(version: int, count: int, degree: int, bits: int, flags: int, body: bytes) -> bytes:
    """An .spz with these header fields."""
    return gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, flags, 0) + body, mtime=0)


SPZ_BYTES = st.builds(
    spz,
    st.sampled_from((2, 2, 3, 1, 4)),
    st.sampled_from((2, 2, 2, 0, 3, 2**24, 2**32 - 1)),
    st.sampled_from((0, 0, 1, 3, 4, 255)),
    st.sampled_from((12, 12, 0, 23, 255)),
    st.sampled_from((0, 1, 2, 255)),
    st.builds(lambda n, b: bytes([b]) * n, st.sampled_from((0, 38, 40, 56, 130, 4000)), st.integers(0, 255)),
)


def splat_tree() -> tuple[dict[str, Any], bytes]:
    """Two Gaussians in a glTF, at two nodes: the JSON and the bytes."""
    values = {
        "POSITION": (3, 0.1),
        "ROTATION": (4, 0.5),
        "SCALE": (3, 0.02),
        "OPACITY": (1, 0.9),
        "SH_DEGREE_0_COEF_0": (3, 0.3),
    }
    values |= {f"SH_DEGREE_1_COEF_{k}": (3, 0.1) for k in range(3)}
    name = "KHR_gaussian_splatting"
    data = b""
    accessors: list[dict[str, Any]] = []
    views: list[dict[str, Any]] = []
    for width, value in values.values():
        kind = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width]
        accessors.append({"bufferView": len(views), "componentType": 5126, "count": 2, "type": kind})
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": 8 * width})
        data += struct.pack(f"<{2 * width}f", *[value, *[value / 2] * (width - 1)] * 2)
    names = {(key if key == "POSITION" else f"{name}:{key}"): k for k, key in enumerate(values)}
    look = {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    primitive = {"attributes": names, "mode": 0, "extensions": {name: look}}
    turned = {"rotation": [0, 0.6, 0, 0.8], "scale": [2, 2, 2], "translation": [1, 0, 0], "mesh": 0}
    tree = {"asset": {"version": "2.0"}, "extensionsUsed": [name], "scene": 0, "scenes": [{"nodes": [0, 1]}],
            "nodes": [{"mesh": 0, "children": []}, turned], "meshes": [{"primitives": [primitive]}],
            "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(data)}]}  # fmt: skip
    return tree, data


def glb(tree: Any, data: bytes) -> bytes:
    """A .glb with this JSON and these bytes."""
    text = json.dumps(tree).encode("utf-8", "surrogatepass")
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4s4I", b"glTF", 2, 28 + len(text) + len(data), len(text), 0x4E4F534A)
    return head + text + struct.pack("<2I", len(data), 0x4E4942) + data


SPLAT_TREE, SPLAT_DATA = splat_tree()
GLB_BYTES = st.builds(
    lambda changes, values, junk: broken(glb(poisoned(SPLAT_TREE, changes), broken(SPLAT_DATA, values)), junk),
    CHANGES,
    st.just([]) | JUNK,
    st.just([]) | st.just([]) | JUNK,
)
SPLAT_ROW = struct.pack("<6f8B", 0.1, 0.2, 0.3, 0.01, 0.02, 0.03, 9, 99, 199, 255, 228, 128, 128, 128)
CAPTURES = st.one_of(
    st.tuples(st.just("a.splat"), st.builds(lambda n, j: broken(SPLAT_ROW * n, j), st.integers(0, 120), JUNK)),
    st.tuples(st.just("a.spz"), st.builds(broken, SPZ_BYTES, st.just([]) | JUNK)),
    st.tuples(st.just("a.ply"), st.builds(broken, st.just(compressed()), JUNK)),
    st.tuples(st.just("a.glb"), GLB_BYTES),
    st.tuples(st.sampled_from(("a.obj", "a.stl", "a.glb", "a.ksplat", "a")), st.binary(max_size=60)),
)
