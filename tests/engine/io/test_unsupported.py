"""Files that are not what their name says: the message tells what each really is."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from engine.errors import InputError
from engine.io.load import load

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += ["rot_0", "rot_1", "rot_2", "rot_3"]
ROW = [1.0, 2, 3, 0, 0, 0, 2, -3, -3, -3, 1, 0, 0, 0]


def ply(rest: int = 0, newline: str = "\n", last: str = "\n") -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "element vertex 1"]
    lines += [f"property float {name}" for name in [*NAMES, *(f"f_rest_{i}" for i in range(rest))]]
    row = [*ROW, *[0.0] * rest]
    return newline.join([*lines, "end_header"]).encode() + last.encode() + struct.pack(f"<{len(row)}f", *row)


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
PAGE = b"\n <!DOCTYPE html><html>Not found</html>"
FILES = {
    "page.ply": (PAGE, "a web page"),
    "page.splat": (PAGE, "a web page"),
    "page.obj": (b"\xef\xbb\xbf<html>", "a web page"),
    "pointer.ply": (LFS, "git lfs pull"),
    "pointer.splat": (LFS + b"x" * (-len(LFS) % 32), "git lfs pull"),
    "zip.ply": (b"PK\x03\x04" + b"\0" * 99, "zip archive"),
    "capture.sog": (b"PK\x03\x04" + b"\0" * 99, "a zip archive, but no SOG capture"),
    "map.las": (b"LASF" + b"\0" * 300, "LAS point cloud"),
    "map.ply": (b"LASF" + b"\0" * 300, "LAS point cloud"),
    "v5.ply": (b"NGSP\5\0\0\0" + b"\0" * 99, ".spz version 5; versions 1 to 4 can be opened"),
    "capture.ksplat": (b"\0\1\0\0" * 99, "truncated, or no .ksplat"),
    "packed.ply": (gzip.compress(ply()), "a .ply is in it; unpack it"),
    "empty.ply": (b"", "the file is empty"),
    "empty.obj": (b"", "the file is empty"),
    "part.ply": (ply(44), "44 'f_rest' properties, where SH of degree 0 to 4 has 0, 9, 24, 45 or 72; export"),
    "gap.ply": (ply(9).replace(b"f_rest_3", b"g_rest_3"), "8 'f_rest' properties, but no 'f_rest_3'"),
    "cut.ply": (ply(45)[:-4], "truncated"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_wrong_file_is_called_by_its_name(tmp_path: Path, name: str) -> None:
    content, said = FILES[name]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ") and said in str(caught.value)


def test_a_ply_of_degree_4_is_cut_to_3_with_a_word(tmp_path: Path) -> None:
    """Only the first 15 of each channel's 24 coefficients are kept."""
    path = tmp_path / "a.ply"
    path.write_bytes(ply(72)[: -4 * 72] + np.arange(72, dtype="<f4").tobytes())
    loaded = load(path)
    assert loaded.warnings == (f"{path}: spherical harmonics of degree 4 cut down to degree 3",)
    np.testing.assert_array_equal(loaded.gaussians.sh[0, 1:].T, np.arange(72).reshape(3, 24)[:, :15])


@pytest.mark.parametrize(("newline", "last"), [("\n", "\r\n"), ("\r\n", "\n"), ("\r\n", "\r\n"), ("\r", "\r")])
def test_a_header_may_mix_its_line_ends(tmp_path: Path, newline: str, last: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(newline=newline, last=last))
    np.testing.assert_array_equal(load(tmp_path / "a.ply").gaussians.means, [[1, 2, 3]])


def test_an_spz_says_where_it_ends(tmp_path: Path) -> None:
    head = struct.pack("<4sIIBBBB", b"NGSP", 2, 10, 1, 12, 0, 0)
    for size, said in ((10 * 9 - 1, "places"), (10 * 19 + 5, "spherical harmonics"), (10 * 12, "colours")):
        (tmp_path / "a.spz").write_bytes(gzip.compress(head + b"\0" * size))
        with pytest.raises(InputError, match=f"10 Gaussians are promised, it ends within their {said}"):
            load(tmp_path / "a.spz")
