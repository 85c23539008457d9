"""Recognises files that people mistake for captures, such as archives and web pages, by their first bytes."""

from __future__ import annotations

__all__ = ["LONGEST", "unsupported_kind"]

LONGEST = 64
"""Bytes that suffice to recognise a file."""

STARTS: tuple[tuple[bytes, str], ...] = (
    (b"version https://git-lfs", "a Git LFS pointer, not the file it stands for; fetch that with: git lfs pull"),
    (b"PK\x03\x04", "a zip archive, but no SOG capture; unpack it first"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive; unpack it first"),
    (b"Rar!", "a RAR archive; unpack it first"),
    (b"BZh", "packed by bzip2; unpack it first"),
    (b"\xfd7zXZ", "packed by xz; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "packed by zstd; unpack it first"),
    (b"LASF", "a LAS point cloud, which has no Gaussians; train a 3DGS scene or export a mesh"),
    (b"\x89PNG", "a picture, not a capture"),
    (b"\xff\xd8\xff", "a picture, not a capture"),
    (b"%PDF", "a PDF, not a capture"),
    (b"\x93NUMPY", "a NumPy array, not a capture; export it as a .ply"),
)
PAGES = (b"<!doctype", b"<html", b"<head", b"<?xml", b"<error")


def unsupported_kind(start: bytes) -> str | None:
    """What a file with these first bytes is instead of a capture, and what to do about it; None if unknown."""
    for magic, words in STARTS:
        if start.startswith(magic):
            return words
    text = start.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if text.startswith(PAGES):
        return "a web page, not the file itself, as failed downloads leave; download it again"
    return None
