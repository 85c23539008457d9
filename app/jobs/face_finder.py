"""Finds the cut faces in pictures in the background, once per file content."""

from __future__ import annotations

import hashlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.translation import _
from engine.errors import InputError
from engine.io.files import open_file
from engine.scene.image import to_8bit
from training.faces.axis import CutGuess, guess_cut
from training.faces.carrier import SeenFace, find_seen_face
from training.faces.edges import largest_component
from training.faces.marks import UNMARKED, Marks, axis_beside, mask_beside, read_axis_file
from training.faces.polygon import mask_polygon
from training.priors.exemplar.pictures import axis_of, read_photograph

__all__ = ["FaceFinder", "FoundFace", "find_face_in"]

CAPACITY = 40
"""Most faces that are kept, about 2 MB each: more pictures than a project has."""


@dataclass(frozen=True, eq=False)
class FoundFace:
    """What was found in a picture without the user's help."""

    rgb: NDArray[np.uint8]
    """(H, W, 3). The picture as training reads it; (0, 0, 3) if it cannot be read."""
    marks: Marks = UNMARKED
    """The outline, and the axis for either kind of cut; UNMARKED if no face was found."""
    beside: Marks = UNMARKED
    """The axis from a file beside the picture, which `marks` includes."""
    guess: CutGuess | None = None
    """The kind of cut that it seems to be."""
    note: str = ""
    """One line about what the user should check; empty if there is nothing."""
    problem: str = ""
    """One line on why there is no outline; empty if there is one."""

    @property
    def verdict(self) -> str:
        """The problem in a few words."""
        return _("no cut face was found") if self.rgb.size else self.problem

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.rgb.shape[1], self.rgb.shape[0]

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.rgb.shape[1] / max(self.rgb.shape[0], 1)


def find_face_in(path: Path) -> FoundFace:
    """The face in a picture file. Never raises InputError: the result says what is wrong."""
    rgb = np.zeros((0, 0, 3), np.uint8)
    try:
        colours, cut_out = read_photograph(path)
        rgb = to_8bit(colours)
        face = find_seen_face(colours, path) if cut_out is None else SeenFace(largest_component(cut_out))
        mask = face.mask
        outline = mask_polygon(mask)
        if outline is None:
            return FoundFace(rgb, problem=_("its mask is empty"))
        beside = axis_beside(path)
        given = UNMARKED if beside is None else read_axis_file(beside)
        core, line = axis_of(colours, mask, "horizontal").core, axis_of(colours, mask, "radial").line
        marks = Marks(outline, given.core or core, given.line or line)
        return FoundFace(rgb, marks, given, guess_cut(colours, mask), note=face.note)
    except InputError as error:
        return FoundFace(rgb, problem=str(error).removeprefix(f"{path}: "))


class FaceFinder:
    """A thread that finds one face after the other, and the faces that it has found."""

    def __init__(self) -> None:
        self._worker = ThreadPoolExecutor(1, "faces")
        self._faces: dict[Path, tuple[object, Future[FoundFace]]] = {}
        self._contents: dict[str, FoundFace] = {}
        """Found faces by the hash of the picture and the files beside it; only the thread uses this."""

    def get(self, path: Path) -> FoundFace | None:
        """What was found in a picture file; None while the search, which this call starts, goes on. Never waits."""
        stamp = tuple(_stamp(file) for file in (path, mask_beside(path), axis_beside(path)))
        entry = self._faces.pop(path, None)
        if entry is None or entry[0] != stamp:
            entry = (stamp, self._worker.submit(self._find, path))
        self._faces[path] = entry
        while len(self._faces) > CAPACITY:
            self._faces.pop(next(iter(self._faces)))[1].cancel()
        return entry[1].result() if entry[1].done() else None

    def _find(self, path: Path) -> FoundFace:
        key = _content(path)
        face = self._contents.pop(key, None) or find_face_in(path)
        self._contents[key] = face
        while len(self._contents) > CAPACITY:
            self._contents.pop(next(iter(self._contents)))
        return face

    def close(self) -> None:
        """Lets the running search end, and starts no more."""
        self._worker.shutdown(wait=False, cancel_futures=True)


def _stamp(path: Path | None) -> tuple[int, int]:
    try:
        state = None if path is None else path.stat()
    except OSError:
        state = None
    return (0, 0) if state is None else (state.st_mtime_ns, state.st_size)


def _content(path: Path) -> str:
    """Hash of a picture file and the mask and axis files beside it; for an unreadable file its path is used."""
    digest = hashlib.sha256()
    for file in (path, mask_beside(path), axis_beside(path)):
        digest.update(b"\0")
        if file is None:
            continue
        try:
            with open_file(file) as opened:
                hashlib.file_digest(opened, lambda: digest)  # continues this digest
        except (OSError, InputError):
            digest.update(str(file).encode("utf-8", "replace"))
    return digest.hexdigest()
