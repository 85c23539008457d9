"""Short animations of the view: pieces that move to new places, and the camera moving to another view."""

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
"""Duration of the camera's movement: long enough for the eye to follow, too short to wait for."""

PARTING = 0.45
"""Duration of the pieces' movement, seconds: they part calmly, and strokes do not wait for them."""

LINGER = 1.2
"""Duration of the camera's animation, in SECONDS, including a few frames at its goal."""


class PieceAnimation:
    """Slides pieces to their places when the set of pieces changes: after a cut, an undo or reassembling."""

    def __init__(self) -> None:
        self.begin = -10.0
        self.start: dict[Key, Motion] = {}
        self.last: dict[Key, Motion] = {}

    @property
    def moving(self) -> bool:
        """Whether the animation is running, so that frames must be drawn without an event."""
        return time.monotonic() - self.begin < PARTING

    def placed(self, pieces: Sequence[PlacedPiece], moves: bool = True) -> list[PlacedPiece]:
        """The pieces with the motions to draw them with now. `moves`: whether they slide; if not, they jump."""
        now = time.monotonic()
        keys = {piece.key for piece in pieces}
        if not moves:
            self.begin = -10.0
        elif self.last and keys != self.last.keys():
            self.start = {piece.key: self._from(piece) for piece in pieces}
            self.begin = now
        part = min(1.0, (now - self.begin) / PARTING)
        part = part * part * (3 - 2 * part) if part < 1 else 1.0  # begins and ends at rest
        result = list(pieces)
        if part < 1:
            result = [
                replace(piece, motion=_interpolated(self.start.get(piece.key), piece.motion, part)) for piece in pieces
            ]
        self.last = {piece.key: piece.motion for piece in result}
        return result

    def _from(self, piece: PlacedPiece) -> Motion:
        """Where a piece starts: at its own last place, or at that of a piece that it was cut from or contains."""
        if piece.key in self.last:
            return self.last[piece.key]
        for key, motion in self.last.items():
            shorter = min(len(key), len(piece.key))
            if key[:shorter] == piece.key[:shorter]:
                return motion
        return piece.motion


class CameraAnimation:
    """Moves the orbit camera to another view."""

    def __init__(self) -> None:
        self.begin = -10.0
        self.start = self.goal = OrbitCamera()

    def go(self, start: OrbitCamera, goal: OrbitCamera) -> None:
        """Starts the animation."""
        self.begin, self.start, self.goal = time.monotonic(), start, goal

    def now(self) -> OrbitCamera | None:
        """The camera now; None when the animation has ended."""
        part = (time.monotonic() - self.begin) / SECONDS
        if part > LINGER:
            return None
        return self.start.toward(self.goal, 1 - (1 - min(part, 1.0)) ** 3)


def _interpolated(start: Motion | None, end: Motion, part: float) -> Motion:
    """A motion between two; it has the rotation of the end, since only translations change here."""
    if start is None:
        return end
    x, y, z = (a + part * (b - a) for a, b in zip(start.shift, end.shift, strict=True))
    return Motion(end.turn, (x, y, z))
