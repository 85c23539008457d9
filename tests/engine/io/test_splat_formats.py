"""Captures as other programs write them: .splat, SuperSplat's compressed .ply, .spz, encoded here byte by byte."""

from __future__ import annotations

import gzip
import math
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from engine.errors import InputError
from engine.io.load import load
from engine.scene.gaussians import Gaussians
from engine.scene.sh import colours
from tests.paths import SHARED

DATA = SHARED / "splats"
FORMATS = SHARED / "formats"
N = 600  # two full chunks of a compressed .ply and part of another
Bytes = Callable[[Gaussians], bytes]


def scene(degree: int = 0) -> Gaussians:
    r = np.random.default_rng(8)
    quats = r.normal(size=(N, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = r.uniform(-0.6, 0.6, (N, (degree + 1) ** 2, 3))
    sh[:, 0] = r.uniform(-1.7, 1.7, (N, 3))
    arrays = r.normal(size=(N, 3)), np.exp(r.uniform(-6, -1, (N, 3))), quats, r.uniform(0.02, 0.98, N), sh
    return Gaussians(*(a.astype(np.float32) for a in arrays))


def byte(value: float | np.floating) -> int:
    return min(255, max(0, round(value)))


def splat(g: Gaussians) -> bytes:
    """A .splat of 32 bytes per row: position, size, colour and opacity, rotation."""
    rows = []
    for place, size, quat, opacity, dc in zip(g.means, g.scales, g.quats, g.opacities, g.sh[:, 0], strict=True):
        rgba = [byte(255 * (0.5 + 0.28209479 * c)) for c in dc] + [byte(255 * opacity)]
        rows.append(struct.pack("<6f8B", *place, *size, *rgba, *(byte(128 * q + 128) for q in quat)))
    return b"".join(rows)


def bits(value: float, low: float, high: float, count: int) -> int:
    return round((2**count - 1) * (value - low) / (high - low))


def compressed(g: Gaussians) -> bytes:
    """A compressed .ply: bounds for every 256 rows, four words per row, bytes for spherical harmonics."""
    logs, rgb = np.log(g.scales), 0.5 + 0.28209479 * g.sh[:, 0]
    groups = [(g.means, "{}_x {}_y {}_z"), (logs, "{}_scale_x {}_scale_y {}_scale_z"), (rgb, "{}_r {}_g {}_b")]
    names = [n for _, group in groups[:2] for end in ("min", "max") for n in group.format(end, end, end).split()]
    names += [n for end in ("min", "max") for n in groups[2][1].format(end, end, end).split()]
    chunks, words, rest = b"", b"", b""
    for first in range(0, N, 256):
        part = slice(first, first + 256)
        ends = [(a[part].min(0), a[part].max(0)) for a, _ in groups]
        chunks += struct.pack("<18f", *(v for pair in ends for end in pair for v in end))
        for i in range(*part.indices(N)):
            elevens = []
            for (values, _), (low, high) in zip(groups[:2], ends[:2], strict=True):
                x, y, z = (bits(values[i, k], low[k], high[k], n) for k, n in ((0, 11), (1, 10), (2, 11)))
                elevens.append(x << 21 | y << 11 | z)
            quat = g.quats[i].astype(float)
            largest = int(np.argmax(np.abs(quat)))
            quat *= math.copysign(1, quat[largest])
            turn = largest
            for k in range(4):
                if k != largest:
                    turn = turn << 10 | bits(quat[k], -(0.5**0.5), 0.5**0.5, 10)
            r, g_, b = (bits(rgb[i, k], ends[2][0][k], ends[2][1][k], 8) for k in range(3))
            colour = r << 24 | g_ << 16 | b << 8 | byte(255 * g.opacities[i])
            words += struct.pack("<4I", elevens[0], turn, elevens[1], colour)
            rest += bytes(min(255, int((v / 8 + 0.5) * 256)) for v in g.sh[i, 1:].T.ravel())
    head = f"ply\nformat binary_little_endian 1.0\nelement chunk {-(-N // 256)}\n"
    head += "".join(f"property float {name}\n" for name in names) + f"element vertex {N}\n"
    head += "".join(f"property uint packed_{what}\n" for what in ("position", "rotation", "scale", "color"))
    coefficients = 3 * (g.sh.shape[1] - 1)
    if coefficients:
        head += f"element sh {N}\n" + "".join(f"property uchar f_rest_{i}\n" for i in range(coefficients))
    return head.encode() + b"end_header\n" + chunks + words + rest


FIELDS = ("version", "count", "degree", "bits", "flags", "zero")


def spz(g: Gaussians, version: int = 3, extra: bytes = b"", **changes: int) -> bytes:
    """An .spz: attribute by attribute, gzipped, or each in a zstd frame. Writes the scene's axes as the file's."""
    streams = (5 + (g.sh_degree > 0)) * (version == 4)
    numbers = {"count": N, "degree": g.sh_degree, "bits": 12, "flags": 0, "zero": streams, "version": version} | changes
    head = struct.pack("<4sIIBBBB", b"NGSP", *(numbers[k] for k in FIELDS))
    places = b"".join(round(4096 * v).to_bytes(3, "little", signed=True) for v in g.means.ravel().astype(float))
    if version == 1:
        places = g.means.astype("<f2").tobytes()
    alphas = bytes(byte(255 * a) for a in g.opacities)
    tints = bytes(byte(255 * (0.15 * c + 0.5)) for c in g.sh[:, 0].ravel())
    sizes = bytes(byte(16 * (math.log(s) + 10)) for s in g.scales.ravel())
    turns = b""
    for w, x, y, z in g.quats.astype(float):
        if version <= 2:
            turns += bytes(byte(127.5 * math.copysign(1, w) * v + 127.5) for v in (x, y, z))
            continue
        quat = [x, y, z, w]
        largest = max(range(4), key=lambda k: abs(quat[k]))
        word = largest
        for k in range(4):
            if k != largest:
                minus = (quat[k] < 0) != (quat[largest] < 0)
                word = word << 10 | minus << 9 | round(511 * abs(quat[k]) * 2**0.5)
        turns += struct.pack("<I", word)
    rest = bytes(byte(128 * v + 128) for v in g.sh[:, 1:].ravel())
    parts = [places, alphas, tints, sizes, turns, rest]
    if version != 4:
        return gzip.compress(head + b"".join(parts) + extra, mtime=0)
    packed = [zstandard.compress(part) for part in parts[:streams]]
    table = b"".join(struct.pack("<QQ", len(p), len(part)) for p, part in zip(packed, parts, strict=False))
    return head + struct.pack("<Q8x", 32 + len(extra)) + extra + table + b"".join(packed)


def flipped(g: Gaussians) -> Gaussians:
    """The scene with y and z negated, except for the spherical harmonics above degree 0."""
    return Gaussians(
        g.means * np.array([1, -1, -1], np.float32),
        g.scales,
        g.quats * np.array([1, 1, -1, -1], np.float32),
        g.opacities,
        g.sh,
    )


def matrices(quats: np.ndarray) -> np.ndarray:
    w, x, y, z = quats.T.astype(float)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, 1).reshape(-1, 3, 3)


def seen(path: Path, content: bytes) -> Gaussians:
    path.write_bytes(content)
    loaded = load(path)
    assert not loaded.warnings
    return loaded.gaussians


def assert_near(found: Gaussians, true: Gaussians, place: float, size: float, turn: float, dc: float) -> None:
    """Asserts equality to within half a quantisation step: `size` of logs, `turn` of a matrix's entries."""
    assert len(found) == len(true) and found.sh.shape == true.sh.shape
    assert np.abs(found.means - true.means).max() < place
    assert np.abs(np.log(found.scales) - np.log(true.scales)).max() < size
    assert np.abs(matrices(found.quats) - matrices(true.quats)).max() < turn
    assert np.abs(found.opacities - true.opacities).max() < 0.5 / 255 + 1e-6
    assert np.abs(found.sh[:, 0] - true.sh[:, 0]).max() < dc


def test_a_splat_is_read_to_a_byte(tmp_path: Path) -> None:
    assert_near(seen(tmp_path / "a.SPLAT", splat(scene())), scene(), 1e-9, 1e-6, 0.02, 0.51 / 255 / 0.282)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_compressed_ply_is_read_to_its_steps(tmp_path: Path, degree: int) -> None:
    true = scene(degree)
    found = seen(tmp_path / "a.ply", compressed(true))
    wide = max(np.ptp(true.means[i : i + 256], axis=0).max() for i in (0, 256))
    assert_near(found, true, 0.51 * wide / 1023, 0.51 * 5 / 1023, 0.004, 0.51 * 3.4 / 255 + 1e-6)
    if degree:
        assert np.abs(found.sh[:, 1:] - true.sh[:, 1:]).max() <= 4 / 256 + 1e-6


@pytest.mark.parametrize(
    ("version", "degree", "turn"),
    [(1, 1, 0.035), (2, 0, 0.035), (2, 3, 0.035), (3, 1, 0.008), (3, 3, 0.008), (4, 0, 0.008), (4, 3, 0.008)],
)
def test_an_spz_is_read_to_its_steps_and_turned_as_a_ply_is(
    tmp_path: Path, version: int, degree: int, turn: float
) -> None:
    true = scene(degree)
    if version <= 2:  # w follows from the other three: near 0 it is only their rounding
        true.quats[:] = np.where(np.abs(true.quats[:, :1]) < 0.25, np.array([1, 0, 0, 0], np.float32), true.quats)
    found = seen(tmp_path / "a.spz", spz(true, version))
    place = 2**-10 if version == 1 else 0.51 / 4096  # half floats up to 4 in size
    assert_near(found, flipped(true), place, 0.51 / 16, turn, 0.51 / 255 / 0.15)
    # Light from above stays above: the flipped scene looks, from each flipped direction, as the original did.
    directions = np.random.default_rng(1).normal(size=(N, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before, after = colours(true.sh, directions), colours(found.sh, directions * (1, -1, -1))
    assert np.abs(before - after).max() < 0.05


def test_an_spz_may_hold_more_than_is_known(tmp_path: Path) -> None:
    true, path = scene(), tmp_path / "a.spz"
    for version in (3, 4):
        assert len(seen(path, spz(true, version, flags=3, extra=b"x" * 99))) == N
    assert len(seen(path, gzip.decompress(spz(true)))) == N  # as some tools store it
    path.write_bytes(spz(true, degree=4, extra=b"\x80" * 72 * N))
    loaded = load(path)
    assert loaded.gaussians.sh_degree == 3 and "degree 4" in loaded.warnings[0]


@pytest.mark.skipif(not FORMATS.exists(), reason="the folder of other formats is absent")
def test_one_capture_in_two_formats_is_one_scene() -> None:
    """Written by other programs, each with its own rounding and order."""
    one, other = (load(FORMATS / name).gaussians for name in ("biker_v4.spz", "biker.compressed.ply"))
    assert len(one) == len(other)
    away, at = cKDTree(one.means).query(other.means)
    assert away.max() < 0.0005
    assert np.percentile(np.abs(np.log(one.scales[at] / other.scales)), 95) < 0.51 / 16
    assert np.percentile(np.abs(one.opacities[at] - other.opacities), 95) < 1 / 255
    assert np.percentile(np.abs((one.quats[at] * other.quats).sum(1)), 5) > 0.9999
    assert np.percentile(np.abs(one.sh[at, 0] - other.sh[:, 0]), 95) < 0.51 / 255 / 0.15


def test_rows_that_are_no_gaussians_are_dropped_and_counted(tmp_path: Path) -> None:
    true, path = scene(), tmp_path / "a.splat"
    true.scales[3], true.means[7] = 0, np.nan
    true.scales[0] = 0.4, 0, 0.2  # a disc
    path.write_bytes(splat(true))
    loaded = load(path)
    assert loaded.gaussians.scales[0] == pytest.approx([0.4, 0.002, 0.2], rel=1e-5)
    assert len(loaded.gaussians) == N - 2 and loaded.warnings == (f"{path}: 2 of 600 Gaussians dropped: NaN or Inf",)


NOTHING = struct.pack("<4sIIBBBB", b"NGSP", 3, 9, 0, 12, 0, 0)
SPZ, SPZ4, PLY = spz(scene(1)), spz(scene(1), version=4), compressed(scene(1))
TABLE = struct.unpack_from("<12Q", SPZ4, 32)
TINY = zstandard.compress(b"\0" * (64 << 20))
ROWS = PLY.index(b"end_header\n") + 11
BAD = {
    "empty.splat": (b"", "empty"),
    "part.splat": (splat(scene())[:-5], "truncated"),
    "zeros.splat": (b"\0" * 320, "none of the 10"),
    "part.spz": (SPZ[: len(SPZ) // 2], "truncated"),
    "damaged.spz": (SPZ[:2000] + b"\xff" * 50 + SPZ[2050:], "damaged"),
    "other.spz": (gzip.compress(b"hello" * 9), "not an .spz scene"),
    "nothing.spz": (gzip.compress(b""), "not an .spz scene"),
    "text.spz": (b"hello" * 9, "not an .spz scene"),
    "version0.spz": (spz(scene(), version=0), "version 0"),
    "gzipped4.spz": (gzip.compress(SPZ4), "unpack it with gunzip"),
    "head4.spz": (SPZ4[:30], "truncated"),
    "table4.spz": (SPZ4[:99], "within its table of contents"),
    "far4.spz": (SPZ4[:16] + b"\xff" * 8 + SPZ4[24:], "within its table of contents"),
    "part4.spz": (SPZ4[:-9], "within their spherical harmonics"),
    "long4.spz": (SPZ4[:32] + b"\xff" * 8 + SPZ4[40:], "within their places"),
    "promise4.spz": (spz(scene(), version=4, count=9_999_999), "5,400 bytes of places"),
    "streams4.spz": (spz(scene(), version=4, zero=4), "damaged"),
    "frame4.spz": (SPZ4[:130] + b"\0" * 9 + SPZ4[139:], "cannot be unpacked"),
    "bomb4.spz": (
        SPZ4[:32] + struct.pack("<12Q", len(TINY), *TABLE[1:]) + TINY + SPZ4[128 + TABLE[0] :],
        "more in its places",
    ),
    "degree9.spz": (spz(scene(), degree=9), "damaged"),
    "bits.spz": (spz(scene(), bits=99), "damaged"),
    "zero.spz": (spz(scene(), zero=1), "damaged"),
    "none.spz": (spz(scene(), count=0), "0 Gaussians"),
    "billions.spz": (spz(scene(), count=4_000_000_000), "4,000,000,000 Gaussians"),
    "few.spz": (spz(scene(), count=N - 1), "more in it"),
    "many.spz": (spz(scene(), count=N + 1), "601 Gaussians are promised"),
    "promise.spz": (spz(scene(), count=9_999_999), "truncated"),
    "bomb.spz": (gzip.compress(NOTHING + b"\0" * (64 << 20)), "more in it"),
    "part.ply": (PLY[:-5], "truncated"),
    "chunks.ply": (PLY.replace(b"chunk 3", b"chunk 2"), "need 3 chunks, it has 2"),
    "sh.ply": (PLY.replace(b"sh 600", b"sh 599"), "spherical harmonics of 599"),
    "count.ply": (PLY.replace(b"vertex 600", b"vertex 999999999999"), "truncated or damaged"),
    "no_sh.ply": (PLY.replace(b"uchar f_rest_8", b"uchar nonsense"), "f_rest_8"),
    "five.ply": (PLY.replace(b"property uchar f_rest_8\n", b""), "8 'f_rest' properties"),
    "types.ply": (PLY.replace(b"uint packed_scale", b"float packed_scale"), "packed_scale"),
    "gap.ply": (PLY.replace(b"packed_scale", b"packed_scene"), "packed_scale"),
    "no_chunks.ply": (PLY.replace(b"element chunk", b"element lumps"), "no 'chunk' element"),
    "ascii.ply": (PLY.replace(b"binary_little_endian", b"ascii") + b" " * N, "must be binary"),
    "nan.ply": (PLY[:ROWS] + b"\xff" * 216 + PLY[ROWS + 216 :], "none of the 600"),
    "other.sog": (b"PK\x03\x04", "no SOG capture"),
    "other.txt": (b"hello", "not a scene"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_read_gets_one_line_and_little_memory(tmp_path: Path, name: str) -> None:
    content, expected = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            load(path)
        assert tracemalloc.get_traced_memory()[1] < 40 << 20
    finally:
        tracemalloc.stop()
    line = str(caught.value)
    assert line.startswith(f"{path}: ") and "\n" not in line and expected in line


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["a.splat", "a.spz", "b.spz", "a.ply"]), st.data())
def test_damage_never_leaks_an_error(tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject) -> None:
    """Any bytes changed or cut off give a scene or one line, nothing else."""
    content = bytearray({"a.splat": splat(scene())[:640], "a.spz": SPZ, "b.spz": SPZ4, "a.ply": PLY}[name])
    inner = bytearray(gzip.decompress(content)) if name == "a.spz" else content
    for _ in range(data.draw(st.integers(0, 6))):
        inner[data.draw(st.integers(0, len(inner) - 1))] = data.draw(st.integers(0, 255))
    inner = inner[: data.draw(st.integers(0, len(inner)))]
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(gzip.compress(inner, 1) if name == "a.spz" else inner)
    try:
        gaussians = load(path).gaussians
    except InputError:
        with pytest.raises(InputError, match=r"^[^\n]*$"):
            load(path)
        return
    assert all(np.isfinite(a).all() for a in vars(gaussians).values())


@pytest.mark.skipif(not DATA.exists(), reason="the folder of real captures is absent")
@pytest.mark.parametrize(("name", "count"), [("guitar.compressed.ply", 90_854), ("plant.splat", 113_648)])
def test_real_captures_open(name: str, count: int) -> None:
    loaded = load(DATA / name)
    assert len(loaded.gaussians) == count and not loaded.warnings
