"""SOG and .ksplat captures, encoded here pixel by pixel and row by row."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from engine.errors import InputError
from engine.io.load import load, load_sample
from engine.scene.gaussians import Gaussians
from engine.scene.sh import sh_to_rgb
from tests.engine.io.test_splat_formats import FORMATS, N, assert_near, scene, seen

WIDTH = 32
"""Pixels in a row of the pictures: 600 Gaussians leave part of the last row empty."""


def webp(values: np.ndarray, width: int = WIDTH) -> bytes:
    """Rows of up to four bytes as a picture's pixels."""
    pixels = np.full((-(-len(values) // width) * width, 4), 255, np.uint8)
    pixels[: len(values), : values.shape[1]] = values
    file = io.BytesIO()
    Image.fromarray(pixels.reshape(-1, width, 4)).save(file, "WEBP", lossless=True, exact=True)
    return file.getvalue()


def nearest(book: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.abs(values[..., None] - book).argmin(-1).astype(np.uint8)


def sog(g: Gaussians, **changes: Any) -> dict[str, bytes]:
    """An .sog: logs of positions in two bytes, sizes and colours from codebooks, quats without their largest component,
    and as many palette entries as Gaussians."""
    logs = np.sign(g.means) * np.log1p(np.abs(g.means))
    low, high = logs.min(0), logs.max(0)
    steps = np.round((logs - low) / (high - low) * 65535).astype(int)
    sizes, tints = np.linspace(-6, -1, 256), np.linspace(-1.7, 1.7, 256)
    quats = g.quats.astype(float)
    largest = np.abs(quats).argmax(1)
    quats *= np.sign(quats[np.arange(N), largest])[:, None]
    others = np.array([[q[k] for k in range(4) if k != m] for q, m in zip(quats, largest, strict=True)])
    turns = np.c_[np.round((others / 2**0.5 + 0.5) * 255), 252 + largest]
    files = {
        "means_l.webp": webp(steps & 255),
        "means_u.webp": webp(steps >> 8),
        "scales.webp": webp(nearest(sizes, np.log(g.scales))),
        "quats.webp": webp(turns.astype(np.uint8)),
        "sh0.webp": webp(np.c_[nearest(tints, g.sh[:, 0]), np.round(255 * g.opacities).astype(np.uint8)]),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "count": N,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": sizes.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": tints.tolist(), "files": ["sh0.webp"]},
    }
    if g.sh_degree:
        book, order = np.linspace(-0.6, 0.6, 256), np.random.default_rng(2).permutation(N)
        rest = nearest(book, g.sh[:, 1:])
        palette = np.zeros((-(-N // 64) * 64, *rest.shape[1:]), np.uint8)
        palette[order] = rest
        names = ["shN_centroids.webp", "shN_labels.webp"]
        files[names[0]] = webp(palette.reshape(-1, 3), 64 * rest.shape[1])
        files[names[1]] = webp(np.c_[order & 255, order >> 8])
        meta["shN"] = {"count": N, "bands": g.sh_degree, "codebook": book.tolist(), "files": names}
    return files | {"meta.json": json.dumps(meta | changes).encode()}


def zipped(files: dict[str, bytes], folder: str = "") -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in files.items():
            archive.writestr(folder + name, content)
    return file.getvalue()


def ksplat(g: Gaussians, level: int, second: int | None = None) -> bytes:
    """A .ksplat of two sections, the second with SH of another degree if one is given; the first has two full buckets
    and one that is not."""
    floats, small = ("<f4", "<f2", "<f2")[level], ("<f4", "<f2", "u1")[level]
    bands = [g.sh[:, d * d : (d + 1) ** 2] for d in range(1, g.sh_degree + 1)]  # in each band, channel after channel
    sh = np.concatenate([b.transpose(0, 2, 1).reshape(N, -1) for b in bands], 1) if bands else np.zeros((N, 0))
    if level == 2:
        sh = np.round((sh + 1.5) / 3 * 255)
    heads, data = b"", b""
    degrees = g.sh_degree, g.sh_degree if second is None else second
    for rows, degree in zip((slice(0, 500), slice(500, N)), degrees, strict=True):
        means, buckets = g.means[rows], b""
        count, full, partial = len(means), 0, 0
        if level:
            full, partial = divmod(count, 200)[0], 1
            starts = [*range(0, full * 200, 200), full * 200]
            centres = np.array([means[s : s + 200].mean(0) for s in starts], "<f4")
            buckets = struct.pack("<I", count - full * 200) + centres.tobytes()
            places = np.round((means - centres[np.minimum(np.arange(count) // 200, full)]) / (8 / 32767) + 32767)
            packed = places.astype("<u2")
        else:
            packed = means.astype("<f4")
        rgba = np.round(np.c_[sh_to_rgb(g.sh[rows, 0]), g.opacities[rows]] * 255).clip(0, 255).astype(np.uint8)
        columns = [packed, g.scales[rows].astype(floats), g.quats[rows].astype(floats), rgba]
        columns.append(sh[rows, : 3 * ((degree + 1) ** 2 - 1)].astype(small))
        bytes_ = [np.ascontiguousarray(c).view(np.uint8).reshape(count, -1) for c in columns]
        data += buckets + np.concatenate(bytes_, 1).tobytes()
        head = struct.pack(
            "<4IfH2xI4x2IH",
            count,
            count,
            200 * (level > 0),
            full + partial,
            16.0,
            12,
            32767,
            full,
            partial,
            degree,
        )
        heads += head.ljust(1024, b"\0")
    start = struct.pack("<BBxx4IH2x3f2f", 0, 1, 2, 2, N, N, level, 0, 0, 0, -1.5, 1.5)
    return start.ljust(4096, b"\0") + heads + data


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_an_sog_is_read_to_its_steps(tmp_path: Path, degree: int) -> None:
    true, files = scene(degree), sog(scene(degree))
    (tmp_path / "a").mkdir()
    for name, content in files.items():
        (tmp_path / "a" / name).write_bytes(content)
    found = load(tmp_path / "a/meta.json").gaussians
    assert_near(found, true, 0.0005, 0.51 * 5 / 255, 0.02, 0.51 * 3.4 / 255)
    assert np.abs(found.sh[:, 1:] - true.sh[:, 1:]).max(initial=0) < 0.51 * 1.2 / 255
    for folder in ("", "scene/"):  # an archive of the files, or of a folder of any name
        again = seen(tmp_path / "a.zip", zipped(files, folder))
        np.testing.assert_array_equal(again.sh, found.sh)
        np.testing.assert_array_equal(again.means, found.means)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_a_ksplat_is_read_to_its_steps(tmp_path: Path, level: int, degree: int) -> None:
    true = scene(degree)
    found = seen(tmp_path / "a.ksplat", ksplat(true, level))
    half = 0.001 if level else 1e-5
    assert_near(found, true, 0.51 * 8 / 32767 if level else 1e-9, half, 2 * half, 0.51 / 255 / 0.282)
    step = (1e-7, 0.0005, 0.51 * 3 / 255)[level]
    assert np.abs(found.sh[:, 1:] - true.sh[:, 1:]).max(initial=0) < step
    sample = load_sample(tmp_path / "a.ksplat", 90)
    assert sample is not None
    np.testing.assert_array_equal(sample.gaussians.means, found.means[::7])  # the sample goes across sections


def test_sections_of_a_ksplat_keep_their_degrees(tmp_path: Path) -> None:
    true = scene(2)
    found = seen(tmp_path / "a.ksplat", ksplat(true, 0, second=1))
    assert found.sh_degree == 2 and not found.sh[500:, 4:].any()
    assert np.abs(found.sh[:500] - true.sh[:500]).max() < 0.01
    assert np.abs(found.sh[500:, 1:4] - true.sh[500:, 1:4]).max() < 1e-6


@pytest.mark.skipif(not FORMATS.exists(), reason="the folder of other formats is absent")
def test_files_of_others() -> None:
    found, same = (load(FORMATS / name).gaussians for name in ("minimal.ksplat", "minimal.splat"))
    for name, array in vars(found).items():
        np.testing.assert_array_equal(array, getattr(same, name))
    robot = load(FORMATS / "playbot_sog/meta.json")
    assert len(robot.gaussians) == 31_000 and robot.gaussians.sh_degree == 2 and not robot.warnings
    # It stands on a patch of ground below it, as in such a capture's .ply: at greater y.
    assert np.median(robot.gaussians.means[:, 1]) > -0.4 and robot.gaussians.means[:, 1].min() < -1


FILES = sog(scene(1))
SOG, KSPLAT = zipped(FILES), ksplat(scene(1), 1)
MEANS = {"mins": [0, 0, 0], "maxs": [1, 1, 1], "files": ["means_l.webp", "means_u.webp"]}
BAD = {
    "missing.sog": (zipped({k: v for k, v in FILES.items() if k != "quats.webp"}), "quats.webp is missing"),
    "version.sog": (zipped(sog(scene(), version=1)), "another version than 2"),
    "count.sog": (zipped(sog(scene(), count=9_999)), "where 9,999 are promised"),
    "no_count.sog": (zipped(sog(scene(), count="many")), "lacks what an SOG has"),
    "book.sog": (zipped(sog(scene(), sh0={"codebook": [1, 2], "files": ["sh0.webp"]})), "lacks what"),
    "bounds.sog": (zipped(sog(scene(), means=MEANS | {"mins": [0, 0]})), "lacks what"),
    "endless.sog": (zipped(sog(scene(), sh0={"codebook": [10**400] * 256, "files": ["sh0.webp"]})), "lacks what"),
    "away.sog": (zipped(sog(scene(), quats={"files": ["../a.webp"]})), "names a file in another folder"),
    "picture.sog": (zipped(FILES | {"sh0.webp": b"%!PS"}), "its picture sh0.webp: this is a PostScript file"),
    "text.sog": (zipped(FILES | {"meta.json": b"{"}), "its meta.json cannot be read"),
    "damaged.sog": (SOG.replace(FILES["quats.webp"][:40], bytes(40)), "cannot be unpacked"),
    "other.json.sog": (zipped({"meta.json": b"{}"}), "not an SOG scene"),
    "alone.meta.json": (FILES["meta.json"], "means_l.webp"),
    "short.ksplat": (KSPLAT[:3000], "truncated"),
    "part.ksplat": (KSPLAT[:-5], "truncated"),
    "old.ksplat": (b"\0\0" + KSPLAT[2:], "version 0.0"),
    "centres.ksplat": (KSPLAT[:4128] + bytes(8) + KSPLAT[4136:], "its places are relative to nothing"),
    "level.ksplat": (KSPLAT[:20] + b"\7" + KSPLAT[21:], "damaged"),
    "many.ksplat": (KSPLAT[:4] + b"\xff" * 4 + KSPLAT[8:], "truncated"),
    "empty.ksplat": (KSPLAT[:4096] + bytes(len(KSPLAT) - 4096), "there are no Gaussians in it"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_read_gets_one_line(tmp_path: Path, name: str) -> None:
    content, expected = BAD[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load(path)
    line = str(caught.value)
    assert line.startswith(str(tmp_path)) and "\n" not in line and expected in line


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(["a.sog", "a.ksplat"]), st.data())
def test_damage_never_leaks_an_error(tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject) -> None:
    """Any bytes changed or cut off give a scene or one line, nothing else."""
    content = bytearray(SOG if name == "a.sog" else KSPLAT)
    for _ in range(data.draw(st.integers(0, 6))):
        place = data.draw(st.one_of(st.integers(0, len(content) - 1), st.integers(4096, 4160)))
        content[min(place, len(content) - 1)] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / name
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        gaussians = load(path).gaussians
    except InputError:
        with pytest.raises(InputError, match=r"^[^\n]*$"):
            load(path)
        return
    assert all(np.isfinite(a).all() for a in vars(gaussians).values())
