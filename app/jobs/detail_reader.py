"""Reads, in the background, the cut faces of a view that is at rest, so that no frame waits for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for

import numpy as np
from numpy.typing import NDArray

from engine.render.face_detail import FaceDetail

__all__ = ["DetailReader"]


class _Task:
    """One picture whose faces are read."""

    def __init__(self, make: Callable[[], FaceDetail]) -> None:
        self.make = make
        self.stale = False
        """Whether something else is wanted by now."""

    def read(self) -> NDArray[np.float32] | None:
        """(H, W, 3). The picture with its faces read; None if it is no longer wanted."""
        work = None if self.stale else self.make()
        while work is not None and not work.ended and not self.stale:
            work.advance()
        return None if work is None or self.stale else work.rgb


class DetailReader:
    """Reads the faces of the picture that was requested last; a picture that is no longer wanted is abandoned."""

    def __init__(self, ended: Callable[[], None]) -> None:
        """`ended` is called, in any thread, when a picture has been read or abandoned."""
        self._ended = ended
        self._worker = ThreadPoolExecutor(1, "faces")
        self._running: tuple[_Task, Future[NDArray[np.float32] | None]] | None = None

    @property
    def busy(self) -> bool:
        """Whether a picture has been requested and not yet taken."""
        return self._running is not None

    def start(self, make: Callable[[], FaceDetail]) -> None:
        """Begins a new picture in place of the last one. `make` is called in another thread."""
        self.stop()
        task = _Task(make)
        future = self._worker.submit(task.read)
        self._running = task, future
        future.add_done_callback(lambda _: self._ended())

    def stop(self) -> None:
        """Abandons the picture that was begun."""
        if self._running is not None:
            self._running[0].stale = True
            self._running = None

    def take(self, seconds: float) -> NDArray[np.float32] | None:
        """(H, W, 3). The picture that was begun; None if it is not read within so many seconds. Raises the error that
        reading it raised."""
        if self._running is None or not wait_for([self._running[1]], seconds).done:
            return None
        _, future = self._running
        self._running = None
        return future.result()

    def close(self) -> None:
        """Starts nothing more."""
        self.stop()
        self._worker.shutdown(wait=False, cancel_futures=True)
