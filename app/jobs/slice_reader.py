"""Reads, in the background, cut faces that are seen straight on, so that dragging them never waits for it."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.render.cpu.kernel_field import KernelField
from engine.render.face_detail import Detailed, FaceDetail, straight_face
from engine.scene.atoms import Atoms
from engine.scene.camera import Camera
from engine.scene.image import Picture
from engine.scene.inside import Inside
from engine.scene.piece import Piece
from engine.scene.plane import Plane

__all__ = ["Face", "SliceReader", "WantedFace"]

COARSE = 4
"""Pixels along a side that share one colour during motion: three faces of half a window then take a frame's time."""

ROWS = 32
"""Rows of a picture that are read between checks whether it is still wanted: a few milliseconds."""


@dataclass(frozen=True, eq=False)
class WantedFace:
    """A face to be read."""

    atoms: Atoms
    inside: Inside | None
    """What the face is read from at rest; None: there are only atoms."""
    camera: Camera
    plane: Plane

    def equals(self, other: WantedFace | None) -> bool:
        """Whether the picture would be the same."""
        if other is None or self.atoms is not other.atoms or self.inside is not other.inside:
            return False
        mine, others = (replace(one.camera, viewmat=np.zeros(0)) for one in (self, other))
        return (
            self.plane == other.plane
            and bool((self.camera.viewmat == other.camera.viewmat).all())
            and repr(mine) == repr(others)
        )


@dataclass(frozen=True, eq=False)
class Face:
    """A face that was read."""

    wanted: WantedFace
    rgba: NDArray[np.uint8]
    """(H, W, 4). The camera's picture, or a coarse version of it, with straight alpha."""
    coarse: bool


class _Task:
    """One face that is being read, coarse or in full."""

    def __init__(self, index: int, wanted: WantedFace, coarse: bool) -> None:
        self.index, self.wanted, self.coarse = index, wanted, coarse
        self.stale = False
        """Whether something else is wanted by now."""


class SliceReader:
    """Reads several faces of one object, first coarsely, then in full; faces no longer wanted are abandoned."""

    def __init__(self, count: int) -> None:
        self.faces: list[Face | None] = [None] * count
        """The last picture that was read of each face."""
        self._worker = ThreadPoolExecutor(1, "slices")
        self._running: tuple[_Task, Future[Face | None]] | None = None
        self._field: tuple[Atoms, KernelField] | None = None

    def update(self, wanted: list[WantedFace], moving: bool) -> None:
        """Takes over what was read and starts what is missing. Never waits. `moving`: faces are only read coarsely."""
        if self._running is not None:
            task, future = self._running
            task.stale = not task.wanted.equals(wanted[task.index]) or (moving and not task.coarse)
            if not future.done():
                return
            face = future.result()
            # A coarse picture that came late still shows where the plane was a moment ago.
            if face is not None:
                self.faces[task.index] = face
            self._running = None
        for coarse in (True, False):
            if not coarse and moving:
                return
            for index, one in enumerate(wanted):
                face = self.faces[index]
                if face is None or not face.wanted.equals(one) or (face.coarse and not coarse):
                    task = _Task(index, one, coarse)
                    self._running = (task, self._worker.submit(self._read, task))
                    return

    @property
    def busy(self) -> bool:
        """Whether a face is being read."""
        return self._running is not None

    def close(self) -> None:
        """Starts nothing more."""
        if self._running is not None:
            self._running[0].stale = True
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _read(self, task: _Task) -> Face | None:
        wanted = task.wanted
        if self._field is None or self._field[0] is not wanted.atoms:
            self._field = (wanted.atoms, KernelField(wanted.atoms))
        camera = wanted.camera
        if task.coarse:
            camera = camera.scaled(1 / COARSE)
        picture = self._of_atoms(self._field[1], camera, task)
        if picture is None:
            return None
        if wanted.inside is not None and not task.coarse:
            detailed = Detailed(wanted.inside, wanted.atoms.pitch)
            work = FaceDetail(picture, camera, [Piece((wanted.plane,))], [detailed], light=False)
            while not work.ended:
                work.advance()
                if task.stale:
                    return None
            picture = replace(picture, rgb=work.rgb)
        return Face(wanted, picture.straight_alpha(), task.coarse)

    def _of_atoms(self, field: KernelField, camera: Camera, task: _Task) -> Picture | None:
        """The face as the atoms show it, a few rows at a time; None if it is no longer wanted."""
        parts = []
        for first in range(0, camera.height, ROWS):
            if task.stale and not task.coarse:
                return None
            band = replace(camera, cy=camera.cy - first, height=min(ROWS, camera.height - first))
            parts.append(straight_face(field, task.wanted.atoms.pitch, band, task.wanted.plane))
        rgb, alpha, depth = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("rgb", "alpha", "depth")
        )
        return Picture(rgb, alpha, depth)
