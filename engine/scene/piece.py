"""A piece of an object: what planes leave of it, moved to where it lies now."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from engine.scene.camera import Camera
from engine.scene.plane import Plane

__all__ = ["Piece"]


@dataclass(frozen=True)
class Piece:
    """A convex part of the object's space with a rigid motion. All pieces of an object share its atoms."""

    planes: tuple[Plane, ...] = ()
    """Half-spaces of the object's own space; the piece is where all of them keep. Empty: the whole object."""
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    """(4, 4). Rigid. World point = transform @ object point."""

    def camera(self, camera: Camera) -> Camera:
        """The same view with the piece's own space for a world."""
        return replace(camera, viewmat=camera.viewmat @ self.transform)
