"""Short movements of the view: pieces that part, and a camera on its way to an axis."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

from app.model.camera_control import OrbitCamera
from app.model.document import Key
from app.model.pieces import PlacedPiece
from app.model.rigid_transform import Motion

__all__ = ["CameraAnimation", "PieceAnimation"]

SECONDS = 0.25


class PieceAnimation:
    """When cutting, undoing or putting together changes which pieces there are, they slide to their new places."""

    def __init__(self) -> None:
        self.begin = -10.0
        self.start: dict[Key, Motion] = {}
        self.last: dict[Key, Motion] = {}

    @property
    def moving(self) -> bool:
        """Whether frames must be drawn without an event."""
        return time.monotonic() - self.begin < SECONDS

    def placed(self, pieces: Sequence[PlacedPiece]) -> list[PlacedPiece]:
        """The pieces where they are to be drawn now."""
        now = time.monotonic()
        keys = {piece.key for piece in pieces}
        if self.last and keys != self.last.keys():
            self.start = {piece.key: self._from(piece) for piece in pieces}
            self.begin = now
        part = min(1.0, (now - self.begin) / SECONDS)
        part = 1 - (1 - part) ** 3  # fast at first, then calm
        result = list(pieces)
        if part < 1:
            result = [replace(piece, motion=_mix(self.start.get(piece.key), piece.motion, part)) for piece in pieces]
        self.last = {piece.key: piece.motion for piece in result}
        return result

    def _from(self, piece: PlacedPiece) -> Motion:
        """Where its stuff was: its own last place, or that of the piece it came from or that came from it."""
        if piece.key in self.last:
            return self.last[piece.key]
        for key, motion in self.last.items():
            shorter = min(len(key), len(piece.key))
            if key[:shorter] == piece.key[:shorter]:
                return motion
        return piece.motion


class CameraAnimation:
    """The eye on its way."""

    def __init__(self) -> None:
        self.begin = -10.0
        self.start = self.goal = OrbitCamera()

    def go(self, start: OrbitCamera, goal: OrbitCamera) -> None:
        """Sets off."""
        self.begin, self.start, self.goal = time.monotonic(), start, goal

    def now(self) -> OrbitCamera | None:
        """Where it is; None when it has arrived."""
        part = (time.monotonic() - self.begin) / SECONDS
        if part > 1.2:
            return None
        return self.start.toward(self.goal, 1 - (1 - min(part, 1.0)) ** 3)


def _mix(start: Motion | None, end: Motion, part: float) -> Motion:
    if start is None:
        return end
    x, y, z = (a + part * (b - a) for a, b in zip(start.shift, end.shift, strict=True))
    return Motion(end.turn, (x, y, z))
